//! Loads of a log with the rests around them, and why one cannot be a run.

use analysis::series::TimeSeries;
use serde::Serialize;

use super::{
    segment::{self, Course, Segment, inner, median, median_a},
    thresholds::{
        FEWEST_OF_DISCHARGE, FEWEST_OF_SLOPE, JITTER_PART, LEAD_S, LONGEST_PULSE_S, REST_VOLTAGE_S,
        REST_WINDOW_S, SHORTEST_CYCLE_S, STEEPEST_V_PER_S,
    },
};

/// Conditions of a usable load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LogSearch {
    /// Shortest rest before a load, s.
    pub rest_s: f64,
    /// Longest step between samples of a pulse or a drive cycle, s.
    pub slowest_s: f64,
}

/// Kind of a load.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A short constant current.
    Pulse,
    /// A long constant current out of the cell.
    Discharge,
    /// A long constant current into the cell.
    Charge,
    /// A current that varies.
    DriveCycle,
}

impl Kind {
    /// Its name in names and tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pulse => "pulse",
            Self::Discharge => "discharge",
            Self::Charge => "charge",
            Self::DriveCycle => "cycle",
        }
    }
}

/// Rest before a load.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Rest {
    /// Its duration, s.
    pub duration_s: f64,
    /// Voltage at its end, V.
    pub voltage_v: f64,
    /// Residual slope of the voltage at its end, V/s.
    pub slope_v_per_s: f64,
    /// Standard uncertainty of the slope, V/s.
    pub slope_sigma_v_per_s: f64,
}

impl Rest {
    /// Residual slope in mV per minute, rounded so that nothing has no sign.
    pub fn slope_mv_per_min(&self) -> f64 {
        (6e6 * self.slope_v_per_s).round() / 1e2 + 0.0
    }
}

/// A load, and the run that it would be.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Load {
    /// Its kind.
    pub kind: Kind,
    /// Median current, A, positive for discharge; of a drive cycle the mean.
    pub current_a: f64,
    /// Start of the load in the log's time, s.
    pub start_s: f64,
    /// Duration of the load, s.
    pub duration_s: f64,
    /// Longest step between its samples, s.
    pub step_s: f64,
    /// Start of the run in the log's time, s.
    pub from_s: f64,
    /// End of the run in the log's time, s.
    pub to_s: f64,
    /// Rest before it; `None` if the load follows another one or begins the log.
    pub rest: Option<Rest>,
    /// Duration of the rest after it, s; 0 if there is none.
    pub rest_after_s: f64,
    /// Temperature of the cell at the start, °C, if logged.
    pub temperature_c: Option<f64>,
    /// State of charge at the start, if known.
    pub soc: Option<f64>,
    /// Whether `soc` was counted, and not taken from the rest voltage.
    pub counted: bool,
    /// Reason why the load cannot be a run.
    pub refusal: Option<String>,
    /// First sample of the load.
    #[serde(skip)]
    pub(super) first: usize,
    /// Part of the log between two cuts.
    #[serde(skip)]
    pub(super) part: usize,
}

impl Load {
    /// Rest voltage before the load, V.
    pub(super) fn rest_v(&self) -> Option<f64> {
        self.rest.map(|rest| rest.voltage_v)
    }
}

/// The loads of a log, in its order.
pub fn loads(series: &TimeSeries, search: &LogSearch) -> Vec<Load> {
    let segments = segment::segments(series);
    let of = |k: usize| -> Option<Load> {
        let load = segments.get(k).filter(|segment| !segment.rest)?;
        let beside = |at: Option<usize>| {
            at.and_then(|at| segments.get(at))
                .filter(|rest| rest.rest && rest.part == load.part)
        };
        let before = Before {
            rest: beside(k.checked_sub(1)),
            // The rest then belongs to the load before too.
            shared: k >= 2 && segments[k - 2].part == load.part,
        };
        let after = After {
            rest: beside(Some(k + 1)),
            shared: segments
                .get(k + 2)
                .is_some_and(|next| next.part == load.part),
        };
        Some(one(series, search, load, before, after))
    };
    let mut all: Vec<Load> = (0..segments.len()).filter_map(of).collect();
    for k in 1..all.len() {
        // A load that is left out takes no rest from the one before it.
        if all[k].refusal.is_some() {
            let before = &mut all[k - 1];
            before.to_s = before.start_s + before.duration_s + before.rest_after_s;
        }
    }
    all
}

/// Rest before a load.
#[derive(Clone, Copy)]
struct Before<'a> {
    rest: Option<&'a Segment>,
    shared: bool,
}

/// Rest after a load.
#[derive(Clone, Copy)]
struct After<'a> {
    rest: Option<&'a Segment>,
    shared: bool,
}

/// Part of a rest that goes to the load after it, s.
fn lead_s(rest_s: f64, shared: bool) -> f64 {
    LEAD_S.min(if shared { 0.5 * rest_s } else { rest_s })
}

fn one(
    series: &TimeSeries,
    search: &LogSearch,
    load: &Segment,
    before: Before<'_>,
    after: After<'_>,
) -> Load {
    let time_s = &series.time_s;
    let first = load.samples.start;
    let start_s = time_s[first];
    // The load lasts until the first sample without current.
    let off = after
        .rest
        .map_or(load.samples.end - 1, |rest| rest.samples.start);
    let duration_s = time_s[off] - start_s;
    let course = segment::course(series, load);
    let middle_a = median_a(series, inner(load));
    let kind = match course {
        Course::Constant if duration_s <= LONGEST_PULSE_S => Kind::Pulse,
        Course::Constant if middle_a > 0.0 => Kind::Discharge,
        Course::Constant => Kind::Charge,
        Course::AtLimit | Course::Varying => Kind::DriveCycle,
    };
    let current_a = match course {
        Course::Constant => middle_a,
        Course::AtLimit | Course::Varying => mean(&series.current_a[load.samples.clone()]),
    };
    let rest = before.rest.map(|rest| rest_of(series, rest, start_s));
    let from_s = rest.map_or(start_s, |rest| {
        start_s - lead_s(rest.duration_s, before.shared)
    });
    let end_s = after
        .rest
        .map_or(time_s[off], |rest| time_s[rest.samples.end - 1]);
    let rest_after_s = end_s - time_s[off];
    let to_s = if after.shared {
        end_s - lead_s(rest_after_s, true)
    } else {
        end_s
    };
    let from = before.rest.map_or(first, |rest| {
        time_s[rest.samples.clone()].partition_point(|t| *t < from_s) + rest.samples.start
    });
    let temperature_c = series
        .temperature_c
        .as_ref()
        .and_then(|all| all[from..=off].iter().copied().find(|t| t.is_finite()));
    let steps = first.saturating_sub(usize::from(rest.is_some()))..off;
    let step_s = steps.map(|k| time_s[k + 1] - time_s[k]).fold(0.0, f64::max);
    let mut found = Load {
        kind,
        current_a,
        start_s,
        duration_s,
        step_s,
        from_s,
        to_s,
        rest,
        rest_after_s,
        temperature_c,
        soc: None,
        counted: false,
        refusal: None,
        first,
        part: load.part,
    };
    let rows = before.rest.map_or(first, |rest| rest.samples.start)
        ..after.rest.map_or(load.samples.end, |rest| rest.samples.end);
    found.refusal = damaged(series, rows).or_else(|| refusal(&found, course, search));
    found
}

/// Rows of which no run can be made.
fn damaged(series: &TimeSeries, mut rows: std::ops::Range<usize>) -> Option<String> {
    let lacking = rows
        .clone()
        .find(|k| !(series.current_a[*k].is_finite() && series.voltage_v[*k].is_finite()));
    if let Some(k) = lacking {
        let at_s = series.time_s[k];
        return Some(format!(
            "the row at {at_s:.3} s has no current or no voltage"
        ));
    }
    let start = rows.start;
    rows.find(|k| *k > start && series.time_s[*k] <= series.time_s[k - 1])
        .map(|k| format!("the stamp {:.3} s repeats or goes back", series.time_s[k]))
}

/// Why a load cannot be a run.
fn refusal(load: &Load, course: Course, search: &LogSearch) -> Option<String> {
    let Some(rest) = load.rest else {
        return Some("no rest before it".to_owned());
    };
    if rest.duration_s < search.rest_s {
        return Some(format!(
            "the rest before it is logged for {:.1} s, less than {:.1} s",
            rest.duration_s, search.rest_s
        ));
    }
    let sure = rest.slope_v_per_s.abs() - 2.0 * rest.slope_sigma_v_per_s;
    if sure > STEEPEST_V_PER_S {
        return Some(format!(
            "the voltage before it still moves by {:.2} mV per minute",
            rest.slope_mv_per_min()
        ));
    }
    if course == Course::AtLimit {
        return Some("a voltage limit was hit: its current falls at one voltage".to_owned());
    }
    if course == Course::Varying && load.duration_s < SHORTEST_CYCLE_S {
        return Some("its current is not constant".to_owned());
    }
    if load.kind == Kind::Pulse && load.rest_after_s <= 0.0 {
        return Some("no rest after it".to_owned());
    }
    let slowest_s = match load.kind {
        Kind::Pulse | Kind::DriveCycle => search.slowest_s * (1.0 + JITTER_PART),
        Kind::Discharge | Kind::Charge => load.duration_s / FEWEST_OF_DISCHARGE,
    };
    (load.step_s > slowest_s).then(|| {
        format!(
            "rows are {:.2} s apart, more than {slowest_s:.2} s: logged too slowly, or rows lack",
            load.step_s
        )
    })
}

fn mean(values: &[f64]) -> f64 {
    let finite: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    #[expect(clippy::cast_precision_loss, reason = "numbers of samples")]
    let count = finite.len().max(1) as f64;
    finite.iter().sum::<f64>() / count
}

/// A rest that a load ends at this time.
fn rest_of(series: &TimeSeries, rest: &Segment, load_s: f64) -> Rest {
    let time_s = &series.time_s[rest.samples.clone()];
    let voltage_v = &series.voltage_v[rest.samples.clone()];
    let duration_s = load_s - time_s[0];
    let late = |window_s: f64| time_s.partition_point(|t| *t < load_s - window_s);
    // A slow log has less than a few samples in the window.
    let begin = late(REST_WINDOW_S).min(time_s.len().saturating_sub(FEWEST_OF_SLOPE));
    let end = begin.max(late(REST_VOLTAGE_S)).min(time_s.len() - 1);
    let (slope, sigma) = slope(&time_s[begin..], &voltage_v[begin..]);
    Rest {
        duration_s,
        voltage_v: median(voltage_v[end..].to_vec()),
        slope_v_per_s: slope,
        slope_sigma_v_per_s: sigma,
    }
}

/// Returns the slope of a straight line and its standard uncertainty; both are 0 if there are too
/// few samples.
fn slope(time_s: &[f64], voltage_v: &[f64]) -> (f64, f64) {
    let (t0, v0) = (mean(time_s), mean(voltage_v));
    let sum = |of: &dyn Fn(f64, f64) -> f64| -> f64 {
        let pairs = time_s.iter().zip(voltage_v);
        pairs
            .map(|(t, v)| of(t - t0, v - v0))
            .filter(|x| x.is_finite())
            .sum()
    };
    let spread = sum(&|t, _| t * t);
    if time_s.len() < 3 || spread <= 0.0 {
        return (0.0, 0.0);
    }
    let slope = sum(&|t, v| t * v) / spread;
    let rest = sum(&|t, v| (v - slope * t).powi(2));
    #[expect(clippy::cast_precision_loss, reason = "numbers of samples")]
    let freedom = (time_s.len() - 2) as f64;
    (slope, (rest / freedom / spread).sqrt())
}
