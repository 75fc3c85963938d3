//! The largest constant power that a state bears for a duration, in one direction.

use crate::forward::{
    Beyond, CellWindow, Demand, ForwardError, Interpolation, Method, Profile, SimModel, SimOptions,
    SimState, simulate,
};
use serde::Serialize;

/// Simulations of one search at most; reached by none.
const MOST_TRIALS: usize = 200;
/// Rows of a held power, closer at its start: a voltage that recovers in between is seen there.
const ROWS: usize = 24;

/// Largest currents of one cell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CurrentLimits {
    /// Discharge, A.
    pub discharge_a: f64,
    /// Charge, A, above zero.
    pub charge_a: f64,
}

impl CurrentLimits {
    /// No limit.
    pub const NONE: Self = Self {
        discharge_a: f64::INFINITY,
        charge_a: f64::INFINITY,
    };
}

/// Limits that must hold, and the accuracy of the search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SopOptions {
    /// Limits of a cell's voltage.
    pub window: CellWindow,
    /// Limits of a cell's current.
    pub currents: CurrentLimits,
    /// Relative accuracy of the power.
    pub accuracy: f64,
}

impl Default for SopOptions {
    fn default() -> Self {
        Self {
            window: CellWindow::THESIS,
            currents: CurrentLimits::NONE,
            accuracy: 1e-7,
        }
    }
}

/// Limit that ends the power.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LimitedBy {
    /// A cell falls to the lower voltage.
    LowerVoltage,
    /// A cell rises to the upper voltage.
    UpperVoltage,
    /// No load gets more power, whatever the voltage.
    TheoreticalMaximum,
    /// The largest current of a cell.
    Current,
    /// The cell is beyond that end of the window without any demand.
    OutsideWindow,
}

/// The most power in one direction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Limit {
    /// Power at the terminals, W, discharge positive.
    pub power_w: f64,
    /// Largest current of a cell under it, A, without sign.
    pub cell_a: f64,
    /// Limit that ends it.
    pub limited_by: LimitedBy,
}

/// Result of one simulation: the smallest distance to a limit as a fraction, and that limit. The
/// distance is negative if the limit is broken.
#[derive(Debug, Clone, Copy)]
struct Verdict {
    margin: f64,
    by: LimitedBy,
    /// Largest current of a cell in the direction of the search, A.
    cell_a: f64,
}

/// Direction of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Direction {
    Discharge,
    Charge,
}

/// Returns the largest powers, discharge (zero or more) and charge (zero or less), that can be held
/// for a duration from a state.
///
/// Discharge is judged by the lower voltage and charge by the upper one: a cell above the window
/// may be discharged into it. A state that is beyond that end already can hold nothing in its
/// direction.
///
/// ```
/// use analysis_forward::{
///     forward::{OcvSource, SimModel},
///     sop::{LimitedBy, SopOptions, most_power},
/// };
/// use analysis_model::model::Erm;
///
/// // 20 mΩ from 3.7 V down to 2.5 V is 60 A, and up to 4.2 V it is 25 A.
/// let erm = Erm { r_ohm: 0.02, branches: Vec::new() };
/// let model = SimModel::cell(&erm, OcvSource::Constant(3.7))?;
/// let (discharge, charge) = most_power(&model, &model.rest(0.5)?, 10.0, &SopOptions::default())?;
/// assert!((discharge.power_w - 150.0).abs() < 1e-3);
/// assert_eq!(discharge.limited_by, LimitedBy::LowerVoltage);
/// assert!((charge.power_w + 105.0).abs() < 1e-3);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ForwardError`] for a state of another model, or options or a duration that cannot be.
pub fn most_power(
    model: &SimModel,
    state: &SimState,
    duration_s: f64,
    options: &SopOptions,
) -> Result<(Limit, Limit), ForwardError> {
    check(duration_s, options)?;
    let search = Search {
        model,
        state,
        duration_s,
        options,
    };
    Ok((
        search.find(Direction::Discharge)?,
        search.find(Direction::Charge)?,
    ))
}

fn check(duration_s: f64, options: &SopOptions) -> Result<(), ForwardError> {
    let bad = |what, expected, met| {
        Err(ForwardError::Value {
            what,
            expected,
            met,
        })
    };
    if !(duration_s.is_finite() && duration_s > 0.0) {
        return bad("duration of the power", "seconds above 0", duration_s);
    }
    if !(options.accuracy > 0.0 && options.accuracy < 0.1) {
        return bad(
            "accuracy of the power",
            "a fraction above 0 and below 0.1",
            options.accuracy,
        );
    }
    for met in [options.currents.discharge_a, options.currents.charge_a] {
        if met.is_nan() || met <= 0.0 {
            return bad("largest current of a cell", "amperes above 0", met);
        }
    }
    Ok(())
}

struct Search<'a> {
    model: &'a SimModel,
    state: &'a SimState,
    duration_s: f64,
    options: &'a SopOptions,
}

impl Search<'_> {
    fn find(&self, direction: Direction) -> Result<Limit, ForwardError> {
        let sign = if direction == Direction::Discharge {
            1.0
        } else {
            -1.0
        };
        let rest = self.judge(direction, 0.0)?;
        if rest.margin < 0.0 {
            return Ok(Limit {
                power_w: 0.0,
                cell_a: 0.0,
                limited_by: LimitedBy::OutsideWindow,
            });
        }
        let (mut kept, mut lost) = ((0.0, rest), self.beyond(direction)?);
        let mut by = lost.1.by;
        // Weights of the Illinois method: the margin of an end that stays is halved.
        let (mut weight_kept, mut weight_lost, mut last) = (1.0, 1.0, None);
        for trial in 0..MOST_TRIALS {
            if lost.0 - kept.0 <= self.options.accuracy * lost.0 || lost.0 < 1e-12 {
                break;
            }
            let (below, above) = (
                TrialPower {
                    power_w: kept.0,
                    margin: kept.1.margin * weight_kept,
                },
                TrialPower {
                    power_w: lost.0,
                    margin: lost.1.margin * weight_lost,
                },
            );
            let power = between(below, above, trial, self.options.accuracy);
            let verdict = self.judge(direction, sign * power)?;
            let inside = verdict.margin >= 0.0;
            if inside {
                kept = (power, verdict);
                (weight_kept, weight_lost) = (
                    1.0,
                    if last == Some(true) {
                        0.5 * weight_lost
                    } else {
                        1.0
                    },
                );
            } else {
                (lost, by) = ((power, verdict), verdict.by);
                (weight_lost, weight_kept) = (
                    1.0,
                    if last == Some(false) {
                        0.5 * weight_kept
                    } else {
                        1.0
                    },
                );
            }
            last = Some(inside);
        }
        // Zero is added for −0.
        Ok(Limit {
            power_w: sign * kept.0 + 0.0,
            cell_a: kept.1.cell_a,
            limited_by: by,
        })
    }

    /// Returns a power that is not kept.
    fn beyond(&self, direction: Direction) -> Result<(f64, Verdict), ForwardError> {
        let sign = if direction == Direction::Discharge {
            1.0
        } else {
            -1.0
        };
        let e_v = self.model.ocv_v(self.state.soc).0 - self.state.v_rc_v.iter().sum::<f64>();
        // No more than E²/4R at the first instant can be drawn; for charging it is only a start.
        let mut power = 1.001 * 0.25 * e_v * e_v / self.model.erm.r_ohm;
        loop {
            let verdict = self.judge(direction, sign * power)?;
            if verdict.margin < 0.0 || power > 1e15 {
                return Ok((power, verdict));
            }
            power *= 4.0;
        }
    }

    fn judge(&self, direction: Direction, power_w: f64) -> Result<Verdict, ForwardError> {
        let options = SimOptions {
            method: Method::Exact,
            beyond: Beyond::Stop,
            window: self.options.window,
            ..SimOptions::default()
        };
        let collapsed = Verdict {
            margin: -1.0,
            by: LimitedBy::TheoreticalMaximum,
            cell_a: f64::INFINITY,
        };
        let summary = match simulate(
            self.model,
            self.state,
            &held(power_w, self.duration_s),
            &options,
        ) {
            Ok(simulation) => simulation.summary,
            Err(ForwardError::Collapsed { .. }) => return Ok(collapsed),
            Err(error) => return Err(error),
        };
        if !summary.feasible {
            return Ok(collapsed);
        }
        let (window, currents) = (self.options.window, self.options.currents);
        let width = window.high_v - window.low_v;
        let parallel = f64::from(self.model.pack.parallel);
        let voltage = match direction {
            Direction::Discharge => (summary.margin_low_v, LimitedBy::LowerVoltage),
            Direction::Charge => (summary.margin_high_v, LimitedBy::UpperVoltage),
        };
        let (cell_a, most_a) = match direction {
            Direction::Discharge => (summary.peak_current_a / parallel, currents.discharge_a),
            Direction::Charge => (-summary.lowest_current_a / parallel, currents.charge_a),
        };
        let current = 1.0 - cell_a / most_a;
        let by_voltage = Verdict {
            margin: voltage.0 / width,
            by: voltage.1,
            cell_a,
        };
        Ok(if current < by_voltage.margin {
            Verdict {
                margin: current,
                by: LimitedBy::Current,
                cell_a,
            }
        } else {
            by_voltage
        })
    }
}

/// A power that was tried.
#[derive(Clone, Copy)]
struct TrialPower {
    /// Its size, W.
    power_w: f64,
    /// Margin that it leaves, times the weight of its end.
    margin: f64,
}

/// Returns a trial between a kept and a lost power: by false position, every third time by
/// bisection, and never at an end.
fn between(kept: TrialPower, lost: TrialPower, trial: usize, accuracy: f64) -> f64 {
    let width = lost.power_w - kept.power_w;
    let share = if trial % 3 == 2 {
        0.5
    } else {
        kept.margin / (kept.margin - lost.margin)
    };
    let share = if share.is_finite() { share } else { 0.5 };
    // With half the accuracy off an end, the last trial closes the bracket.
    let edge = (0.4 * accuracy * lost.power_w / width).min(0.5);
    kept.power_w + width * share.clamp(edge, 1.0 - edge)
}

/// Returns a power held for a duration, with rows that lie closer at its start.
fn held(power_w: f64, duration_s: f64) -> Profile {
    let time = |k: usize| duration_s * (k as f64 / ROWS as f64).powi(3);
    Profile {
        name: "held".to_owned(),
        demand: Demand::Power,
        interpolation: Interpolation::Hold,
        time_s: (0..=ROWS).map(time).collect(),
        value: vec![power_w; ROWS + 1],
        negated: false,
    }
}
