//! The resistances of one pulse.

use std::ops::Range;

use analysis_signal::series::TimeSeries;

use super::options::{HppcOptions, Limits};
use super::result::{Direction, Found, LeastPower, OpenCircuit, Pulse, PulseState, Resistance};
use super::trend::{RowNoise, Scatter, Trend};
use crate::loads::{CONSTANT_PART, Course, Estimate, FEWEST_OF_SLOPE, LEAD_S, Load, median};

/// Rows after the first by which the current of a pulse at a voltage limit is known.
const FIRST_ROWS: usize = 3;
/// Part of a time by which the age of its row may differ. Convention: a resistance that grows by a
/// third in each decade of time then differs by less than 1 %.
const NEAR_PART: f64 = 0.05;
/// Jitter of the stamps of cyclers, s. Logs of 0.1 s have steps of 0.09 s to 0.11 s.
const JITTER_S: f64 = 0.01;
/// Fewest rows whose scatter is that of their channel.
const FEWEST_OF_SCATTER: usize = 8;

/// Makes the row of a pulse; the charge that was drawn before it is set by the caller.
pub(super) fn pulse(
    series: &TimeSeries,
    load: &Load,
    noise: &Estimate,
    options: &HppcOptions,
) -> Pulse {
    let one = OnePulse::of(series, load, noise, options);
    let open_circuit = load.rest.map(|rest| {
        let level = one.trend.at(0.0);
        OpenCircuit {
            v: level.v,
            sigma_v: level.variance.map(f64::sqrt),
            rest_s: rest.duration_s,
        }
    });
    let mut resistances: Vec<Resistance> = options
        .at_s
        .iter()
        .map(|at_s| {
            let found = one.row(*at_s).map(|row| one.resistance(row));
            Resistance {
                at_s: *at_s,
                reason: found.as_ref().err().cloned(),
                found: found.ok(),
            }
        })
        .collect();
    let direction = if one.level_a - one.before_a < 0.0 {
        Direction::Charge
    } else {
        Direction::Discharge
    };
    let mut notes = Vec::new();
    if load.course == Course::AtLimit {
        notes.push("a voltage limit reduces its current".to_owned());
    }
    notes.extend(one.settling());
    if let Some(limits) = options.limits {
        let law = open_circuit
            .ok_or_else(|| {
                "no power: it stands on a current, so that no rest has the OCV".to_owned()
            })
            .and_then(|ocv| PowerLaw::of(direction, limits, ocv));
        match law {
            Ok(law) => resistances.iter_mut().for_each(|one| law.apply(one)),
            Err(reason) => notes.push(reason),
        }
    }
    Pulse {
        start_s: one.start_s,
        direction,
        current_a: one.level_a,
        duration_s: load.start_s + load.duration_s - one.start_s,
        state: PulseState {
            soc: load.soc,
            drawn_ah: None,
            temperature_degc: load.temperature_degc,
            open_circuit,
            base: load.base,
        },
        least_power: least_power(&resistances),
        resistances,
        notes,
    }
}

fn least_power(resistances: &[Resistance]) -> Option<LeastPower> {
    let all = resistances.iter().filter_map(|one| {
        let found = one.found?;
        Some(LeastPower {
            w: found.power_w?,
            sigma_w: found.power_sigma_w,
            at_s: one.at_s,
        })
    });
    all.min_by(|a, b| a.w.total_cmp(&b.w))
}

/// A pulse, its rows and what was before it.
struct OnePulse<'a> {
    series: &'a TimeSeries,
    rows: Range<usize>,
    start_s: f64,
    end_s: f64,
    trend: Trend,
    /// Current before the pulse, A.
    before_a: f64,
    /// Current of the pulse, A.
    level_a: f64,
    errors: CurrentErrors<'a>,
    start_logged: bool,
}

/// What the uncertainty of a current comes from.
struct CurrentErrors<'a> {
    log: &'a Estimate,
    gain: f64,
}

impl<'a> OnePulse<'a> {
    fn of(series: &'a TimeSeries, load: &Load, log: &'a Estimate, options: &HppcOptions) -> Self {
        let rows = load.samples.clone();
        let start_s = series.time_s[rows.start.saturating_sub(1)];
        let before = window(series, load, start_s);
        let rest_s = start_s - series.time_s[load.before.start];
        let age_s: Vec<f64> = series.time_s[before.clone()]
            .iter()
            .map(|t| t - start_s)
            .collect();
        let level_a = match load.course {
            Course::AtLimit => {
                let first = (rows.start + 1).min(rows.end - 1);
                let last = (first + FIRST_ROWS).min(rows.end);
                median(series.current_a[first..last].to_vec())
            }
            _ => load.current_a,
        };
        Self {
            start_s,
            end_s: load.start_s + load.duration_s,
            trend: Trend::of(&age_s, &series.voltage_v[before.clone()], rest_s, log),
            before_a: mean(&series.current_a[before]),
            level_a,
            errors: CurrentErrors {
                log,
                gain: options.current_gain,
            },
            start_logged: options.start_logged,
            rows,
            series,
        }
    }

    fn age_s(&self, row: usize) -> f64 {
        self.series.time_s[row] - self.start_s
    }

    /// The row that is nearest to an age.
    fn nearest(&self, age_s: f64) -> Option<usize> {
        let away = |row: &usize| (self.age_s(*row) - age_s).abs();
        self.rows.clone().min_by(|a, b| away(a).total_cmp(&away(b)))
    }

    /// The row of a time.
    ///
    /// # Errors
    /// Why no row states the resistance at that time.
    fn row(&self, at_s: f64) -> Result<usize, String> {
        let near = |row: &usize| is_near(self.age_s(*row), at_s);
        let Some(row) = self.nearest(at_s).filter(near) else {
            return Err(self.no_row(at_s));
        };
        let off = |row: &usize| {
            let away_a = (self.series.current_a[*row] - self.level_a).abs();
            away_a > self.tolerance_a()
        };
        let settled = self.settled();
        let unsteady = if row < settled {
            Some(row)
        } else {
            (settled..=row).find(off)
        };
        if let Some(off) = unsteady {
            return Err(format!(
                "its current is not constant: {:.3} A at {:.2} s, not {:.3} A",
                self.series.current_a[off],
                self.age_s(off),
                self.level_a
            ));
        }
        let mean_a = self.mean_until(row);
        if (mean_a - self.level_a).abs() > self.tolerance_a() {
            return Err(format!(
                "its current settles too late: its mean until then is {mean_a:.3} A, not {:.3} A",
                self.level_a
            ));
        }
        Ok(row)
    }

    /// Why no row is near a time.
    fn no_row(&self, at_s: f64) -> String {
        let (first_s, last_s) = (self.age_s(self.rows.start), self.age_s(self.rows.end - 1));
        if at_s < first_s {
            return format!("first row of the pulse at {first_s:.2} s");
        }
        if at_s > last_s {
            let end_s = self.end_s - self.start_s;
            return if at_s > end_s {
                format!("the pulse lasts {end_s:.1} s")
            } else {
                format!("last row of the pulse at {last_s:.2} s")
            };
        }
        let after = self.rows.clone().find(|row| self.age_s(*row) > at_s);
        let after = after.unwrap_or(self.rows.end - 1);
        format!(
            "no row near it, only at {:.2} s and {:.2} s",
            self.age_s(after.saturating_sub(1).max(self.rows.start)),
            self.age_s(after)
        )
    }

    fn tolerance_a(&self) -> f64 {
        CONSTANT_PART * (self.level_a - self.before_a).abs()
    }

    /// First row at which the current has its level; the row behind the last if none has.
    fn settled(&self) -> usize {
        let near =
            |row: &usize| (self.series.current_a[*row] - self.level_a).abs() <= self.tolerance_a();
        self.rows.clone().find(near).unwrap_or(self.rows.end)
    }

    fn settling(&self) -> Option<String> {
        let settled = self.settled();
        let late = settled > self.rows.start && settled < self.rows.end;
        late.then(|| {
            format!(
                "its current is within {} % of {:.3} A from {:.2} s on",
                100.0 * CONSTANT_PART,
                self.level_a,
                self.age_s(settled)
            )
        })
    }

    /// Mean of the current from the start of the pulse to a row, the first row for the time before it.
    fn mean_until(&self, row: usize) -> f64 {
        let current_a = &self.series.current_a;
        let time_s = &self.series.time_s;
        let first = self.rows.start;
        let before = current_a[first] * self.age_s(first);
        let steps = (first + 1..=row)
            .map(|k| 0.5 * (current_a[k] + current_a[k - 1]) * (time_s[k] - time_s[k - 1]));
        (before + steps.sum::<f64>()) / self.age_s(row)
    }

    fn resistance(&self, row: usize) -> Found {
        let age_s = self.age_s(row);
        let level = self.trend.at(age_s);
        let currents = &self.series.current_a[self.settled()..=row];
        let change_a = mean(currents) - self.before_a;
        let ohm = (level.v - self.series.voltage_v[row]) / change_a;
        let of_voltage = level
            .variance
            .zip(self.trend.noise)
            .map(|(trend, noise)| trend + noise.variance);
        let of_current = self.errors.variance(currents, change_a);
        let start_ohm = self.start_ohm(row, change_a);
        let of_start = match start_ohm {
            _ if self.start_logged => Some(0.0),
            // Any start between the two rows is as likely as any other.
            moved => moved.map(|ohm| ohm * ohm / 3.0),
        };
        let sigma_ohm = of_voltage.zip(of_start).map(|(voltage, start)| {
            ((voltage + ohm * ohm * of_current) / change_a.powi(2) + start).sqrt()
        });
        Found {
            row_s: age_s,
            ohm,
            sigma_ohm,
            start_ohm,
            power_w: None,
            power_sigma_w: None,
        }
    }

    /// Change of the resistance if the current began at the first row: by the slope from half the age
    /// of the row to it, or to the next row.
    fn start_ohm(&self, row: usize, change_a: f64) -> Option<f64> {
        let half = self
            .nearest(0.5 * self.age_s(row))
            .filter(|half| *half < row);
        let (from, to) = match half {
            Some(half) => (half, row),
            None => (row, row + 1),
        };
        if to >= self.rows.end {
            return None;
        }
        let voltage_v = &self.series.voltage_v;
        let slope = (voltage_v[from] - voltage_v[to]) / (self.age_s(to) - self.age_s(from));
        Some(slope * self.age_s(self.rows.start) / change_a)
    }
}

impl CurrentErrors<'_> {
    /// Variance of the change of a current that is the mean of some rows, A².
    fn variance(&self, currents: &[f64], change_a: f64) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a number of rows")]
        let count = currents.len() as f64;
        let local = (currents.len() >= FEWEST_OF_SCATTER).then(|| {
            let middle_a = mean(currents);
            let squares = currents.iter().map(|a| (a - middle_a).powi(2));
            Scatter {
                variance: squares.sum::<f64>() / (count - 1.0),
                freedom: count - 1.0,
            }
        });
        let noise = RowNoise::of_current(local, self.log);
        let of_rows = noise.map_or(0.0, |noise| noise.variance / count + noise.shared);
        of_rows + (self.gain * change_a).powi(2)
    }
}

/// Whether a row of this age stands for a time.
fn is_near(age_s: f64, at_s: f64) -> bool {
    (age_s - at_s).abs() <= NEAR_PART * at_s + JITTER_S
}

/// Rows whose trend is continued: the last minute, or the second half of what is shorter.
fn window(series: &TimeSeries, load: &Load, start_s: f64) -> Range<usize> {
    let before = load.before.clone();
    let whole_s = start_s - series.time_s[before.start];
    let from_s = start_s - LEAD_S.min(0.5 * whole_s);
    let late = series.time_s[before.clone()].partition_point(|t| *t < from_s) + before.start;
    // A slow log has less than a few rows in the window.
    let latest = before.end.saturating_sub(FEWEST_OF_SLOPE).max(before.start);
    late.min(latest)..before.end
}

fn mean(values: &[f64]) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a number of rows")]
    let count = values.len().max(1) as f64;
    values.iter().sum::<f64>() / count
}

/// Power at a voltage limit as a number over the resistance.
#[derive(Clone, Copy)]
struct PowerLaw {
    /// Limit times distance of the OCV from it, V².
    square_v: f64,
    /// Its standard uncertainty, V².
    sigma: Option<f64>,
}

impl PowerLaw {
    /// # Errors
    /// Why the limit allows no power.
    fn of(direction: Direction, limits: Limits, ocv: OpenCircuit) -> Result<Self, String> {
        let (limit_v, way_v) = match direction {
            Direction::Discharge => (limits.min_v, ocv.v - limits.min_v),
            Direction::Charge => (limits.max_v, limits.max_v - ocv.v),
        };
        if way_v <= 0.0 {
            return Err(format!(
                "no power: its rest at {:.4} V is beyond the limit of {limit_v} V",
                ocv.v
            ));
        }
        Ok(Self {
            square_v: limit_v * way_v,
            sigma: ocv.sigma_v.map(|sigma| limit_v * sigma),
        })
    }

    fn apply(&self, one: &mut Resistance) {
        let Some(found) = one.found.as_mut().filter(|found| found.ohm > 0.0) else {
            return;
        };
        let power_w = self.square_v / found.ohm;
        found.power_w = Some(power_w);
        found.power_sigma_w = found
            .sigma_ohm
            .zip(self.sigma)
            .map(|(ohm, square)| power_w * (ohm / found.ohm).hypot(square / self.square_v));
    }
}
