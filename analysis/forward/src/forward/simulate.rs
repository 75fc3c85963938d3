//! Runs a profile through a model, with an error bound, a trace and a summary.
//!
//! [`Method::Exact`] divides each piece of the profile into as many sub-steps as the tolerance
//! requires: it compares one step with two of half the length (Richardson) and continues with the
//! better result, improved by their difference. [`Method::Thesis`] is explicit Euler, which is
//! stable only below twice the shortest time constant; its default step is a quarter of that
//! constant.

use super::additions;
use super::error::ForwardError;
use super::law::{Beyond, Demand, Drive};
use super::mapped;
use super::model::{SimModel, SimState};
use super::options::{Method, SimOptions, Simulation};
use super::profile::{DemandPoint, Piece, Profile};
use super::step::{Coefficients, Ends, Integrator};
use super::trace::{Point, TraceRecorder};
use analysis_effects::contract::Ramp;
use std::ops::Range;

/// Halvings of a piece at most.
const DEEPEST: usize = 30;
/// Relative error of a sub-step's mean current at most, before two halves improve it.
const CURRENT_ACCURACY: f64 = 1e-5;
/// Largest distance of the voltage in the middle of a sub-step from the straight line between its
/// ends, V per cell in series.
const BEND_V: f64 = 4e-6;
/// Default step of explicit Euler, as a fraction of the shortest time constant.
const EULER_PART: f64 = 0.25;
/// Steps of explicit Euler at most, which leave nothing behind but time.
const MOST_STEPS: f64 = 1e10;

impl SimOptions {
    /// Longest step of explicit Euler, s, if it is stable.
    fn euler_step_s(&self, model: &SimModel, profile: &Profile) -> Result<f64, ForwardError> {
        let tau_s = model
            .erm
            .branches
            .iter()
            .map(|b| b.time_constant_s())
            .fold(f64::INFINITY, f64::min);
        let step_s = self.thesis_step_s.unwrap_or(EULER_PART * tau_s);
        if step_s.is_nan() || step_s <= 0.0 || profile.duration_s() / step_s > MOST_STEPS {
            let expected = "a number of seconds above 0 that makes fewer than 1e10 steps";
            return Err(ForwardError::Value {
                what: "step of explicit Euler",
                expected,
                met: step_s,
            });
        }
        let longest_s = profile
            .pieces(self.max_step_s)
            .map(|p| p.step_s / parts(p.step_s, step_s) as f64)
            .fold(0.0, f64::max);
        if longest_s >= 2.0 * tau_s {
            return Err(ForwardError::Unstable {
                step_s: longest_s,
                tau_s,
                usable_s: EULER_PART * tau_s,
            });
        }
        Ok(step_s)
    }
}

/// Returns the number of steps that a piece takes.
fn parts(piece_s: f64, step_s: f64) -> u64 {
    (piece_s / step_s * (1.0 - 1e-9)).ceil().max(1.0) as u64
}

/// Runs a profile through a model from a state.
///
/// ```
/// use analysis_forward::forward::{
///     Demand, OcvSource, Profile, SimModel, SimOptions, simulate,
/// };
/// use analysis_model::model::{Erm, RcBranch};
///
/// // 10 A for a minute from 3.7 V: 15 mΩ at once, and 10 mΩ within some seconds.
/// let erm = Erm { r_ohm: 0.015, branches: vec![RcBranch { r_ohm: 0.01, c_f: 300.0 }] };
/// let model = SimModel::cell(&erm, OcvSource::Constant(3.7))?;
/// let profile = Profile::constant(Demand::Current, 10.0, 60.0)?;
/// let run = simulate(&model, &model.rest(0.5)?, &profile, &SimOptions::default())?;
/// assert!((run.summary.charge_coulomb - 600.0).abs() < 1e-6);
/// assert!((run.summary.min_ccv_v - 3.45).abs() < 1e-4);
/// assert!(run.summary.feasible && run.summary.margin_low_v > 0.9);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ForwardError`] for a state of another model, invalid options, or a model driven beyond its
/// validity. Unavailable power is a result and not an error; if it is requested for so long that no
/// voltage is left behind the series resistance, the run ends there under any policy.
pub fn simulate(
    model: &SimModel,
    state: &SimState,
    profile: &Profile,
    options: &SimOptions,
) -> Result<Simulation, ForwardError> {
    model.check(state)?;
    options.check(profile)?;
    if let Some(mapped) = &model.mapped {
        return mapped::simulate(model, mapped, state, profile, options);
    }
    if let Some(laws) = &model.laws {
        return additions::simulate(model, laws, state, profile, options);
    }
    let euler_step_s = match options.method {
        Method::Exact => f64::INFINITY,
        Method::Thesis => options.euler_step_s(model, profile)?,
    };
    let drive = Drive {
        demand: profile.demand,
        beyond: options.beyond,
        r_ohm: model.erm.r_ohm,
    };
    let mut run = Run {
        integrator: Integrator::new(model, drive),
        options,
        state: state.clone(),
        recorder: TraceRecorder::new(model, options.window),
        ladder: Ladder {
            step_s: f64::NAN,
            rungs: Vec::new(),
        },
        level: 0,
    };
    let mut last_demand = None;
    for piece in profile.pieces(options.max_step_s) {
        let Some(start) = run.ended(|run| run.look(piece.start()).map(Some))? else {
            break;
        };
        if last_demand != Some(piece.from) {
            run.recorder.row(&start, &run.state);
        }
        last_demand = Some(piece.to);
        let arrived = run.ended(|run| match options.method {
            Method::Exact => run.piece(&piece, start),
            Method::Thesis => run.euler(&piece, start, euler_step_s),
        })?;
        let Some(end) = arrived else { break };
        run.recorder.row(&end, &run.state);
    }
    let (summary, trace) = run
        .recorder
        .close(&run.state, profile.time_s.first().copied().unwrap_or(0.0));
    Ok(Simulation {
        summary,
        trace,
        end: run.state,
    })
}

/// Coefficients of a piece's length and its halvings.
struct Ladder {
    step_s: f64,
    rungs: Vec<Coefficients>,
}

impl Ladder {
    fn reach(&mut self, model: &SimModel, step_s: f64, level: usize) {
        if self.step_s != step_s {
            self.step_s = step_s;
            self.rungs.clear();
        }
        while self.rungs.len() <= level {
            let halved = step_s * 0.5f64.powi(self.rungs.len() as i32);
            self.rungs.push(Coefficients::new(model, halved));
        }
    }
}

struct Run<'a> {
    integrator: Integrator<'a>,
    options: &'a SimOptions,
    state: SimState,
    recorder: TraceRecorder<'a>,
    ladder: Ladder,
    level: usize,
}

/// Result of an attempt of one step and of two halves.
struct Attempt {
    middle: SimState,
    end: SimState,
    error_v: f64,
    /// The run stops within the step.
    stops: bool,
}

impl Run<'_> {
    /// All that can be seen at an instant, and noted.
    fn look(&mut self, asked: DemandPoint) -> Result<Point, ForwardError> {
        let point = self.point(asked, &self.state)?;
        self.recorder.see(&point);
        Ok(point)
    }

    fn point(&self, asked: DemandPoint, state: &SimState) -> Result<Point, ForwardError> {
        let DemandPoint { time_s, demand } = asked;
        let ocv_v = self.integrator.model.ocv_v(state.soc).0;
        let e_v = ocv_v - state.v_rc_v.iter().sum::<f64>();
        let power = self.integrator.drive.demand == Demand::Power;
        if !e_v.is_finite() || (power && e_v <= 0.0) {
            return Err(ForwardError::Collapsed { time_s, e_v });
        }
        let (reply, past_tangent) = self.integrator.drive.reply_or_most(e_v, demand);
        let (current_a, ccv_v) = (
            reply.current_a,
            e_v - self.integrator.drive.r_ohm * reply.current_a,
        );
        let demand_w = if power { demand } else { ccv_v * current_a };
        let available_w = self.integrator.drive.available_w(e_v);
        Ok(Point {
            time_s,
            demand_w,
            current_a,
            ccv_v,
            ocv_v,
            available_w,
            infeasible: reply.infeasible,
            past_tangent,
        })
    }

    /// A collapse after power that could not be had is the end of the run, not an error.
    fn ended(
        &mut self,
        go: impl FnOnce(&mut Self) -> Result<Option<Point>, ForwardError>,
    ) -> Result<Option<Point>, ForwardError> {
        match go(self) {
            Err(ForwardError::Collapsed { time_s, .. }) if !self.recorder.feasible() => {
                self.recorder.emptied(time_s, self.options.beyond);
                Ok(None)
            }
            other => other,
        }
    }

    fn stops(&self, point: &Point) -> bool {
        point.past_tangent || (point.infeasible && self.options.beyond == Beyond::Stop)
    }

    /// Runs one piece by explicit Euler; returns `None` if the run stops in it.
    fn euler(
        &mut self,
        piece: &Piece,
        start: Point,
        longest_s: f64,
    ) -> Result<Option<Point>, ForwardError> {
        let count = parts(piece.step_s, longest_s);
        let step_s = piece.step_s / count as f64;
        let mut before = start;
        for done in 1..=count {
            if self.stops(&before) {
                return Ok(None);
            }
            let at =
                |done: u64| piece.from + (piece.to - piece.from) * (done as f64 / count as f64);
            let from = self.state.clone();
            self.integrator
                .euler(step_s, &from, &mut self.state, at(done - 1));
            self.recorder.held(&before, step_s, &from);
            before = self.look(DemandPoint {
                time_s: piece.from_s + step_s * done as f64,
                demand: at(done),
            })?;
        }
        Ok((!self.stops(&before)).then_some(before))
    }

    /// Runs one piece with error control; returns `None` if the run stops in it.
    fn piece(&mut self, piece: &Piece, start: Point) -> Result<Option<Point>, ForwardError> {
        let tolerance_v = self.options.tolerance_v * f64::from(self.integrator.model.pack.series);
        let bend_v = BEND_V * f64::from(self.integrator.model.pack.series);
        let whole = 1u64 << DEEPEST;
        let (mut done, mut before) = (0u64, start);
        while done < whole {
            if self.stops(&before) {
                return Ok(None);
            }
            // A sub-step of a level begins at a multiple of its length.
            while done % (whole >> self.level) != 0 {
                self.level += 1;
            }
            let part = |done: u64| done as f64 / whole as f64;
            let (t0, t1) = (part(done), part(done + (whole >> self.level)));
            let attempt = self.attempt(piece, t0..t1, tolerance_v)?;
            let at = |part: f64| DemandPoint {
                time_s: piece.from_s + part * piece.step_s,
                demand: piece.from + part * (piece.to - piece.from),
            };
            let mut good = attempt.error_v <= tolerance_v && !attempt.stops;
            let mut seen = None;
            if good || self.level + 1 >= DEEPEST {
                let (middle, after) = (
                    self.point(at(0.5 * (t0 + t1)), &attempt.middle)?,
                    self.point(at(t1), &attempt.end)?,
                );
                // Extremes are taken at ends and middles only. In between the voltage must be
                // nearly straight.
                good &= (middle.ccv_v - 0.5 * (before.ccv_v + after.ccv_v)).abs() <= bend_v;
                seen = Some((middle, after));
            }
            let Some((middle, after)) = seen.filter(|_| good || self.level + 1 >= DEEPEST) else {
                self.level += 1;
                continue;
            };
            let from = std::mem::replace(&mut self.state, attempt.end);
            self.recorder.see(&middle);
            self.recorder.see(&after);
            self.recorder.passed(
                [&before, &middle, &after],
                [&from, &attempt.middle, &self.state],
            );
            done += whole >> self.level;
            let start_v = std::mem::replace(&mut before, after).ccv_v;
            let straight = (middle.ccv_v - 0.5 * (start_v + after.ccv_v)).abs() < bend_v / 8.0;
            if straight
                && attempt.error_v < tolerance_v / 16.0
                && self.level > 0
                && done.is_multiple_of(whole >> (self.level - 1))
            {
                self.level -= 1;
            }
        }
        Ok((!self.stops(&before)).then_some(before))
    }

    /// Computes one step and two halves over a part of a piece, whose length is 1.
    fn attempt(
        &mut self,
        piece: &Piece,
        span: Range<f64>,
        tolerance_v: f64,
    ) -> Result<Attempt, ForwardError> {
        self.ladder
            .reach(self.integrator.model, piece.step_s, self.level + 1);
        let (long, short) = (
            &self.ladder.rungs[self.level],
            &self.ladder.rungs[self.level + 1],
        );
        let demand = |part: f64| piece.from + part * (piece.to - piece.from);
        let (d0, d2) = (demand(span.start), demand(span.end));
        let d1 = demand(0.5 * (span.start + span.end));
        let ramp = |start: f64, end: f64| Ramp { start, end };
        let (mut once, mut middle, mut end) =
            (self.state.clone(), self.state.clone(), self.state.clone());
        let integrator = &self.integrator;
        let ends = [
            integrator.step(long, &self.state, &mut once, ramp(d0, d2)),
            integrator.step(short, &self.state, &mut middle, ramp(d0, d1)),
            integrator.step(short, &middle, &mut end, ramp(d1, d2)),
        ];
        let infeasible = ends.iter().any(|e| e.start.infeasible || e.end.infeasible);
        let power = integrator.drive.demand == Demand::Power;
        let stops = infeasible
            && match self.options.beyond {
                Beyond::Stop => true,
                Beyond::Clamp => false,
                Beyond::Extrapolate { .. } | Beyond::Bend { .. } => {
                    power && ends.iter().any(|e| e.least_ccv_v <= 0.0)
                }
            };
        let ocv = |s: &SimState| integrator.model.ocv_v(s.soc).0;
        let apart: f64 = end
            .v_rc_v
            .iter()
            .zip(&once.v_rc_v)
            .map(|(a, b)| (a - b).abs())
            .sum();
        let mean_a = |e: &Ends| 0.5 * (e.start.current_a + e.end.current_a);
        let apart_a = (mean_a(&ends[0]) - 0.5 * (mean_a(&ends[1]) + mean_a(&ends[2]))).abs();
        let largest_a = ends.iter().fold(1e-6, |a: f64, e| {
            a.max(e.start.current_a.abs()).max(e.end.current_a.abs())
        });
        // States may be insensitive to the current, energies are not: they want its mean as well.
        let charge_v = apart_a / (CURRENT_ACCURACY * largest_a) * tolerance_v;
        let error_v = (apart + (ocv(&end) - ocv(&once)).abs() + charge_v) / 3.0;
        // Both are wrong in second order, one step four times as much as two halves: their
        // difference takes it away.
        for (better, rough) in end.v_rc_v.iter_mut().zip(&once.v_rc_v) {
            *better += (*better - rough) / 3.0;
        }
        end.soc += (end.soc - once.soc) / 3.0;
        let collapsed = ends
            .iter()
            .any(|e| e.least_e_v.is_nan() || (power && e.least_e_v <= 0.0));
        Ok(Attempt {
            middle,
            end,
            error_v: if collapsed { f64::INFINITY } else { error_v },
            stops,
        })
    }
}
