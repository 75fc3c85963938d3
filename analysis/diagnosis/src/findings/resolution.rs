//! Codes of a channel against the resolution that is stated.

use super::finding::{Finding, FindingKind, names};
use super::scene::{Played, Scene};
use crate::median::median;
use crate::thresholds::{CODES_FEWEST, CODES_FIT_PART, CODES_ON_GRID, CODES_TIMES_STATED};

/// A channel: its name, its unit, and the key of its resolution.
struct Channel {
    name: &'static str,
    unit: &'static str,
    key: &'static str,
    values: fn(&Played<'_>) -> Vec<f64>,
    stated: f64,
    noise: f64,
}

pub(super) fn find(scene: &Scene<'_>) -> Vec<Finding> {
    let Some(h) = scene.at.set.history else {
        return Vec::new();
    };
    let channels = [
        Channel {
            name: "voltage",
            unit: "mV",
            key: "voltage_resolution_v",
            values: |played| played.record.series.voltage_v.clone(),
            stated: h.voltage_resolution_v,
            noise: h.voltage_noise_v,
        },
        Channel {
            name: "current",
            unit: "mA",
            key: "current_resolution_a",
            values: |played| played.record.series.current_a.clone(),
            stated: h.current_resolution_a,
            noise: h.current_noise_a,
        },
    ];
    channels
        .iter()
        .filter_map(|channel| coarse(scene, channel))
        .collect()
}

fn coarse(scene: &Scene<'_>, channel: &Channel) -> Option<Finding> {
    // A code step that is not stated is taken for one that the noise hides.
    let known = channel.stated.max(channel.noise);
    let all: Vec<(String, f64, usize)> = scene
        .records()
        .filter_map(|played| {
            let values = (channel.values)(&played);
            let step = code(&values)?;
            let levels = distinct(&values).len();
            (step > CODES_TIMES_STATED * known).then_some((played.run.name.clone(), step, levels))
        })
        .collect();
    if all.is_empty() {
        return None;
    }
    let runs: Vec<String> = all.iter().map(|(name, ..)| name.clone()).collect();
    let step = median(all.iter().map(|(_, step, _)| *step).collect());
    let levels = all.iter().map(|(.., levels)| *levels).max().unwrap_or(0);
    let stated = if channel.stated > 0.0 {
        format!("{:.3} {} are stated", 1e3 * channel.stated, channel.unit)
    } else {
        format!(
            "no step is stated, and the noise of {:.3} {} does not hide it",
            1e3 * channel.noise,
            channel.unit
        )
    };
    Some(Finding {
        kind: FindingKind::Resolution,
        text: format!(
            "{}: codes of the {} are {:.3} {} apart; {stated}",
            names(&runs),
            channel.name,
            1e3 * step,
            channel.unit
        ),
        how_sure: format!(
            "{:.1} times what is known of the channel; at most {levels} values in a record",
            step / known
        ),
        effect: format!(
            "The floor is too low: rounding is taken for a missing effect. State `{}` in [bench].",
            channel.key
        ),
        runs,
        correctable: false,
    })
}

fn distinct(values: &[f64]) -> Vec<f64> {
    let mut all = values.to_vec();
    all.sort_unstable_by(f64::total_cmp);
    all.dedup();
    all
}

/// Returns the step of the codes that values lie on, or `None` if they lie on no codes.
pub(crate) fn code(values: &[f64]) -> Option<f64> {
    let levels = distinct(values);
    if levels.len() < CODES_FEWEST {
        return None;
    }
    let mut steps: Vec<f64> = levels.windows(2).map(|w| w[1] - w[0]).collect();
    steps.sort_unstable_by(f64::total_cmp);
    // A tenth of the way up: below lie steps that the digits of a file have made smaller.
    let step = steps[steps.len() / 10];
    let on_grid = steps
        .iter()
        .filter(|s| {
            let n = *s / step;
            n > 0.5 && (n - n.round()).abs() < CODES_FIT_PART * n.max(1.0)
        })
        .count();
    // Steps of many codes fit any grid.
    let single = steps.iter().filter(|s| **s < 3.5 * step).count();
    (step > 0.0
        && on_grid as f64 >= CODES_ON_GRID * steps.len() as f64
        && 2 * single >= steps.len())
    .then_some(step)
}
