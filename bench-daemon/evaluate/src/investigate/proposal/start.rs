//! Inputs of `diagnose` besides the runs, as far as the logs determine them: a model to start from, and a
//! curve of the open-circuit voltage.

use analysis::{
    diagnosis::Role,
    loads::{Kind, Load, SocFrom},
    ocv::OcvCurve,
    series::TimeSeries,
};
use serde::Serialize;

use super::{
    runs::{FoundLog, ProposedRun},
    thresholds::{REPEAT_SOC, SHORTEST_PULSE_S, START_S, START_SAMPLES, STATE_SOC},
};

/// A model that is read off one load.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StartModel {
    /// Run that it is read off.
    pub run: String,
    /// Resistance at once, Ω.
    pub r_ohm: f64,
    /// What is added in the course of the load; `None` if the load is too short to show it.
    pub branch: Option<Branch>,
}

/// A resistance that comes with a time constant.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Branch {
    /// Resistance, Ω.
    pub r_ohm: f64,
    /// Time constant, s.
    pub tau_s: f64,
}

impl StartModel {
    /// The model as a file that `diagnose --model` reads.
    pub fn json(&self) -> String {
        let branches: Vec<_> = self
            .branch
            .iter()
            .map(|one| serde_json::json!({"r_ohm": one.r_ohm, "c_f": one.tau_s / one.r_ohm}))
            .collect();
        serde_json::json!({"r_ohm": self.r_ohm, "branches": branches}).to_string() + "\n"
    }
}

/// Reads a model off the largest constant current that trains: the voltage over the current in its first
/// minute. A curve takes out how the open-circuit voltage moves, if the state of charge is known.
pub fn start_model(
    series: &[&TimeSeries],
    logs: &[FoundLog],
    runs: &[ProposedRun],
    curve: Option<&OcvCurve>,
) -> Option<StartModel> {
    let of = |run: &ProposedRun| &logs[run.log].loads[run.load];
    let trains = runs.iter().filter(|run| run.role == Role::Train);
    let constant = trains.filter(|run| of(run).kind != Kind::DriveCycle);
    // A pulse that was cut short does not determine a course.
    let run = constant.max_by(|a, b| {
        let long = |run: &ProposedRun| of(run).duration_s >= SHORTEST_PULSE_S;
        let size = |run: &ProposedRun| of(run).current_a.abs();
        (long(a).cmp(&long(b))).then(size(a).total_cmp(&size(b)))
    })?;
    let rise = rise(series.get(run.log)?, of(run), curve);
    let first = rise.first()?.ohm;
    let last_s = rise.last()?.time_s;
    let fits = (0..=TRIES).filter_map(|k| {
        let tau_s = LONGEST_PART * last_s * SHORTEST_PART.powf(f64::from(k) / f64::from(TRIES));
        fitted(&rise, tau_s)
    });
    let best = fits.min_by(|a, b| a.squares.total_cmp(&b.squares));
    let model = |r_ohm, branch| StartModel {
        run: run.name.clone(),
        r_ohm,
        branch,
    };
    let found = best.map(|fit| model(fit.r_ohm, Some(fit.branch)));
    found.or_else(|| (first > 0.0).then(|| model(first, None)))
}

/// Time constants that are tried, less one.
const TRIES: i32 = 24;
/// The longest of them, as a part of the time that is looked at: beyond it an exponential is a line.
const LONGEST_PART: f64 = 2.0;
/// The shortest of them, as a part of the longest.
const SHORTEST_PART: f64 = 0.025;

/// A sample of a load.
struct Sample {
    /// Time since the last sample before the load, s.
    time_s: f64,
    /// Change of the voltage over that of the current, Ω.
    ohm: f64,
}

/// The first minute of a load.
fn rise(series: &TimeSeries, load: &Load, curve: Option<&OcvCurve>) -> Vec<Sample> {
    let before = match (load.rest, load.base) {
        (Some(rest), _) => Some((rest.voltage_v, 0.0)),
        (None, base) => base.map(|base| (base.voltage_v, base.current_a)),
    };
    let Some(((voltage_v, current_a), begun_s)) =
        before.zip(load.samples.start.checked_sub(1).map(|k| series.time_s[k]))
    else {
        return Vec::new();
    };
    let known = curve.zip(load.soc);
    let mut drawn_ah = 0.0;
    let mut moved_v = |k: usize| {
        drawn_ah += series.current_a[k] * (series.time_s[k] - series.time_s[k - 1]) / 3600.0;
        known.map_or(0.0, |(curve, soc)| {
            let now = soc.value - drawn_ah / curve.capacity_ah;
            curve.voltage_v(soc.value) - curve.voltage_v(now)
        })
    };
    let end_s = load.start_s + load.duration_s.min(START_S);
    (load.samples.start..series.len())
        .take_while(|k| series.time_s[*k] < end_s)
        .map(|k| Sample {
            time_s: series.time_s[k] - begun_s,
            ohm: (voltage_v - series.voltage_v[k] - moved_v(k)) / (series.current_a[k] - current_a),
        })
        .filter(|sample| sample.ohm.is_finite())
        .collect()
}

/// A fit with one time constant.
struct Fit {
    r_ohm: f64,
    branch: Branch,
    squares: f64,
}

/// Least squares of `r + b (1 − exp(−t/τ))`; none if a resistance is not above zero.
fn fitted(rise: &[Sample], tau_s: f64) -> Option<Fit> {
    if rise.len() < START_SAMPLES {
        return None;
    }
    let shape = |sample: &Sample| 1.0 - (-sample.time_s / tau_s).exp();
    let sum = |of: &dyn Fn(&Sample) -> f64| rise.iter().map(of).sum::<f64>();
    #[expect(clippy::cast_precision_loss, reason = "a number of samples")]
    let count = rise.len() as f64;
    let (x, y) = (sum(&shape) / count, sum(&|one| one.ohm) / count);
    let spread = sum(&|one| (shape(one) - x).powi(2));
    let slope = sum(&|one| (shape(one) - x) * (one.ohm - y)) / spread;
    let r_ohm = y - slope * x;
    let squares = sum(&|one| (one.ohm - r_ohm - slope * shape(one)).powi(2));
    let branch = Branch {
        r_ohm: slope,
        tau_s,
    };
    let fits = r_ohm > 0.0 && slope > 0.0 && squares.is_finite();
    fits.then_some(Fit {
        r_ohm,
        branch,
        squares,
    })
}

/// A rest voltage at a state of charge.
#[derive(Clone, Copy)]
struct Knot {
    soc: f64,
    ocv_v: f64,
}

/// The curve through the rest voltages of loads whose state of charge is known without a curve; none for
/// fewer than two states, or if a voltage does not rise with the state.
pub fn rest_curve(logs: &[FoundLog], capacity_ah: Option<f64>) -> Option<OcvCurve> {
    let mut knots: Vec<Knot> = logs
        .iter()
        .flat_map(|log| &log.loads)
        .filter(|load| load.refusal.is_none())
        .filter_map(|load| {
            let soc = load.soc.filter(|soc| soc.from != SocFrom::RestVoltage)?;
            Some(Knot {
                soc: soc.value,
                ocv_v: load.rest_v()?,
            })
        })
        .collect();
    knots.sort_by(|a, b| a.soc.total_cmp(&b.soc));
    knots.dedup_by(|next, kept| next.soc - kept.soc < REPEAT_SOC);
    let span = knots.last()?.soc - knots.first()?.soc;
    if span < STATE_SOC {
        return None;
    }
    let (soc, ocv_v) = knots.iter().map(|knot| (knot.soc, knot.ocv_v)).unzip();
    OcvCurve::monotone(capacity_ah?, soc, ocv_v).ok()
}
