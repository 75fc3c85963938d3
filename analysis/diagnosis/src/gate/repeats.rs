//! Checks for repeats that end early, or that differ by far more than the bench's history allows.

use super::super::data::{Fixture, TimeRecord};
use super::{Check, Findings, Inspection, Reason, Subject};
use crate::median::median;
use crate::thresholds::{
    ASIDE_PART, AT_EDGES_PART, CELL_CHANGE_Z, DRIFT_CORRELATION, DRIFT_MOST_Z, FEWEST_TO_DRIFT,
    MOST_ODD_STEPS, ODD_STEP_PART, ODD_STEP_S, REPEAT_FAR_OFF_Z, REPEAT_FLOWS_PART, SAME_TIME_S,
    STEADY_PART, WHOLE_RUN_PART, WITH_CELL_TIMES,
};
use analysis_signal::history::BenchHistory;

pub(super) fn truncated(at: &Inspection<'_>) -> Findings {
    let mut found = Findings::default();
    for subject in &at.runs {
        let mut fault = None;
        for other in repeats(at, subject) {
            fault = match (subject.record(), other.record()) {
                (Some((own, _)), Some((theirs, _))) => cut_record(own, theirs),
                _ => cut_sweep(subject, other),
            };
            if fault.is_some() {
                break;
            }
        }
        if let Some(text) = fault {
            found.add(Check::Truncated, subject.run, text);
        }
    }
    found
}

fn repeats<'a>(
    at: &'a Inspection<'_>,
    subject: &'a Subject<'_>,
) -> impl Iterator<Item = &'a Subject<'a>> {
    at.runs.iter().filter(|other| {
        other.run.repeat_group == subject.run.repeat_group && other.run.name != subject.run.name
    })
}

fn cut_record(own: &TimeRecord, theirs: &TimeRecord) -> Option<String> {
    let last = |r: &TimeRecord| r.series.time_s.last().copied().unwrap_or(0.0);
    let (own_s, their_s) = (last(own), last(theirs));
    let greatest_a = theirs
        .series
        .current_a
        .iter()
        .fold(0.0f64, |most, i| most.max(i.abs()));
    let missing = theirs
        .series
        .time_s
        .iter()
        .zip(&theirs.series.current_a)
        .filter(|(t, _)| **t > own_s);
    let flows = missing
        .into_iter()
        .any(|(_, i)| i.abs() > REPEAT_FLOWS_PART * greatest_a);
    (own_s < WHOLE_RUN_PART * their_s && flows)
        .then(|| format!("it ends after {own_s:.1} s, its repeats last {their_s:.1} s: cut off"))
}

fn cut_sweep(own: &Subject<'_>, other: &Subject<'_>) -> Option<String> {
    let (own, theirs) = (own.sweep()?.0.points.len(), other.sweep()?.0.points.len());
    ((own as f64) < WHOLE_RUN_PART * theirs as f64)
        .then(|| format!("it holds {own} points, its repeats {theirs}: cut off"))
}

/// Returns a clock that jumps by less than the distance of two samples: their number is that of the
/// repeats, and all steps but one or few are.
pub(super) fn clock(at: &Inspection<'_>) -> Findings {
    let mut found = Findings::default();
    for subject in &at.runs {
        let Some((own, _)) = subject.record() else {
            continue;
        };
        let theirs: Vec<Vec<usize>> = repeats(at, subject)
            .filter_map(|other| odd_steps(own, other.record()?.0))
            .collect();
        let Some((first, rest)) = theirs.split_first() else {
            continue;
        };
        // Of two runs, neither is known to be the right one.
        if let Some(k) = first
            .first()
            .filter(|_| !rest.is_empty() && rest.iter().all(|odd| odd == first))
        {
            let time_s = &own.series.time_s;
            let step_s = time_s[k + 1] - time_s[*k];
            let text = format!(
                "after {:.2} s its clock jumps: none of its repeats has a step of {step_s:.3} s \
                there",
                time_s[*k]
            );
            found.add(Check::TimesGoBack, subject.run, text);
        }
    }
    found
}

/// Returns steps of time that differ from the repeat's, or `None` if the numbers of samples differ,
/// or more than a few steps.
fn odd_steps(own: &TimeRecord, theirs: &TimeRecord) -> Option<Vec<usize>> {
    let steps = |r: &TimeRecord| {
        r.series
            .time_s
            .windows(2)
            .map(|w| w[1] - w[0])
            .collect::<Vec<f64>>()
    };
    let (own, theirs) = (steps(own), steps(theirs));
    let odd = |k: &usize| {
        (own[*k] - theirs[*k]).abs() > ODD_STEP_PART * own[*k].max(theirs[*k]) + ODD_STEP_S
    };
    let all: Vec<usize> = if own.len() == theirs.len() {
        (0..own.len()).filter(odd).collect()
    } else {
        return None;
    };
    (all.len() <= MOST_ODD_STEPS).then_some(all)
}

pub(super) fn check(at: &Inspection<'_>) -> Findings {
    let mut found = Findings::default();
    let Some(history) = at.set.history else {
        return found;
    };
    let mut groups: Vec<&str> = at
        .runs
        .iter()
        .map(|subject| subject.run.repeat_group.as_str())
        .collect();
    groups.sort_unstable();
    groups.dedup();
    let groups: Vec<Repeats<'_>> = groups
        .iter()
        .map(|group| {
            let members: Vec<&Subject<'_>> = at
                .runs
                .iter()
                .filter(|subject| subject.run.repeat_group == *group)
                .collect();
            Repeats::new(&members, &history)
        })
        .collect();
    let drifting: Vec<(f64, f64)> = groups
        .iter()
        .filter(|group| group.of_cell() && group.z() > CELL_CHANGE_Z && steady(&group.off))
        .map(|group| (group.per_s(), group.span_s()))
        .collect();
    for group in groups {
        let z = group.z();
        let far: Vec<String> = group
            .off
            .iter()
            .zip(&group.size)
            .filter(|(_, z)| **z > REPEAT_FAR_OFF_Z)
            .map(|(off, _)| off.0.run.name.clone())
            .collect();
        // Two runs alone do not show a direction, but the other runs of the cell in the same period
        // do.
        let follows = |(per_s, span_s): &(f64, f64)| {
            group.span_s() <= *span_s && group.per_s() < WITH_CELL_TIMES * per_s
        };
        let with_the_cell = group.off.len() == 2
            && z < DRIFT_MOST_Z
            && group.of_cell()
            && drifting.iter().any(follows);
        let drifted =
            steady(&group.off) || with_the_cell || (z < DRIFT_MOST_Z && drifts(group.off));
        if !far.is_empty() && !drifted {
            let text = format!(
                "it differs from its repeats by {z:.0} standard deviations of the bench's history"
            );
            found.invalid.push(Reason {
                check: Check::Repeats,
                runs: far,
                text,
            });
        }
    }
    found
}

/// A group of repeats: how far each is from the others, and the size of that in standard
/// deviations.
struct Repeats<'a> {
    off: Vec<(&'a Subject<'a>, Vec<Apart>)>,
    size: Vec<f64>,
}

impl<'a> Repeats<'a> {
    fn new(members: &[&'a Subject<'a>], history: &BenchHistory) -> Self {
        let off: Vec<(&Subject<'_>, Vec<Apart>)> = members
            .iter()
            .map(|subject| (*subject, apart(subject, members, history)))
            .collect();
        let size = off
            .iter()
            .map(|(_, apart)| {
                trimmed_root(apart.iter().map(|(re, im)| re * re + im * im).collect())
            })
            .collect();
        Self { off, size }
    }

    fn z(&self) -> f64 {
        self.size.iter().copied().fold(0.0, f64::max)
    }

    fn of_cell(&self) -> bool {
        self.off
            .iter()
            .all(|(subject, _)| matches!(subject.run.fixture, Fixture::Cell(_)))
    }

    /// Returns the time between the first and the last, s.
    fn span_s(&self) -> f64 {
        let starts = self.off.iter().map(|(subject, _)| subject.run.start_s);
        let (begin_s, end_s) = starts.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| {
            (a.min(t), b.max(t))
        });
        end_s - begin_s
    }

    /// Returns the standard deviations between the farthest of the group per time between the first
    /// and the last, 1/s. Two lie on both sides of their mean.
    fn per_s(&self) -> f64 {
        2.0 * self.z() / self.span_s()
    }
}

/// A difference in standard deviations: real and imaginary part, or a voltage and nothing.
type Apart = (f64, f64);

/// Returns whether a group of three or more moves from one side of its middle to the other in the
/// order of time.
fn drifts(mut off: Vec<(&Subject<'_>, Vec<Apart>)>) -> bool {
    off.sort_by_key(|(subject, _)| subject.run.order);
    let (Some((_, first)), Some((_, last))) = (off.first(), off.last()) else {
        return false;
    };
    let dot = |a: &[Apart], b: &[Apart]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| a.0 * b.0 + a.1 * b.1)
            .sum::<f64>()
    };
    off.len() >= FEWEST_TO_DRIFT
        && dot(first, last) < DRIFT_CORRELATION * (dot(first, first) * dot(last, last)).sqrt()
}

/// Returns whether a group of three or more moves from the first to the last in proportion to time.
fn steady(off: &[(&Subject<'_>, Vec<Apart>)]) -> bool {
    let mut runs: Vec<(f64, &[Apart])> = off
        .iter()
        .map(|(subject, apart)| (subject.run.start_s, apart.as_slice()))
        .collect();
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (Some((begin_s, first)), Some((end_s, last))) =
        (runs.first().copied(), runs.last().copied())
    else {
        return false;
    };
    let less = |a: &[Apart], b: &[Apart]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| (a.0 - b.0, a.1 - b.1))
            .collect::<Vec<Apart>>()
    };
    let dot = |a: &[Apart], b: &[Apart]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| a.0 * b.0 + a.1 * b.1)
            .sum::<f64>()
    };
    let whole = less(last, first);
    let size = dot(&whole, &whole);
    let on_the_way = |(at_s, apart): &(f64, &[Apart])| {
        let moved = less(apart, first);
        let part = dot(&moved, &whole) / size;
        let aside = (dot(&moved, &moved) - part * part * size).max(0.0);
        (part - (at_s - begin_s) / (end_s - begin_s)).abs() < STEADY_PART
            && aside < ASIDE_PART * ASIDE_PART * size
    };
    runs.len() >= FEWEST_TO_DRIFT
        && end_s > begin_s
        && size > 0.0
        && runs.iter().all(|(_, a)| a.len() == whole.len())
        && runs.iter().all(on_the_way)
}

/// Returns the distance of a run from the median of its group (of two: from their mean), in
/// standard deviations of the history.
fn apart(subject: &Subject<'_>, members: &[&Subject<'_>], history: &BenchHistory) -> Vec<Apart> {
    if let Some((own, expected_v)) = subject.record() {
        let like: Vec<(&TimeRecord, &[f64])> = members
            .iter()
            .filter_map(|m| m.record())
            .filter(|(r, _)| same_times(r, own))
            .collect();
        if like.len() < 2 {
            return Vec::new();
        }
        let apart = (0..expected_v.len()).map(|k| {
            // Repeats begin at the state that the previous run left: the missing parts of the model
            // are equal in all, its expectation is not.
            let left_v = |(record, expected_v): &(&TimeRecord, &[f64])| {
                record.series.voltage_v[k] - expected_v[k]
            };
            let middle_v = median(like.iter().map(left_v).collect());
            let drop_v = expected_v[k] - expected_v[0];
            let level = history.voltage_noise_v.powi(2)
                + history.voltage_offset_v.powi(2)
                + history.voltage_drift_v.powi(2);
            let code = history.voltage_resolution_v.powi(2) / 12.0;
            let stated = own
                .sigma_v
                .as_ref()
                .map_or(0.0, |sigma_v| sigma_v[k].powi(2));
            let size = (history.resistance_rel.powi(2) + history.current_gain_rel.powi(2))
                * drop_v
                * drop_v;
            // A zero error of the current is counted as charge all the time.
            let zero_v = history.current_offset_a
                * subject.counted_wrong_v(own.series.time_s[k] - own.series.time_s[0]);
            (
                (left_v(&(own, expected_v)) - middle_v)
                    / (level + code + stated + size + zero_v * zero_v).sqrt(),
                0.0,
            )
        });
        return apart.collect();
    }
    let Some((own, _)) = subject.sweep() else {
        return Vec::new();
    };
    let same = |s: &&super::super::data::Sweep| {
        s.points
            .iter()
            .map(|p| p.freq_hz)
            .eq(own.points.iter().map(|p| p.freq_hz))
    };
    let like: Vec<_> = members
        .iter()
        .filter_map(|m| m.sweep())
        .map(|(s, _)| s)
        .filter(same)
        .collect();
    if like.len() < 2 {
        return Vec::new();
    }
    let apart = (0..own.points.len()).map(|k| {
        let middle = |part: fn(&num_complex::Complex64) -> f64| {
            median(like.iter().map(|s| part(&s.points[k].z_ohm)).collect())
        };
        let (re, im) = (middle(|z| z.re), middle(|z| z.im));
        let z = own.points[k].z_ohm;
        let sigma = history.eis_noise_rel.hypot(history.resistance_rel) * re.hypot(im);
        ((z.re - re) / sigma, (z.im - im) / sigma)
    });
    apart.collect()
}

fn same_times(a: &TimeRecord, b: &TimeRecord) -> bool {
    let (a, b) = (&a.series.time_s, &b.series.time_s);
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < SAME_TIME_S)
}

/// Returns the root of the mean of all but the largest; zero if the history states no noise at all.
fn trimmed_root(mut squares: Vec<f64>) -> f64 {
    squares.retain(|s| s.is_finite());
    squares.sort_unstable_by(f64::total_cmp);
    squares.truncate(((1.0 - AT_EDGES_PART) * squares.len() as f64).ceil() as usize);
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
}
