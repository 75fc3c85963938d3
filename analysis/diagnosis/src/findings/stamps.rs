//! Time stamps that are rounded, and samples too far apart for what the model knows or for the
//! current.

use std::ops::Range;

use super::finding::{Finding, FindingKind, names};
use super::scene::{Played, Scene};
use crate::gate::median;
use crate::thresholds::{
    GAP_CHANGES_PART, LARGE_STEP_PART, ROUNDED_FEWEST, ROUNDED_MOST_QUANTA, ROUNDED_PART,
    SLOW_BRANCH_PART, SLOW_SHARE, UNSEEN_CORRELATION,
};
use analysis_effects::augmented::Between;

pub(super) fn rounded(scene: &Scene<'_>) -> Vec<Finding> {
    let all: Vec<(Played<'_>, f64, f64)> = scene
        .records()
        .filter_map(|played| {
            let (quantum_s, part) = rounding(&played)?;
            Some((played, quantum_s, part))
        })
        .collect();
    let Some((_, quantum_s, part)) = all.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else {
        return Vec::new();
    };
    let runs: Vec<String> = all.iter().map(|(p, ..)| p.run.name.clone()).collect();
    vec![Finding {
        kind: FindingKind::StampsRounded,
        text: format!(
            "{}: time stamps are rounded to {quantum_s} s, more than the distance of the samples \
            scatters by",
            names(&runs)
        ),
        how_sure: format!(
            "{:.0} % of the steps differ from the one before by exactly {quantum_s} s",
            100.0 * part
        ),
        effect: format!(
            "An edge of the current is wrong by up to {} s. A fast branch, a skew of the channels \
            and a lag of the current show it.",
            0.5 * quantum_s
        ),
        runs,
        correctable: false,
    }]
}

/// The quantum of stamps, s, and the part of steps that it makes uneven; none where the sampling is
/// as even as the stamps.
fn rounding(played: &Played<'_>) -> Option<(f64, f64)> {
    const QUANTA_S: [f64; 10] = [10.0, 5.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.001];
    let series = &played.record.series;
    let steps: Vec<f64> = series.time_s.windows(2).map(|w| w[1] - w[0]).collect();
    let is_multiple = |h: &f64, q: f64| {
        let n = h / q;
        n > 0.5 && (n - n.round()).abs() < 1e-4
    };
    let quantum_s = QUANTA_S
        .into_iter()
        .find(|q| steps.iter().all(|h| is_multiple(h, *q)))?;
    // A step that is one quantum longer or shorter than the one before, there and back.
    let quanta: Vec<i64> = steps
        .iter()
        .map(|h| (h / quantum_s).round() as i64)
        .collect();
    // A logger that samples at edges too is not uneven by rounding.
    let largest_a = played.largest_a();
    let (low_v, high_v) = series
        .voltage_v
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(*v), h.max(*v))
        });
    let still = |rows: &[f64], size: f64| {
        rows.windows(2)
            .all(|w| (w[1] - w[0]).abs() < GAP_CHANGES_PART * size)
    };
    // The voltage sees an edge that the log has smoothed.
    let is_quiet = |rows: Range<usize>| {
        still(&series.current_a[rows.clone()], largest_a)
            && still(&series.voltage_v[rows], high_v - low_v)
    };
    let uneven = quanta
        .windows(3)
        .enumerate()
        .filter(|(first, w)| {
            let around = first.saturating_sub(1)..(first + 5).min(series.len());
            let most = w.iter().max().copied().unwrap_or(0);
            (w[1] - w[0]).abs() == 1
                && (w[2] - w[1]) * (w[1] - w[0]) <= 0
                && most <= ROUNDED_MOST_QUANTA as i64
                && is_quiet(around)
        })
        .count();
    let part = uneven as f64 / quanta.len().max(1) as f64;
    (uneven >= ROUNDED_FEWEST && part >= ROUNDED_PART).then_some((quantum_s, part))
}

pub(super) fn slow(scene: &Scene<'_>) -> Vec<Finding> {
    let erm = &scene.model.erm;
    let all: Vec<(String, f64)> = scene
        .of_cells()
        .filter(|played| played.record.between == Between::Linear)
        .filter_map(|played| Some((played.run.name.clone(), at_edges_s(&played)?)))
        .collect();
    let share_of = |interval_s: f64| {
        erm.branches
            .iter()
            .filter(|b| b.time_constant_s() < SLOW_BRANCH_PART * interval_s)
            .map(|b| b.r_ohm)
            .sum::<f64>()
            / erm.dc_resistance_ohm()
    };
    let slow: Vec<&(String, f64)> = all
        .iter()
        .filter(|(_, interval_s)| share_of(*interval_s) > SLOW_SHARE)
        .collect();
    if slow.is_empty() {
        return Vec::new();
    }
    let runs: Vec<String> = slow.iter().map(|(name, _)| name.clone()).collect();
    let typical_s = median(slow.iter().map(|(_, s)| *s).collect());
    vec![Finding {
        kind: FindingKind::SamplingSlow,
        text: format!(
            "{}: samples at edges of the current are {typical_s:.3} s apart in the middle; \
            branches faster than {:.3} s hold {:.0} % of the model's resistance",
            names(&runs),
            SLOW_BRANCH_PART * typical_s,
            100.0 * share_of(typical_s)
        ),
        how_sure: "certain: stamps against the model's time constants".to_owned(),
        effect: "These records cannot tell such a branch from the series resistance, nor a fast \
            effect from an edge between two samples."
            .to_owned(),
        runs,
        correctable: false,
    }]
}

/// Records whose current does something else from one sample to the next.
pub(super) fn unseen(scene: &Scene<'_>) -> Vec<Finding> {
    let all: Vec<(String, f64)> = scene
        .of_cells()
        .filter(|played| played.record.between == Between::Linear)
        .filter_map(|played| Some((played.run.name.clone(), correlation(&played)?)))
        .filter(|(_, correlation)| *correlation < UNSEEN_CORRELATION)
        .collect();
    if all.is_empty() {
        return Vec::new();
    }
    let greatest = all
        .iter()
        .fold(f64::NEG_INFINITY, |most, (_, c)| most.max(*c));
    let runs: Vec<String> = all.into_iter().map(|(name, _)| name).collect();
    vec![Finding {
        kind: FindingKind::CurrentUnseen,
        text: format!(
            "{}: the current changes faster than it is logged; what it was between two samples is \
            not known",
            names(&runs)
        ),
        how_sure: format!(
            "certain: successive samples of the current have a correlation of {greatest:.2} at most"
        ),
        effect: "These records are left out: they are neither fitted nor compared. A faster log \
            would make them useful. So would `current_between_samples = \"hold\"`, where the \
            samples stand at the steps of the current."
            .to_owned(),
        runs,
        correctable: false,
    }]
}

/// Correlation of successive samples of the current: 1 less half the mean square of their
/// difference over their variance (von Neumann). None for a current that hardly changes.
fn correlation(played: &Played<'_>) -> Option<f64> {
    let current_a = &played.record.series.current_a[played.first_compared()..];
    let n = current_a.len() as f64;
    let mean_a = current_a.iter().sum::<f64>() / n;
    let variance_a2 = current_a.iter().map(|i| (i - mean_a).powi(2)).sum::<f64>() / n;
    let steps = current_a.windows(2).map(|w| (w[1] - w[0]).powi(2));
    let half_a2 = 0.5 * steps.sum::<f64>() / (n - 1.0);
    // The noise of a constant current is no change of it.
    let least_a = LARGE_STEP_PART * played.largest_a();
    (half_a2 > least_a.powi(2)).then(|| 1.0 - half_a2 / variance_a2)
}

/// Typical distance of the two samples around a large step of the current, s.
fn at_edges_s(played: &Played<'_>) -> Option<f64> {
    let series = &played.record.series;
    let largest_a = series
        .current_a
        .windows(2)
        .fold(0.0f64, |most, w| most.max((w[1] - w[0]).abs()));
    let edges: Vec<f64> = (played.first_compared().max(1)..series.len())
        .filter(|k| {
            (series.current_a[*k] - series.current_a[k - 1]).abs() > LARGE_STEP_PART * largest_a
        })
        .map(|k| series.time_s[k] - series.time_s[k - 1])
        .collect();
    (!edges.is_empty()).then(|| median(edges))
}
