//! Rows that are missing within a record, and rows that repeat the one before them.

use std::ops::Range;

use super::finding::{Finding, FindingKind};
use super::scene::{Played, Scene};
use crate::median::median;
use crate::thresholds::{
    EVEN_PART, EVEN_STEP_PART, FROZEN_BY_CHANCE, FROZEN_CODES, FROZEN_LEAST_ROWS, FROZEN_SIGMAS,
    GAP_AROUND, GAP_CHANGES_PART, GAP_TIMES, GAP_TIMES_EVEN,
};
use analysis_numeric::stats::normal_tail;

pub(super) fn missing(scene: &Scene<'_>) -> Vec<Finding> {
    scene.records().filter_map(|played| gap(&played)).collect()
}

fn gap(played: &Played<'_>) -> Option<Finding> {
    let series = &played.record.series;
    let steps: Vec<f64> = series.time_s.windows(2).map(|w| w[1] - w[0]).collect();
    let typical_s = median(steps.clone());
    let even = steps
        .iter()
        .filter(|h| (**h - typical_s).abs() <= EVEN_STEP_PART * typical_s)
        .count();
    let times = if even as f64 >= EVEN_PART * steps.len() as f64 {
        GAP_TIMES_EVEN
    } else {
        GAP_TIMES
    };
    // The longest of the steps around, so that a logger that slows down has no gaps.
    let around = |k: usize| {
        let before = &steps[k.saturating_sub(GAP_AROUND)..k];
        let after = &steps[(k + 1).min(steps.len())..(k + 1 + GAP_AROUND).min(steps.len())];
        before.iter().chain(after).copied().fold(0.0, f64::max)
    };
    let gaps: Vec<usize> = (0..steps.len())
        .filter(|k| steps[*k] > times * around(*k) && around(*k) > 0.0)
        .collect();
    let longest = *gaps
        .iter()
        .max_by(|a, b| steps[**a].total_cmp(&steps[**b]))?;
    let (before_a, after_a) = (series.current_a[longest], series.current_a[longest + 1]);
    let changes = (after_a - before_a).abs() > GAP_CHANGES_PART * played.largest_a();
    let several = if gaps.len() > 1 {
        format!(", the longest of {} gaps", gaps.len())
    } else {
        String::new()
    };
    let name = &played.run.name;
    Some(Finding {
        kind: FindingKind::RowsMissing,
        runs: vec![name.clone()],
        text: format!(
            "{name}: no rows from {:.3} s to {:.3} s{several}; the rows around are {:.3} s apart",
            series.time_s[longest],
            series.time_s[longest + 1],
            around(longest)
        ),
        how_sure: format!(
            "{:.0} times the longest step around it",
            steps[longest] / around(longest)
        ),
        effect: if changes {
            format!(
                "The current goes from {before_a:.3} A to {after_a:.3} A within the gap: when is \
                not known, and charge and voltage after it are off."
            )
        } else {
            "The current is the same on both sides: only rows are lost, unless it changed in \
            between."
                .to_owned()
        },
        correctable: false,
    })
}

pub(super) fn repeated(scene: &Scene<'_>) -> Vec<Finding> {
    scene
        .records()
        .filter_map(|played| frozen(scene, &played))
        .collect()
}

fn frozen(scene: &Scene<'_>, played: &Played<'_>) -> Option<Finding> {
    let series = &played.record.series;
    let same = |k: usize| {
        series.voltage_v[k] == series.voltage_v[k - 1]
            && series.current_a[k] == series.current_a[k - 1]
    };
    let pairs = (1..series.len()).filter(|k| same(*k)).count();
    let codes_v = super::resolution::code(&series.voltage_v).unwrap_or(0.0);
    let least_v =
        (FROZEN_CODES * codes_v).max(FROZEN_SIGMAS * scene.at.sample_noise_v(played.record));
    let [kept_v, kept_a] = by_codes(scene, played, codes_v);
    // A current that is cut to zero at rest repeats whatever its noise.
    let kept = |k: usize| {
        kept_v
            * if series.current_a[k] == 0.0 {
                1.0
            } else {
                kept_a
            }
    };
    // A model of a larger cell, or a current in mA, expects more than is there.
    let shrunk = (range(&series.voltage_v) / range(played.expected_v)).min(1.0);
    let stuck: Vec<(Range<usize>, f64)> = stretches(series.len(), same)
        .into_iter()
        .filter(|row| row.len() >= FROZEN_LEAST_ROWS)
        .filter_map(|row| {
            // As often as elsewhere in the record, and one for the unseen rows.
            let repeats = row.len() - 1;
            let often = (pairs - repeats + 1) as f64 / (series.len() - repeats + 1) as f64;
            let side = |rows: Range<usize>| {
                let n = rows.len();
                let equal = rows.filter(|k| same(*k)).count();
                (n >= FROZEN_LEAST_ROWS).then(|| (equal + 1) as f64 / (n + 2) as f64)
            };
            let reach = row.len().max(2 * FROZEN_LEAST_ROWS);
            let before = side(row.start.saturating_sub(reach).max(1)..row.start.max(1));
            let after =
                side((row.end + 1).min(series.len())..(row.end + 1 + reach).min(series.len()));
            let often = [before, after]
                .into_iter()
                .flatten()
                .fold(often.max(kept(row.start)), f64::max)
                .min(1.0);
            let chance = series.len() as f64 * often.powi(repeats as i32);
            let moves_v = shrunk * range(&played.expected_v[row.clone()]);
            (chance < FROZEN_BY_CHANCE || moves_v > least_v).then_some((row, chance))
        })
        .collect();
    let (longest, chance) = stuck.iter().max_by_key(|(row, _)| row.len())?;
    let rows: usize = stuck.iter().map(|(row, _)| row.len() - 1).sum();
    let name = &played.run.name;
    Some(Finding {
        kind: FindingKind::RowsRepeated,
        runs: vec![name.clone()],
        text: format!(
            "{name}: {rows} rows repeat the row before them, most in a row from {:.3} s to \
            {:.3} s at {:.3} A and {:.4} V",
            series.time_s[longest.start],
            series.time_s[longest.end - 1],
            series.current_a[longest.start],
            series.voltage_v[longest.start]
        ),
        how_sure: format!(
            "{chance:.0e} such stretches are expected by chance of the record's codes and noise"
        ),
        effect: "These rows are not measurements: an edge within them is late, and they weigh as \
            much as true ones."
            .to_owned(),
        correctable: false,
    })
}

/// Most that the voltage, and the current, of a row is that of the one before by codes that the
/// stated noise does not leave.
fn by_codes(scene: &Scene<'_>, played: &Played<'_>, codes_v: f64) -> [f64; 2] {
    let Some(h) = scene.at.set.history else {
        return [0.0; 2];
    };
    let codes_a = super::resolution::code(&played.record.series.current_a).unwrap_or(0.0);
    let within = |code: f64, sigma: f64| {
        if sigma > 0.0 {
            1.0 - 2.0 * normal_tail(0.5 * code / sigma)
        } else {
            1.0
        }
    };
    let step_v = codes_v.max(h.voltage_resolution_v);
    let step_a = codes_a.max(h.current_resolution_a);
    [
        within(step_v, h.voltage_noise_v),
        within(step_a, h.current_noise_a),
    ]
}

fn range(values: &[f64]) -> f64 {
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(*v), h.max(*v))
        });
    high - low
}

/// Returns stretches of rows in which each equals the one before.
fn stretches(rows: usize, same: impl Fn(usize) -> bool) -> Vec<Range<usize>> {
    let mut all: Vec<Range<usize>> = Vec::new();
    for k in 1..rows {
        if !same(k) {
            continue;
        }
        match all.last_mut() {
            Some(row) if row.end == k => row.end = k + 1,
            _ => all.push(k - 1..k + 1),
        }
    }
    all
}
