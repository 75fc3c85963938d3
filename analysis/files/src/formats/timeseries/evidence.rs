//! Evidence of the voltage for the direction of the current: by the resistance of the cell, it falls
//! at the start of a discharge and rises at the start of a charge, and continues in that direction.
//!
//! A load is a sequence of rows with a current of one sign. The mean of up to [`AVERAGED`] rows
//! before it is compared with the mean of as many rows in it; if that step is below the noise, its
//! end is used, and then its course. The noise is determined from consecutive rows under the same
//! current.

use super::raw::{Quantity, Raw};
use std::ops::Range;

/// Fraction of the largest current below which a row is at rest.
pub(super) const REST_PART: f64 = 0.05;
/// Maximum number of rows that are averaged on each side of a step.
const AVERAGED: usize = 5;
/// Significance threshold of a step, in standard deviations of its noise. Among 10⁶ steps of pure
/// noise, none reaches it by chance.
const SURE: f64 = 6.0;
/// Minimum number of rows under one current to determine the noise.
const FEWEST: usize = 4;

/// A load and the evidence of its voltage.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Load {
    /// Its rows.
    pub(super) rows: Range<usize>,
    /// The sign of its current in the file.
    pub(super) positive: bool,
    /// Change of the voltage in standard deviations of the noise: positive for a charge, negative
    /// for a discharge, 0 if not significant.
    pub(super) rise: f64,
    /// Whether its start and its end contradict each other.
    pub(super) torn: bool,
    /// Voltages before it and in it, V.
    pub(super) volts: [f64; 2],
}

/// Returns the sign of the current of each row: 0 at rest.
fn signs(current_a: &[f64]) -> Vec<i8> {
    let most = current_a.iter().fold(0.0_f64, |most, a| most.max(a.abs()));
    let sign = |a: &f64| match a {
        a if *a > REST_PART * most => 1,
        a if *a < -REST_PART * most => -1,
        _ => 0,
    };
    current_a.iter().map(sign).collect()
}

/// Returns the loads of a record, in order.
pub(super) fn loads(raw: &Raw) -> Vec<Load> {
    let (voltage, current) = (raw.get(Quantity::Voltage), raw.get(Quantity::Current));
    let signs = signs(current);
    let noise_v = noise_v(voltage, current);
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (k, sign) in signs.iter().enumerate() {
        match runs.last_mut() {
            Some(run) if signs[run.start] == *sign => run.end = k + 1,
            _ => runs.push(k..k + 1),
        }
    }
    let of = |(nth, run): (usize, &Range<usize>)| {
        let before = nth.checked_sub(1).and_then(|before| runs.get(before));
        // Between two loads, the voltage moves in the direction of the later one.
        let after = runs.get(nth + 1).filter(|after| signs[after.start] == 0);
        let start = before.map(|before| step(voltage, before, run, noise_v));
        let end = after.map(|after| -step(voltage, run, after, noise_v));
        let course = course(voltage, run, noise_v);
        let sure = |rise: Option<f64>| rise.filter(|rise| rise.abs() > SURE);
        let rise = sure(start)
            .or(sure(end))
            .or(sure(Some(course)))
            .unwrap_or(0.0);
        let torn = sure(start)
            .zip(sure(end))
            .is_some_and(|(start, end)| start * end < 0.0);
        let lead = before.map_or(run.start, |before| before.end - 1);
        Load {
            rows: run.clone(),
            positive: signs[run.start] > 0,
            rise,
            torn,
            volts: [
                voltage[lead],
                voltage[(run.start + AVERAGED).min(run.end) - 1],
            ],
        }
    };
    let loads = runs
        .iter()
        .enumerate()
        .filter(|(_, run)| signs[run.start] != 0);
    loads.map(of).collect()
}

/// Returns the standard deviation of a voltage about its course under one current, V; infinite if
/// there are too few rows.
fn noise_v(voltage: &[f64], current: &[f64]) -> f64 {
    let most = current.iter().fold(0.0_f64, |most, a| most.max(a.abs()));
    let pairs = voltage.windows(2).zip(current.windows(2));
    let steps = pairs
        .filter(|(_, current)| (current[1] - current[0]).abs() < REST_PART * most)
        .map(|(voltage, _)| (voltage[1] - voltage[0]).abs());
    let mut steps: Vec<f64> = steps.collect();
    if steps.len() < FEWEST {
        return f64::INFINITY;
    }
    steps.sort_by(f64::total_cmp);
    let median = steps[steps.len() / 2];
    // Most rounded numbers do not change: use the rounding step as the noise.
    let all = voltage.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let least = all.filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min);
    let rounding = if least.is_finite() { 0.3 * least } else { 0.0 };
    (1.4826 * median / std::f64::consts::SQRT_2).max(rounding)
}

/// Returns the step of the voltage between two runs of rows, in standard deviations.
fn step(voltage: &[f64], before: &Range<usize>, after: &Range<usize>, noise_v: f64) -> f64 {
    let before = &voltage[before.end.saturating_sub(AVERAGED).max(before.start)..before.end];
    let after = &voltage[after.start..(after.start + AVERAGED).min(after.end)];
    significance(before, after, noise_v)
}

/// Returns the change of the voltage from the first to the last quarter of a run, in standard
/// deviations.
fn course(voltage: &[f64], run: &Range<usize>, noise_v: f64) -> f64 {
    let quarter = run.len() / 4;
    if quarter == 0 {
        return 0.0;
    }
    let all = &voltage[run.clone()];
    significance(&all[..quarter], &all[run.len() - quarter..], noise_v)
}

#[expect(clippy::cast_precision_loss, reason = "numbers of rows")]
fn significance(before: &[f64], after: &[f64], noise_v: f64) -> f64 {
    let mean = |all: &[f64]| all.iter().sum::<f64>() / all.len() as f64;
    let rise = mean(after) - mean(before);
    let sigma = noise_v * (1.0 / before.len() as f64 + 1.0 / after.len() as f64).sqrt();
    if rise == 0.0 || !sigma.is_finite() {
        0.0
    } else {
        rise / sigma
    }
}
