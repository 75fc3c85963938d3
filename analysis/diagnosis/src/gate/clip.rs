//! Clipping: many samples in a row at exactly the same extreme value, while the current shows that
//! the voltage must move beyond it. Noise and quantisation repeat a code too, but not while the
//! voltage moves by many codes.

use super::super::findings::resolution::code;
use super::{Check, Findings, Inspection};
use crate::thresholds::{CLIP_FEWEST, CLIP_MOVES_PART, CLIP_MOVES_SIGMAS};
use std::ops::Range;

pub(super) fn check(at: &Inspection<'_>) -> Findings {
    let mut found = Findings::default();
    for subject in &at.runs {
        let Some((record, expected_v)) = subject.record() else {
            continue;
        };
        let measured_v = &record.series.voltage_v;
        let noise_v = at
            .sample_noise_v(record)
            .max(at.set.history.map_or(0.0, |h| h.voltage_resolution_v))
            .max(code(measured_v).unwrap_or(0.0));
        let span_v = extent(expected_v);
        let least_v = (CLIP_MOVES_SIGMAS * noise_v).max(CLIP_MOVES_PART * span_v);
        for sign in [1.0, -1.0] {
            let extreme_v = sign
                * measured_v
                    .iter()
                    .fold(f64::NEG_INFINITY, |most, v| most.max(sign * v));
            let count = measured_v.iter().filter(|v| **v == extreme_v).count();
            // How far the expected voltage lies beyond the extreme.
            let beyond = |k: usize| sign * (expected_v[k] - extreme_v);
            let clipped = rows(measured_v, extreme_v)
                .into_iter()
                .filter(|row| row.len() >= CLIP_FEWEST)
                .any(|row| {
                    let moves_v = extent(&expected_v[row.clone()]);
                    let far = row.map(beyond).fold(f64::NEG_INFINITY, f64::max);
                    moves_v > least_v && far > least_v
                });
            if clipped {
                let side = if sign > 0.0 { "highest" } else { "lowest" };
                let text = format!(
                    "its voltage is clipped: {count} samples at exactly the {side} value, \
                    {extreme_v:.4} V, while the current moves it"
                );
                found.add(Check::Clipped, subject.run, text);
                break;
            }
        }
    }
    found
}

fn extent(values: &[f64]) -> f64 {
    let (low, high) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
            (l.min(*v), h.max(*v))
        });
    high - low
}

/// Stretches of samples at one value.
fn rows(values: &[f64], at: f64) -> Vec<Range<usize>> {
    let mut rows: Vec<Range<usize>> = Vec::new();
    for k in (0..values.len()).filter(|k| values[*k] == at) {
        match rows.last_mut() {
            Some(row) if row.end == k => row.end = k + 1,
            _ => rows.push(k..k + 1),
        }
    }
    rows
}
