//! A filter that the logger applies to the current of every record.
//!
//! The voltage shows when the current steps: the inverted model, from voltage to current, jumps at
//! that instant. Between two steps the true current is constant, and the logged current moves from
//! its previous value to that level as the filter allows. Levels and one time constant for all
//! records are fitted to the logged current, for each form of filter, and compared with no filter
//! at all. If the voltage changes as slowly as the logged current, that current actually flows, and
//! the inverted model does not jump.

use analysis_signal::history::BenchHistory;
use std::fmt;
use std::ops::Range;

use analysis_effects::augmented::Between;
use serde::Serialize;

use super::data::{DataSet, Fixture, Run, RunData, TimeRecord};
use super::edges::UNIFORM;
use super::median::median;
use super::prepare::BaseModel;
use crate::thresholds::{
    FILTER_AT_ONCE, FILTER_EDGE_PART, FILTER_EDGE_SIGMAS, FILTER_FEWEST_EDGES, FILTER_LEFT_PART,
    FILTER_MERGE_SIGMAS, FILTER_OFF_PART, FILTER_RECORDS_PART, FILTER_REST_PART, FILTER_SEGMENT_S,
    FILTER_SHORT_PART, FILTER_SLOWER, FILTER_SPLIT_SIGMAS, FILTER_SWING_PART, FILTER_TRIED_S,
    FILTER_TRIES, LARGE_STEP_PART, MOST_BINS,
};

/// Rows of a level from which its scatter is computed.
const LASTING_ROWS: usize = 8;
/// Places of a step within a level that are tried at first.
const SPLIT_TRIES: usize = 200;

/// Form of a filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Form {
    /// First order.
    Plain,
    /// First order; it restarts where no current flows.
    Restart,
    /// Mean over the last seconds.
    Mean,
}

impl fmt::Display for Form {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Plain => "a first-order filter",
            Self::Restart => {
                "a first-order filter that starts anew when the current is switched off"
            }
            Self::Mean => "a moving mean",
        })
    }
}

/// A filter of all records' logged current.
#[derive(Debug, Clone, PartialEq)]
pub struct Filter {
    pub(crate) form: Form,
    /// Time constant, or length of the mean, s.
    pub(crate) tau_s: f64,
    /// Standard deviation of it, s.
    pub(crate) sigma_s: f64,
    /// Part of the squares that no filter leaves which this one leaves.
    pub(crate) left: f64,
    /// Edges of the current on which the result rests.
    pub(crate) edges: usize,
    /// Part of a step that the voltage shows in its first sample, in the middle of the large ones,
    /// and the logged current, in their lower quartile.
    pub(crate) at_once: [f64; 2],
    /// The records, by their names, with the current that flowed.
    pub(crate) records: Vec<Corrected>,
}

/// The reconstructed current of a record.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Corrected {
    pub(crate) run: String,
    /// Current that flowed at each sample, A.
    pub(crate) current_a: Vec<f64>,
    /// Errors of it that do not depend on each other, one standard deviation of each: A at every
    /// sample.
    pub(crate) errors_a: Vec<Vec<f64>>,
}

/// A record split where the voltage shows a step of the current.
struct Cut<'a> {
    run: &'a Run,
    record: &'a TimeRecord,
    /// Current by the model turned around, A.
    by_voltage_a: Vec<f64>,
    segments: Vec<Range<usize>>,
    largest_a: f64,
    /// Largest current that the channel shows where none flows, A.
    rest_a: f64,
    /// Standard deviation of a row of the log, A.
    row_a: f64,
}

/// A filter that is tried.
#[derive(Clone, Copy)]
struct Tried {
    form: Form,
    /// Rows are means until the next row.
    averaged: bool,
    /// None tries no filter.
    tau_s: f64,
}

/// The levels of a record under a filter.
#[derive(Default)]
struct Levels {
    level_a: Vec<f64>,
    each: Vec<Level>,
    squares: f64,
}

impl Levels {
    fn push(&mut self, one: &Level) {
        self.level_a.push(one.level_a);
        self.each.push(*one);
        self.squares += one.squares;
    }
}

/// The level of one segment under a filter.
#[derive(Clone, Copy)]
struct Level {
    level_a: f64,
    /// Σb²: how much of it the rows show.
    shown: f64,
    /// Standard deviation of it by the rows of the segment, with one standard deviation of a row as
    /// the unit: rows of one code share their error.
    own: f64,
    /// Its change by the filter's output at the start of the segment.
    inherited: f64,
    /// Part of the filter's output at the start that remains at the end.
    kept: f64,
    squares: f64,
    /// Current that the filter shows at the end, A.
    state_a: f64,
}

/// Finds the filter that the records share.
pub(crate) fn shared(set: &DataSet, model: &BaseModel) -> Option<Filter> {
    let mut cuts: Vec<Cut<'_>> = set
        .runs
        .iter()
        .filter_map(|run| Cut::new(run, set.history, model))
        .collect();
    let edges: usize = cuts.iter().map(|cut| cut.segments.len() - 1).sum();
    if edges < FILTER_FEWEST_EDGES {
        return None;
    }
    let none = Tried {
        form: Form::Plain,
        averaged: false,
        tau_s: 0.0,
    };
    // Levels shorter than a filter determine it poorly: if there are enough edges in records with
    // longer levels, those records decide.
    let telling = |cut: &&Cut<'_>| cut.typical_s() >= FILTER_SEGMENT_S;
    let steps_of = |cut: &Cut<'_>| cut.segments.len() - 1;
    let enough = cuts.iter().filter(telling).map(steps_of).sum::<usize>() >= FILTER_FEWEST_EDGES;
    if enough {
        // They come first, in the order of the set.
        cuts.sort_by_key(|cut| !telling(&cut));
    }
    let count = if enough {
        cuts.iter().filter(telling).count()
    } else {
        cuts.len()
    };
    let total = |cuts: &[Cut<'_>], tried: Tried| total_of(&cuts[..count], tried);
    let (low, high) = FILTER_TRIED_S;
    let step = (high / low).ln() / (FILTER_TRIES - 1) as f64;
    let forms = [Form::Plain, Form::Restart, Form::Mean]
        .into_iter()
        .flat_map(|form| [false, true].map(|averaged| (form, averaged)));
    // The best of each form on a coarse grid.
    let coarse: Vec<(Tried, f64)> = forms
        .filter_map(|(form, averaged)| {
            (0..FILTER_TRIES)
                .map(|k| Tried {
                    form,
                    averaged,
                    tau_s: low * (step * k as f64).exp(),
                })
                .map(|tried| (tried, total(&cuts, tried)))
                .min_by(|a, b| a.1.total_cmp(&b.1))
        })
        .collect();
    let rough = coarse.iter().map(|(_, squares)| *squares);
    if rough.fold(f64::INFINITY, f64::min) >= FILTER_LEFT_PART * total(&cuts, none) {
        return None;
    }
    let sharp = |cuts: &[Cut<'_>]| {
        let each = coarse.iter().map(|(tried, _)| {
            let at = |tau_s: f64| total(cuts, Tried { tau_s, ..*tried });
            let (tau_s, curvature, squares) = sharpened(at, tried.tau_s, step);
            (Tried { tau_s, ..*tried }, curvature, squares)
        });
        each.min_by(|a, b| a.2.total_cmp(&b.2))
    };
    let (first, ..) = sharp(&cuts)?;
    for cut in &mut cuts {
        cut.merge(first);
    }
    let without = total(&cuts, none);
    let (tried, curvature, squares) = sharp(&cuts)?;
    let tau_s = tried.tau_s;
    let rows: usize = cuts[..count].iter().map(Cut::rows).sum();
    let levels: usize = cuts[..count].iter().map(|cut| cut.segments.len()).sum();
    let variance = squares / rows.saturating_sub(levels + 1).max(1) as f64;
    let has_it =
        |cut: &&Cut<'_>| cut.levels(tried).squares < FILTER_LEFT_PART * cut.levels(none).squares;
    let asked = cuts[..count]
        .iter()
        .filter(|cut| cut.segments.len() > 1)
        .count();
    let filtered = cuts[..count]
        .iter()
        .filter(|cut| cut.segments.len() > 1 && has_it(cut))
        .count();
    let [by_voltage, by_log, after_s] = first_samples(&cuts[..count], tried);
    let shared = squares < FILTER_LEFT_PART * without
        && filtered >= 2.min(asked)
        && filtered as f64 >= FILTER_RECORDS_PART * asked as f64
        && by_voltage > FILTER_AT_ONCE
        && by_voltage > by_log
        && tau_s > FILTER_SLOWER * after_s;
    if !shared {
        return None;
    }
    // Small steps are a matter of the corrected current, and not of whether there is a filter.
    let edges = cuts.iter().map(|cut| cut.segments.len() - 1).sum();
    cuts.retain(|cut| {
        cut.segments.len() > 1 && cut.levels(tried).squares < cut.levels(none).squares
    });
    // The stated noise of a bench may be less than the scatter of its log about most levels.
    let scatter_a = median(cuts.iter().flat_map(|cut| cut.scatters_a(tried)).collect());
    for cut in &mut cuts {
        cut.row_a = cut.row_a.max(scatter_a);
        cut.split(tried);
    }
    let sigma_s = if curvature > 0.0 {
        tau_s * (2.0 * variance / curvature).sqrt()
    } else {
        f64::NAN
    };
    // The levels take up a part of the codes' error that their rows share.
    let code_a = set.history.map_or(0.0, |h| h.current_resolution_a);
    let rows: usize = cuts.iter().map(Cut::rows).sum();
    let levels: usize = cuts.iter().map(|cut| cut.segments.len()).sum();
    let left = total_of(&cuts, tried) / rows.saturating_sub(levels + 1).max(1) as f64;
    let sigma_a = left.sqrt().max(code_a * UNIFORM);
    Some(Filter {
        form: tried.form,
        tau_s,
        sigma_s,
        left: squares / without,
        edges,
        at_once: [by_voltage, by_log],
        records: cuts
            .iter()
            .map(|cut| cut.corrected(tried, sigma_a, sigma_s))
            .collect(),
    })
}

/// Squares that a filter leaves in all of them.
fn total_of(cuts: &[Cut<'_>], tried: Tried) -> f64 {
    cuts.iter().map(|cut| cut.levels(tried).squares).sum()
}

/// Returns the least of a function of a time near a first guess, by three points of a finer and
/// finer grid in its logarithm: place, second derivative and value.
fn sharpened(at: impl Fn(f64) -> f64, first_s: f64, first_step: f64) -> (f64, f64, f64) {
    let (mut best_s, mut step) = (first_s, first_step);
    let mut values = [f64::NAN; 3];
    for _ in 0..6 {
        values = [-1.0, 0.0, 1.0].map(|k: f64| at(best_s * (k * step).exp()));
        let bend = values[0] - 2.0 * values[1] + values[2];
        let moved = if bend > 0.0 {
            (0.5 * (values[0] - values[2]) / bend).clamp(-1.0, 1.0)
        } else if values[0] < values[2] {
            -1.0
        } else {
            1.0
        };
        best_s *= (moved * step).exp();
        step *= 0.5;
    }
    let value = at(best_s);
    // The last bend was taken at twice the step that is left.
    let bend = (values[0] - 2.0 * values[1] + values[2]) / (2.0 * step).powi(2);
    (best_s, bend, value)
}

/// Part of the large steps that voltage and log show in the first sample, and the time to the next
/// one, s.
fn first_samples(cuts: &[Cut<'_>], tried: Tried) -> [f64; 3] {
    let mut parts: [Vec<f64>; 3] = Default::default();
    for cut in cuts {
        let levels = cut.levels(tried).level_a;
        for (pair, segment) in levels.windows(2).zip(&cut.segments[1..]) {
            let step_a = pair[1] - pair[0];
            if step_a.abs() < LARGE_STEP_PART * cut.largest_a {
                continue;
            }
            let (k, series) = (segment.start, &cut.record.series);
            parts[0].push((cut.by_voltage_a[k] - cut.by_voltage_a[k - 1]) / step_a);
            parts[1].push((series.current_a[k] - series.current_a[k - 1]) / step_a);
            if let Some(next_s) = series.time_s.get(k + 1) {
                parts[2].push(next_s - series.time_s[k]);
            }
        }
    }
    // A filter that restarts shows a switch-off at once, so the lower quartile of the log is used.
    let [voltage, log, times] = &mut parts;
    [(voltage, 2), (log, 4), (times, 2)].map(|(all, part)| {
        all.sort_unstable_by(f64::total_cmp);
        all.get(all.len() / part).copied().unwrap_or(0.0)
    })
}

impl<'a> Cut<'a> {
    /// Returns `None` for a run that is not a record of a cell, or that has no numbers to simulate.
    fn new(run: &'a Run, history: Option<BenchHistory>, model: &BaseModel) -> Option<Self> {
        let RunData::Time(record) = &run.data else {
            return None;
        };
        if !matches!(run.fixture, Fixture::Cell(_)) || record.series.validate().is_err() {
            return None;
        }
        // Rows further apart than the slowest filter show none.
        if record.interval_s() > FILTER_TRIED_S.1 {
            return None;
        }
        let soc = run.start.soc(&model.ocv)?;
        let by_voltage_a = inverse(record, soc, model);
        let steps: Vec<f64> = by_voltage_a.windows(2).map(|w| w[1] - w[0]).collect();
        let mut sizes: Vec<f64> = steps.iter().map(|a| a.abs()).collect();
        sizes.sort_unstable_by(f64::total_cmp);
        // The lower quartile of a half-normal distribution: a profile may step at every other row.
        let quiet_a = sizes.get(sizes.len() / 4).copied().unwrap_or(0.0) / 0.3186;
        let stated_a = history.map_or(0.0, |h| {
            let noise_v = h
                .voltage_noise_v
                .hypot(h.voltage_resolution_v / 12f64.sqrt());
            2f64.sqrt() * noise_v / model.erm.r_ohm.max(f64::MIN_POSITIVE)
        });
        let largest_a = record
            .series
            .current_a
            .iter()
            .fold(0.0f64, |most, i| most.max(i.abs()));
        let least_a =
            (FILTER_EDGE_SIGMAS * quiet_a.max(stated_a)).max(FILTER_EDGE_PART * largest_a);
        let mut starts: Vec<usize> = vec![0];
        starts.extend(
            (1..=steps.len()).filter(|k| steps[k - 1].abs() > least_a || steps[k - 1].is_nan()),
        );
        let ends = starts.iter().skip(1).copied().chain([record.series.len()]);
        let segments = starts.iter().zip(ends).map(|(a, b)| *a..b).collect();
        (largest_a > 0.0 && by_voltage_a.iter().all(|a| a.is_finite())).then_some(Self {
            run,
            record,
            by_voltage_a,
            segments,
            largest_a,
            rest_a: history
                .map_or(0.0, |h| 3.0 * h.current_noise_a + h.current_resolution_a)
                .max(FILTER_REST_PART * largest_a),
            row_a: history.map_or(FILTER_REST_PART * largest_a / 3.0, |h| {
                h.current_noise_a.hypot(h.current_resolution_a * UNIFORM)
            }),
        })
    }

    /// Returns the median duration of a level, s.
    fn typical_s(&self) -> f64 {
        let time_s = &self.record.series.time_s;
        let mut spans_s: Vec<f64> = self
            .segments
            .iter()
            .filter_map(|segment| Some(time_s.get(segment.end)? - time_s[segment.start]))
            .collect();
        spans_s.sort_unstable_by(f64::total_cmp);
        spans_s.get(spans_s.len() / 2).copied().unwrap_or(0.0)
    }

    /// Returns whether the current has been switched off: the log shows this in all rows, and the
    /// voltage shows that a current had flowed.
    fn is_switched_off(&self, segment: &Range<usize>) -> bool {
        let currents = &self.record.series.current_a[segment.clone()];
        // The current may change between the rows of an edge, so the next row is used.
        let next = (segment.start + self.skipped(segment)).min(segment.end - 1);
        let [before_a, now_a] = [segment.start - 1, next].map(|k| self.by_voltage_a[k]);
        currents.iter().all(|i| i.abs() < self.rest_a)
            && now_a.abs() < FILTER_OFF_PART * before_a.abs()
    }

    /// Returns the number of rows that determine a level.
    fn rows(&self) -> usize {
        let counted = |segment: &Range<usize>| segment.len() - self.skipped(segment);
        self.segments.iter().map(counted).sum()
    }

    /// Rows at the start of a segment that may be read while the current changes.
    fn skipped(&self, segment: &Range<usize>) -> usize {
        usize::from(
            self.record.between == Between::Linear && segment.start > 0 && segment.len() > 1,
        )
    }

    /// When the current of a segment began, s.
    fn begun_s(&self, segment: &Range<usize>) -> f64 {
        let (t, k) = (&self.record.series.time_s, segment.start);
        match self.record.between {
            Between::Linear if k > 0 => 0.5 * (t[k - 1] + t[k]),
            _ => t[k],
        }
    }

    /// Fits one level to each segment, from the first on.
    fn levels(&self, tried: Tried) -> Levels {
        let mut found = Levels::default();
        let mut state_a = 0.0;
        for segment in &self.segments {
            let one = self.level(tried, segment, &found.level_a, state_a);
            state_a = one.state_a;
            found.push(&one);
        }
        found
    }

    /// Fits the level of a segment after those before it; the filter shows `state_a` at its start.
    fn level(&self, tried: Tried, segment: &Range<usize>, before_a: &[f64], state_a: f64) -> Level {
        let series = &self.record.series;
        let is_filtered = segment.start > 0 && tried.tau_s > 0.0;
        let begun_s = self.begun_s(segment);
        let of = |k: usize| -> (f64, f64) {
            if !is_filtered {
                return (0.0, 1.0);
            }
            let since_s = series.time_s[k] - begun_s;
            let step_s = if tried.averaged {
                let last = series.len() - 1;
                series.time_s[(k + 1).min(last)] - series.time_s[k.min(last - 1)]
            } else {
                0.0
            };
            match tried.form {
                Form::Mean => self.mean(before_a, tried.tau_s, since_s + 0.5 * step_s),
                _ => {
                    let old = decay(since_s, step_s, tried.tau_s);
                    (old * state_a, 1.0 - old)
                }
            }
        };
        // The averaging time of the last row is not known.
        let last = usize::from(tried.averaged && segment.end == series.len() && segment.len() > 1);
        let rows = segment.start + self.skipped(segment)..segment.end - last;
        let (mut along, mut shown, mut old) = (0.0, 0.0, 0.0);
        // Σb of the rows of one code, and the sum of its squares over all codes.
        let (mut of_code, mut of_codes) = (0.0, 0.0);
        for k in rows.clone() {
            let (known, part) = of(k);
            along += part * (series.current_a[k] - known);
            shown += part * part;
            old += part * (1.0 - part);
            if k > rows.start && series.current_a[k] != series.current_a[k - 1] {
                of_codes += of_code * of_code;
                of_code = 0.0;
            }
            of_code += part;
        }
        of_codes += of_code * of_code;
        let level_a = if shown > 0.0 { along / shown } else { state_a };
        let squares = rows
            .clone()
            .map(|k| {
                let (known, part) = of(k);
                (series.current_a[k] - known - part * level_a).powi(2)
            })
            .sum();
        let per_shown = if shown > 0.0 { 1.0 / shown } else { 0.0 };
        let end_s = series.time_s.get(segment.end).map_or(f64::INFINITY, |_| {
            self.begun_s(&(segment.end..segment.end + 1))
        });
        let kept = if is_filtered && tried.form != Form::Mean {
            (-(end_s - begun_s) / tried.tau_s).exp()
        } else {
            0.0
        };
        let on = Level {
            level_a,
            shown,
            own: of_codes.sqrt() * per_shown,
            inherited: match shown > 0.0 {
                _ if !is_filtered => 0.0,
                true => -old * per_shown,
                false => 1.0,
            },
            kept,
            squares,
            state_a: level_a + (state_a - level_a) * kept,
        };
        if tried.form == Form::Restart && is_filtered && self.is_switched_off(segment) {
            let off = self.switched_off(&rows);
            // A short pulse that the filter hardly shows is not a rest.
            if off.squares < on.squares + (FILTER_MERGE_SIGMAS * self.row_a).powi(2) {
                return off;
            }
        }
        on
    }

    /// Returns the level of a rest in which the log is at it from the first row on.
    fn switched_off(&self, rows: &Range<usize>) -> Level {
        let currents = &self.record.series.current_a[rows.clone()];
        let count = rows.len().max(1) as f64;
        let level_a = currents.iter().sum::<f64>() / count;
        Level {
            level_a,
            shown: count,
            own: 1.0,
            inherited: 0.0,
            kept: 0.0,
            squares: currents.iter().map(|i| (i - level_a).powi(2)).sum(),
            state_a: level_a,
        }
    }

    /// Returns the standard deviation of the rows about each level that lasts.
    fn scatters_a(&self, tried: Tried) -> Vec<f64> {
        let levels = self.levels(tried);
        let each = self.segments.iter().zip(&levels.each);
        each.filter(|(segment, _)| segment.len() >= LASTING_ROWS)
            .map(|(segment, level)| (level.squares / (segment.len() - 1) as f64).sqrt())
            .collect()
    }

    /// Splits segments where the log, with the filter known, shows a step of the current: the
    /// voltage does not show every small step.
    fn split(&mut self, tried: Tried) {
        if tried.form == Form::Mean {
            return;
        }
        let worth = (FILTER_SPLIT_SIGMAS * self.row_a).powi(2);
        let (mut k, mut state_a) = (0, 0.0);
        while k < self.segments.len() {
            let segment = self.segments[k].clone();
            let whole = self.level(tried, &segment, &[], state_a);
            let halves = |at: usize| {
                let first = self.level(tried, &(segment.start..at), &[], state_a);
                let second = self.level(tried, &(at..segment.end), &[], first.state_a);
                (at, first, second)
            };
            let squares =
                |(_, first, second): &(usize, Level, Level)| first.squares + second.squares;
            let is_step = |cut: &(usize, Level, Level)| {
                let (_, first, second) = cut;
                let error_a = self.row_a * first.own.hypot(second.own);
                whole.squares - squares(cut) > worth
                    && first.shown > 0.0
                    && second.shown > 0.0
                    && (second.level_a - first.level_a).abs() > FILTER_SPLIT_SIGMAS * error_a
            };
            // A misfit below one step's worth hides none. Long levels are looked at in steps first.
            let step = (segment.len() / SPLIT_TRIES).max(1);
            let best = |places: &mut dyn Iterator<Item = usize>| {
                places
                    .map(halves)
                    .filter(is_step)
                    .min_by(|a, b| squares(a).total_cmp(&squares(b)))
            };
            let places = segment.start + 2..segment.end.saturating_sub(1);
            let coarse = if whole.squares > worth {
                best(&mut places.clone().step_by(step))
            } else {
                None
            };
            let cut = coarse.and_then(|(at, ..)| {
                let near = at.saturating_sub(step).max(places.start)..(at + step).min(places.end);
                best(&mut near.into_iter())
            });
            match cut {
                Some((at, ..)) => {
                    self.segments[k].end = at;
                    self.segments.insert(k + 1, at..segment.end);
                }
                _ => {
                    state_a = whole.state_a;
                    k += 1;
                }
            }
        }
    }

    /// Returns the mean over the last seconds at a time since the start of the next segment: the
    /// contribution of the known levels, and the part of the new one.
    fn mean(&self, level_a: &[f64], length_s: f64, since_s: f64) -> (f64, f64) {
        let part = (since_s / length_s).min(1.0);
        let Some(next) = self.segments.get(level_a.len()) else {
            return (0.0, 1.0);
        };
        let now_s = self.begun_s(next) + since_s;
        let from_s = now_s - length_s;
        let (mut known, mut end_s) = (0.0, self.begun_s(next));
        for (k, level) in level_a.iter().enumerate().rev() {
            let start_s = if k == 0 {
                f64::NEG_INFINITY
            } else {
                self.begun_s(&self.segments[k])
            };
            let overlap_s = end_s - start_s.max(from_s);
            if overlap_s <= 0.0 {
                break;
            }
            known += level * overlap_s / length_s;
            end_s = start_s;
        }
        (known, part)
    }

    /// Joins segments whose levels agree within their errors: not every jump of the voltage is a
    /// step.
    fn merge(&mut self, tried: Tried) {
        loop {
            let levels = self.levels(tried);
            let free = self.rows().saturating_sub(self.segments.len()).max(1);
            let sigma_a = (levels.squares / free as f64).sqrt();
            let is_alike = |k: &usize| {
                let error_a = sigma_a
                    * (1.0 / levels.each[k - 1].shown.max(f64::MIN_POSITIVE)
                        + 1.0 / levels.each[*k].shown.max(f64::MIN_POSITIVE))
                    .sqrt();
                (levels.level_a[*k] - levels.level_a[k - 1]).abs() < FILTER_MERGE_SIGMAS * error_a
            };
            let jump_a = |k: &usize| {
                let start = self.segments[*k].start;
                (self.by_voltage_a[start] - self.by_voltage_a[start - 1]).abs()
            };
            // A level that lasts is determined well enough to be kept.
            let is_short = |k: usize| {
                let (time_s, segment) = (&self.record.series.time_s, &self.segments[k]);
                let end_s = time_s.get(segment.end).copied().unwrap_or(f64::INFINITY);
                end_s - time_s[segment.start] < FILTER_SHORT_PART * tried.tau_s
            };
            // The smallest jump first: a short segment may be like both of its neighbours.
            let alike = (1..self.segments.len())
                .filter(|k| {
                    (is_short(*k) || is_short(k - 1))
                        && jump_a(k) < LARGE_STEP_PART * self.largest_a
                        && is_alike(k)
                })
                .min_by(|a, b| jump_a(a).total_cmp(&jump_a(b)));
            let Some(k) = alike else {
                return;
            };
            self.segments[k - 1].end = self.segments[k].end;
            self.segments.remove(k);
        }
    }

    /// Returns the current with its errors, for an error `sigma_a` of a row and an error
    /// `tau_sigma_s` of the time constant.
    fn corrected(&self, tried: Tried, sigma_a: f64, tau_sigma_s: f64) -> Corrected {
        let levels = self.levels(tried);
        let of_samples = |of_levels: &[f64]| {
            let mut samples_a = vec![0.0; self.record.series.len()];
            for (segment, a) in self.segments.iter().zip(of_levels) {
                samples_a[segment.clone()].fill(*a);
            }
            samples_a
        };
        // An error of one level is taken over by the next ones with the filter's state.
        let error_of = |first: usize| {
            let mut errors_a = vec![0.0; levels.level_a.len()];
            let mut state_a = 0.0;
            for ((k, level), error_a) in levels
                .each
                .iter()
                .enumerate()
                .zip(&mut errors_a)
                .skip(first)
            {
                // A level that no row shows is not known at all.
                let own_a = match level {
                    _ if k != first => 0.0,
                    level if level.shown > 0.0 => sigma_a * level.own,
                    _ => self.largest_a,
                };
                *error_a = own_a + level.inherited * state_a;
                state_a = *error_a + (state_a - *error_a) * level.kept;
            }
            of_samples(&errors_a)
        };
        let later = self.levels(Tried {
            tau_s: tried.tau_s + tau_sigma_s,
            ..tried
        });
        let by_tau: Vec<f64> = later
            .level_a
            .iter()
            .zip(&levels.level_a)
            .map(|(later, own)| later - own)
            .collect();
        // More independent errors than rows of a comparison add no information. Neighbours are then
        // summed as if all had the same sign.
        let together = levels.level_a.len().div_ceil(2 * MOST_BINS).max(1);
        let starts = (0..levels.level_a.len()).step_by(together);
        let mut errors_a: Vec<Vec<f64>> = starts
            .map(|from| {
                let mut sum = error_of(from);
                for k in from + 1..(from + together).min(levels.level_a.len()) {
                    sum.iter_mut().zip(error_of(k)).for_each(|(s, e)| *s += e);
                }
                sum
            })
            .collect();
        if tau_sigma_s.is_finite() {
            errors_a.push(of_samples(&by_tau));
        }
        Corrected {
            run: self.run.name.clone(),
            current_a: of_samples(&levels.level_a),
            errors_a,
        }
    }
}

/// Returns the part of the old state that a first-order filter still shows at a time after a step,
/// as the mean over the following interval.
fn decay(since_s: f64, step_s: f64, tau_s: f64) -> f64 {
    let now = (-since_s.max(0.0) / tau_s).exp();
    if step_s > 0.0 {
        now * -(-step_s / tau_s).exp_m1() * tau_s / step_s
    } else {
        now
    }
}

/// Returns the current that the model needs for the voltage of each sample, A, taken as constant
/// since the sample before. The charge is that of the logged current, for a filter loses none.
fn inverse(record: &TimeRecord, soc: f64, model: &BaseModel) -> Vec<f64> {
    let series = &record.series;
    let erm = &model.erm;
    let mut branch_v = vec![0.0; erm.branches.len()];
    let mut soc = soc;
    let level_v = model.ocv.voltage_v(soc) - series.voltage_v[0];
    let largest_a = series
        .current_a
        .iter()
        .fold(0.0f64, |most, i| most.max(i.abs()));
    let begins_at_rest = series.current_a[0].abs() < FILTER_REST_PART * largest_a;
    let level_v = if begins_at_rest { level_v } else { 0.0 };
    let mut all: Vec<f64> = Vec::with_capacity(series.len());
    // Current that flows on until the next sample, A.
    let mut flowing_a = 0.0;
    for k in 0..series.len() {
        let step_s = if k > 0 {
            series.time_s[k] - series.time_s[k - 1]
        } else {
            0.0
        };
        if k > 0 {
            let mean_a = match record.between {
                Between::Hold => series.current_a[k - 1],
                Between::Linear => 0.5 * (series.current_a[k - 1] + series.current_a[k]),
            };
            soc -= mean_a * step_s / (3600.0 * model.ocv.capacity_ah);
        }
        let old = |time_constant_s: f64| (-step_s / time_constant_s).exp();
        let (mut of_branches_v, mut ohm) = (0.0, erm.r_ohm);
        for (v, branch) in branch_v.iter_mut().zip(&erm.branches) {
            let old = old(branch.time_constant_s());
            *v *= old;
            match record.between {
                // The new current begins with its sample.
                Between::Hold => *v += (1.0 - old) * branch.r_ohm * flowing_a,
                // It began somewhere since the sample before.
                Between::Linear => ohm += (1.0 - old) * branch.r_ohm,
            }
            of_branches_v += *v;
        }
        let open_v = model.ocv.voltage_v(soc) - level_v;
        let current_a = (open_v - of_branches_v - series.voltage_v[k]) / ohm;
        if record.between == Between::Linear {
            for (v, branch) in branch_v.iter_mut().zip(&erm.branches) {
                *v += (1.0 - old(branch.time_constant_s())) * branch.r_ohm * current_a;
            }
        }
        // Only a part of the deviation of the model, so that it does not oscillate over long steps.
        flowing_a = if (current_a - flowing_a).abs() > FILTER_SWING_PART * largest_a {
            current_a
        } else {
            0.75 * flowing_a + 0.25 * current_a
        };
        all.push(current_a);
    }
    all
}

impl Filter {
    /// Returns whether this run has it.
    pub(crate) fn holds(&self, run: &str) -> bool {
        self.records.iter().any(|own| own.run == run)
    }

    /// Returns the correction as text.
    pub(crate) fn describe(&self) -> String {
        format!(
            "the current of {} records was corrected for {} of {:.3} ± {:.3} s, as accepted: all \
            results depend on the corrected current; the files contain the logged one",
            self.records.len(),
            self.form,
            self.tau_s,
            self.sigma_s
        )
    }

    /// Returns the data with the reconstructed current in place of the logged one, and with its
    /// errors.
    pub(crate) fn corrected(&self, set: &DataSet) -> DataSet {
        let mut set = set.clone();
        for run in &mut set.runs {
            if let (RunData::Time(record), Some(own)) = (
                &mut run.data,
                self.records.iter().find(|own| own.run == run.name),
            ) {
                record.series.current_a.clone_from(&own.current_a);
                record.current_errors_a.clone_from(&own.errors_a);
            }
        }
        set
    }
}

#[cfg(test)]
mod tests;
