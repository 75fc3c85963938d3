//! Cuts a log into rests and loads: where the current starts and stops, and where the cycler's program
//! goes on to its next step.

use std::ops::Range;

use analysis_signal::series::TimeSeries;

use super::thresholds::{
    CONSTANT_PART, CUT_S, FEWEST_AT_LIMIT, FEWEST_OF_CHAIN, LIMIT_BAND_V, LIMIT_CURRENT_PART,
    LIMIT_PART, LONGEST_BEFORE_STEP_S, LONGEST_PAUSE_S, REST_PART, SHORTEST_PULSE_S,
    SHORTEST_REST_S,
};

/// A segment of a log, at rest or under load.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Segment {
    /// Its samples.
    pub(crate) samples: Range<usize>,
    /// Whether no current flows.
    pub(crate) rest: bool,
    /// Number of the part of the log between two cuts.
    pub(crate) part: usize,
    /// Position of its step in the program, from 0; 0 for all if the log has no steps.
    pub(crate) step: usize,
    /// Whether it is the current that pulses stand on.
    pub(crate) base: bool,
}

/// Course of the current of a load.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Course {
    /// One current.
    Constant,
    /// A current that falls while the voltage stays at a limit.
    AtLimit,
    /// Anything else.
    Varying,
}

impl Segment {
    /// Time between its first and its last sample, s.
    pub(crate) fn lasting_s(&self, series: &TimeSeries) -> f64 {
        series.time_s[self.samples.end - 1] - series.time_s[self.samples.start]
    }
}

/// Current below which the cell is at rest, A.
pub(crate) fn rest_current_a(series: &TimeSeries) -> f64 {
    let finite = series.current_a.iter().filter(|a| a.is_finite());
    REST_PART * finite.fold(0.0_f64, |most, a| most.max(a.abs()))
}

/// The rests and loads of a log, in its order. `steps` holds the number of the cycler's step in each
/// row.
pub(crate) fn segments(series: &TimeSeries, steps: Option<&[f64]>) -> Vec<Segment> {
    let all = chained(series, &absorbed(series, by_rows(series, steps)));
    let all = joined(all, |before, pause, after| {
        before.step == after.step && pause.lasting_s(series) < SHORTEST_REST_S
    });
    let all = joined(all, |before, pause, after| {
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
    });
    all.into_iter()
        .flat_map(|load| levels(series, &load).unwrap_or_else(|| vec![load]))
        .collect()
}

/// Segments that begin where the current starts or stops, the step of the program changes under
/// current, or the log is cut.
fn by_rows(series: &TimeSeries, steps: Option<&[f64]>) -> Vec<Segment> {
    let below_a = rest_current_a(series);
    let (mut all, mut step): (Vec<Segment>, usize) = (Vec::new(), 0);
    for k in 0..series.len() {
        let before = all.last().is_none_or(|last| last.rest);
        // A row without a current value belongs to the previous segment.
        let rest = match series.current_a[k] {
            a if a.is_finite() => a.abs() <= below_a,
            _ => before,
        };
        let cut = k > 0 && series.time_s[k] - series.time_s[k - 1] > CUT_S;
        let number = |k: usize| steps.and_then(|all| all.get(k)).filter(|n| n.is_finite());
        let goes_on = |k: usize| number(k).zip(number(k - 1)).is_some_and(|(a, b)| a != b);
        step += usize::from(k > 0 && goes_on(k));
        let part = all.last().map_or(0, |last| last.part) + usize::from(cut);
        let same =
            |last: &Segment| last.rest == rest && last.part == part && (rest || last.step == step);
        match all.last_mut() {
            Some(last) if same(last) => last.samples.end = k + 1,
            _ => all.push(Segment {
                samples: k..k + 1,
                rest,
                part,
                step,
                base: false,
            }),
        }
    }
    all
}

/// Whether the second segment is a load that follows the first, a load, without a rest.
fn follows(before: &Segment, load: &Segment) -> bool {
    !before.rest && !load.rest && before.part == load.part
}

/// Adds single rows under current to the load beside them: cyclers write the last current of a step
/// into the first row of the next one.
fn absorbed(series: &TimeSeries, segments: Vec<Segment>) -> Vec<Segment> {
    let mut all: Vec<Segment> = Vec::new();
    for segment in segments {
        match all.last_mut() {
            Some(last) if follows(last, &segment) && segment.samples.len() == 1 => {
                last.samples.end = segment.samples.end;
            }
            Some(last) if follows(last, &segment) && last.lasting_s(series) == 0.0 => {
                last.samples.end = segment.samples.end;
                last.step = segment.step;
            }
            _ => all.push(segment),
        }
    }
    all
}

/// Joins three or more short steps under current that follow each other without a rest: a drive cycle
/// that is written in steps.
fn chained(series: &TimeSeries, segments: &[Segment]) -> Vec<Segment> {
    let mut all: Vec<Segment> = Vec::new();
    let mut rest = segments;
    while let Some(first) = rest.first() {
        let pairs = rest.windows(2);
        let length = 1 + pairs.take_while(|pair| follows(&pair[0], &pair[1])).count();
        let (chain, after) = rest.split_at(length);
        let short = |load: &Segment| load.lasting_s(series) < LONGEST_PAUSE_S;
        let whole = Segment {
            samples: first.samples.start..chain.last().unwrap_or(first).samples.end,
            ..first.clone()
        };
        if length >= FEWEST_OF_CHAIN && chain.iter().all(short) {
            all.push(whole);
        } else if let Some(pieces) = on_base(series, &whole) {
            all.extend(pieces);
        } else {
            all.extend_from_slice(chain);
        }
        rest = after;
    }
    all
}

/// The pieces of a load that is made of two or three constant currents, one of them a pulse and one
/// long: in an HPPC without steps the slow discharge to the next state follows a pulse at once.
fn levels(series: &TimeSeries, load: &Segment) -> Option<Vec<Segment>> {
    if load.rest || load.base || course(series, load) == Course::Constant {
        return None;
    }
    if let Some(pieces) = on_base(series, load) {
        return Some(pieces);
    }
    let pieces = constant_pieces(series, load);
    let lasting = |piece: &Segment| piece.lasting_s(series);
    let constant = |piece: &Segment| {
        lasting(piece) >= SHORTEST_PULSE_S && course(series, piece) == Course::Constant
    };
    let cut = (2..=3).contains(&pieces.len())
        && pieces.iter().all(constant)
        && pieces
            .iter()
            .any(|piece| lasting(piece) <= LONGEST_BEFORE_STEP_S)
        && pieces.iter().any(|piece| lasting(piece) >= LONGEST_PAUSE_S);
    cut.then_some(pieces)
}

/// The pieces of a load that is one current with pulses on it: pulses of a slow discharge that never
/// rests.
fn on_base(series: &TimeSeries, load: &Segment) -> Option<Vec<Segment>> {
    if load.rest {
        return None;
    }
    let mut pieces = constant_pieces(series, load);
    let lasting = |piece: &Segment| piece.lasting_s(series);
    let longest = pieces
        .iter()
        .max_by(|a, b| lasting(a).total_cmp(&lasting(b)))?;
    let base_a = median_a(series, inner(longest));
    for piece in &mut pieces {
        let away_a = (median_a(series, inner(piece)) - base_a).abs();
        piece.base = away_a <= CONSTANT_PART * base_a.abs();
    }
    let of_base_s: f64 = pieces.iter().filter(|piece| piece.base).map(lasting).sum();
    // The first and the last may be cut off.
    let within = pieces.get(1..pieces.len() - 1)?;
    let constant = |piece: &Segment| {
        lasting(piece) >= SHORTEST_PULSE_S && course(series, piece) == Course::Constant
    };
    let is_pulse = |three: &[Segment]| match three {
        [before, pulse, after] => {
            before.base
                && !pulse.base
                && after.base
                && lasting(before) >= LONGEST_PAUSE_S
                && lasting(pulse) <= LONGEST_BEFORE_STEP_S
        }
        _ => false,
    };
    let fits = within.iter().all(constant)
        && 2.0 * of_base_s > load.lasting_s(series)
        && pieces.windows(3).any(is_pulse);
    fits.then_some(pieces)
}

/// Stretches of a load with one current each.
fn constant_pieces(series: &TimeSeries, load: &Segment) -> Vec<Segment> {
    let below_a = rest_current_a(series);
    let (mut pieces, mut level_a): (Vec<Segment>, f64) = (Vec::new(), f64::NAN);
    for k in load.samples.clone() {
        let now_a = series.current_a[k];
        let near = (now_a - level_a).abs() <= (CONSTANT_PART * level_a.abs()).max(below_a);
        match pieces.last_mut() {
            Some(last) if near || !now_a.is_finite() => last.samples.end = k + 1,
            _ => {
                level_a = now_a;
                pieces.push(Segment {
                    samples: k..k + 1,
                    ..load.clone()
                });
            }
        }
    }
    absorbed(series, pieces)
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
pub(crate) fn inner(load: &Segment) -> Range<usize> {
    match load.samples.len() {
        0..=3 => load.samples.clone(),
        _ => load.samples.start + 1..load.samples.end - 1,
    }
}

/// Median of the finite currents of these samples, A.
pub(crate) fn median_a(series: &TimeSeries, samples: Range<usize>) -> f64 {
    median(series.current_a[samples].to_vec())
}

/// Returns the median of the finite values, or 0 if there are none.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.retain(|value| value.is_finite());
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// Course of the current of a load.
pub(crate) fn course(series: &TimeSeries, load: &Segment) -> Course {
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
