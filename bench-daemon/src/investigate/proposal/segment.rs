//! Cuts a log into rests and loads.

use std::ops::Range;

use analysis::series::TimeSeries;

use super::thresholds::{
    CONSTANT_PART, CUT_S, FEWEST_AT_LIMIT, LIMIT_BAND_V, LIMIT_CURRENT_PART, LIMIT_PART,
    LONGEST_PAUSE_S, REST_PART, SHORTEST_PULSE_S, SHORTEST_REST_S,
};

/// A segment of a log, at rest or under load.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Segment {
    /// Its samples.
    pub(super) samples: Range<usize>,
    /// Whether no current flows.
    pub(super) rest: bool,
    /// Number of the part of the log between two cuts.
    pub(super) part: usize,
}

/// Course of the current of a load.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Course {
    /// One current.
    Constant,
    /// A current that falls while the voltage stays at a limit.
    AtLimit,
    /// Anything else.
    Varying,
}

impl Segment {
    /// Time between its first and its last sample, s.
    pub(super) fn lasting_s(&self, series: &TimeSeries) -> f64 {
        series.time_s[self.samples.end - 1] - series.time_s[self.samples.start]
    }
}

/// Current below which the cell is at rest, A.
pub(super) fn rest_current_a(series: &TimeSeries) -> f64 {
    let finite = series.current_a.iter().filter(|a| a.is_finite());
    REST_PART * finite.fold(0.0_f64, |most, a| most.max(a.abs()))
}

/// The rests and loads of a log, in its order.
pub(super) fn segments(series: &TimeSeries) -> Vec<Segment> {
    let below_a = rest_current_a(series);
    let mut all: Vec<Segment> = Vec::new();
    for k in 0..series.len() {
        let before = all.last().is_none_or(|last| last.rest);
        // A row without a current value belongs to the previous segment.
        let rest = match series.current_a[k] {
            a if a.is_finite() => a.abs() <= below_a,
            _ => before,
        };
        let cut = k > 0 && series.time_s[k] - series.time_s[k - 1] > CUT_S;
        let part = all.last().map_or(0, |last| last.part) + usize::from(cut);
        match all.last_mut() {
            Some(last) if last.rest == rest && last.part == part => last.samples.end = k + 1,
            _ => all.push(Segment {
                samples: k..k + 1,
                rest,
                part,
            }),
        }
    }
    let all = joined(all, |_, pause, _| pause.lasting_s(series) < SHORTEST_REST_S);
    joined(all, |before, pause, after| {
        // A pulse before or after the pause is a load of its own, as in an HPPC.
        let of_cycle = |load: &Segment| match course(series, load) {
            Course::Varying => true,
            Course::Constant => load.lasting_s(series) < SHORTEST_PULSE_S,
            Course::AtLimit => false,
        };
        let varies = |load: &Segment| course(series, load) == Course::Varying;
        pause.lasting_s(series) < LONGEST_PAUSE_S
            && (varies(before) || varies(after))
            && of_cycle(before)
            && of_cycle(after)
    })
}

/// Returns the segments after joining loads with a negligible pause between them.
fn joined(
    segments: Vec<Segment>,
    is_one: impl Fn(&Segment, &Segment, &Segment) -> bool,
) -> Vec<Segment> {
    let mut all: Vec<Segment> = Vec::new();
    for segment in segments {
        if let [.., before, pause] = all.as_slice()
            && !before.rest
            && pause.rest
            && !segment.rest
            && before.part == segment.part
            && is_one(before, pause, &segment)
        {
            all.pop();
            if let Some(before) = all.last_mut() {
                before.samples.end = segment.samples.end;
            }
        } else {
            all.push(segment);
        }
    }
    all
}

/// Samples of a load without its first and its last, in which the current may still move.
pub(super) fn inner(load: &Segment) -> Range<usize> {
    match load.samples.len() {
        0..=3 => load.samples.clone(),
        _ => load.samples.start + 1..load.samples.end - 1,
    }
}

/// Median of the finite currents of these samples, A.
pub(super) fn median_a(series: &TimeSeries, samples: Range<usize>) -> f64 {
    median(series.current_a[samples].to_vec())
}

/// Returns the median of the finite values, or 0 if there are none.
pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Course of the current of a load.
pub(super) fn course(series: &TimeSeries, load: &Segment) -> Course {
    let middle_a = median_a(series, inner(load));
    let tolerance_a = (CONSTANT_PART * middle_a.abs()).max(rest_current_a(series));
    let steady = |a: &f64| !a.is_finite() || (a - middle_a).abs() <= tolerance_a;
    if series.current_a[inner(load)].iter().all(steady) {
        Course::Constant
    } else if at_limit(series, inner(load)) {
        Course::AtLimit
    } else {
        Course::Varying
    }
}

fn at_limit(series: &TimeSeries, samples: Range<usize>) -> bool {
    let current_a = &series.current_a[samples.clone()];
    let voltage_v = &series.voltage_v[samples];
    let charging = current_a.iter().all(|a| a.is_nan() || *a <= 0.0);
    if !charging && current_a.iter().any(|a| *a < 0.0) {
        return false;
    }
    let sign = if charging { 1.0 } else { -1.0 };
    let extreme_v = voltage_v
        .iter()
        .filter(|v| v.is_finite())
        .map(|v| sign * v)
        .fold(f64::NEG_INFINITY, f64::max);
    // All samples from the first at the limit on.
    let Some(first) = voltage_v
        .iter()
        .position(|v| extreme_v - sign * v < LIMIT_BAND_V)
    else {
        return false;
    };
    let held = &current_a[first..];
    let stays = voltage_v[first..]
        .iter()
        .all(|v| !v.is_finite() || extreme_v - sign * v < 2.0 * LIMIT_BAND_V);
    let falls = match (held.first(), held.last()) {
        (Some(first), Some(last)) => last.abs() < LIMIT_CURRENT_PART * first.abs(),
        _ => false,
    };
    #[expect(clippy::cast_precision_loss, reason = "numbers of samples")]
    let part = held.len() as f64 / current_a.len() as f64;
    stays && falls && held.len() >= FEWEST_AT_LIMIT && part >= LIMIT_PART
}
