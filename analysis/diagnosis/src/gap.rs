//! Gaps of held-out runs: root mean squares of prediction less measurement, and the floor that
//! noise sets over the same samples.
//!
//! Samples at an edge of the current are reported separately if a logger leaves the edge's time
//! open: there the floor is that of the edge and does not test the model.

use super::block::{Kind, Workspace};
use super::data::Role;
use super::noise::Term;
use super::outcome::{Gap, SpectrumGap};
use super::prepare::Prepared;
use super::problem::{Fit, Problem};
use super::structure::At;
use super::time_block::TimeBlock;
use analysis_effects::contract::HeldOutError;
use analysis_model::model::Erm;

/// The fits that are held against the model file.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fits<'a> {
    pub(super) base: &'a Fit,
    /// The base with the named effects.
    pub(super) augmented: &'a Fit,
}

/// Returns the root mean square.
fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0usize, 0.0), |(n, s), v| (n + 1, s + v * v));
    (sum / count.max(1) as f64).sqrt()
}

/// Returns the root mean square of a gap over records, mV; zero without any.
pub fn rms_mv(gaps: &[Gap], of: fn(&Gap) -> f64) -> f64 {
    rms(gaps.iter().map(of))
}

/// Predictions of a record's samples that are compared.
pub(super) fn samples(
    problem: &Problem,
    at: At<'_>,
    block: usize,
    workspace: &mut Workspace,
) -> Vec<f64> {
    let _ = problem.predict(at, block, 1, workspace);
    match &problem.blocks[block].kind {
        Kind::Time(time) => workspace.voltage_v[time.compared()].to_vec(),
        Kind::Eis { .. } => Vec::new(),
    }
}

/// Samples of a record that are compared and lie at no edge of the current; all where every one
/// lies at an edge.
fn beside_edges(problem: &Problem, block: usize, time: &TimeBlock) -> Vec<bool> {
    let mut beside = Vec::with_capacity(time.voltage_v.len());
    for (bin, at_edge) in time.bins.iter().zip(&problem.at_edges[block]) {
        beside.extend(std::iter::repeat_n(!at_edge, bin.to - bin.from));
    }
    if beside.iter().all(|b| !b) {
        beside.fill(true);
    }
    beside
}

/// Returns the root mean square of prediction less measurement over the kept samples of a record,
/// V; about the mean if the level is free.
fn missed_v(time: &TimeBlock, predicted_v: &[f64], keep: &[bool]) -> f64 {
    rms(misses_v(time, predicted_v, keep).into_iter())
}

/// Returns prediction less measurement at the kept samples of a record, V; about the mean if the level is
/// free.
fn misses_v(time: &TimeBlock, predicted_v: &[f64], keep: &[bool]) -> Vec<f64> {
    let measured_v = &time.voltage_v[time.compared()];
    let all: Vec<f64> = predicted_v
        .iter()
        .zip(measured_v)
        .map(|(p, m)| p - m)
        .collect();
    let mut missed: Vec<f64> = kept(&all, keep).collect();
    if time.level_sigma_v > 0.0 {
        let level_v = missed.iter().sum::<f64>() / missed.len().max(1) as f64;
        missed.iter_mut().for_each(|v| *v -= level_v);
    }
    missed
}

/// Returns the largest miss at the kept samples of a record over the movement of the predicted voltage.
fn largest_share(time: &TimeBlock, predicted_v: &[f64], keep: &[bool]) -> f64 {
    let moved_v = HeldOutError::moved_v(predicted_v);
    let missed = misses_v(time, predicted_v, keep).into_iter();
    largest(
        missed
            .zip(kept(&moved_v, keep))
            .map(|(missed, moved)| missed.abs() / moved),
    )
}

/// Returns the largest of values from 0, not a number if one is none.
fn largest(values: impl Iterator<Item = f64>) -> f64 {
    let is_more = |value: f64, most: f64| value > most || value.is_nan();
    values.fold(
        0.0,
        |most, value| if is_more(value, most) { value } else { most },
    )
}

/// Returns the error that the gaps of held-out records show; `None` without any, or if one is not a number.
pub fn held_out_error(gaps: &[Gap]) -> Option<HeldOutError> {
    let share = largest(gaps.iter().map(|gap| gap.augmented_share));
    (!gaps.is_empty() && share.is_finite()).then_some(HeldOutError {
        runs: gaps.len(),
        share,
    })
}

fn kept<'a>(values: &'a [f64], keep: &'a [bool]) -> impl Iterator<Item = f64> + 'a {
    let both = values.iter().zip(keep);
    both.filter(|(_, keep)| **keep).map(|(v, _)| *v)
}

/// Gaps of the held-out records.
pub(super) fn gaps(
    prepared: &Prepared,
    erm: &Erm,
    fits: Fits<'_>,
    workspace: &mut Workspace,
) -> Vec<Gap> {
    let problem = &prepared.problem;
    let given = &problem.given;
    let start = given.encode(erm);
    let all = [given.at(&start), fits.base.at(), fits.augmented.at()];
    let mut gaps = Vec::new();
    for k in problem.of_role(Role::HeldOut) {
        let block = &problem.blocks[k];
        let Kind::Time(time) = &block.kind else {
            continue;
        };
        let predicted = all.map(|at| samples(problem, at, k, workspace));
        let floor_v = sample_floor(prepared, k, time);
        let over = |keep: &[bool]| {
            let [alone, base, augmented] = [0, 1, 2].map(|n| missed_v(time, &predicted[n], keep));
            [alone, base, augmented, rms(kept(&floor_v, keep))].map(|v| 1e3 * v)
        };
        let beside = beside_edges(problem, k, time);
        let [eis_only_mv, base_mv, augmented_mv, floor_mv] = over(&beside);
        let [
            eis_only_with_edges_mv,
            base_with_edges_mv,
            augmented_with_edges_mv,
            floor_with_edges_mv,
        ] = over(&vec![true; beside.len()]);
        gaps.push(Gap {
            run: block.name.clone(),
            eis_only_mv,
            base_mv,
            augmented_mv,
            floor_mv,
            eis_only_with_edges_mv,
            base_with_edges_mv,
            augmented_with_edges_mv,
            floor_with_edges_mv,
            edge_samples: beside.iter().filter(|b| !**b).count(),
            augmented_share: largest_share(time, &predicted[2], &beside),
        });
    }
    gaps
}

/// Returns the standard deviation per sample: the rows' own, with the white noise of a single
/// sample instead of the mean's.
pub(super) fn sample_floor(prepared: &Prepared, block: usize, time: &TimeBlock) -> Vec<f64> {
    let white = prepared.sample_noise_v.powi(2);
    // A free level is excluded from a gap about the mean.
    let level = if time.level_sigma_v > 0.0 {
        time.level_sigma_v.powi(2) + prepared.estimate.variance(Term::Level)
    } else {
        0.0
    };
    let mut floor = Vec::with_capacity(time.voltage_v.len());
    for (bin, sigma) in time.bins.iter().zip(&prepared.problem.floors[block]) {
        let count = (bin.to - bin.from) as f64;
        let single = white * (1.0 - 1.0 / count) + bin.stated_v2 * (count - 1.0);
        floor.extend(std::iter::repeat_n(
            (sigma * sigma - level + single).max(0.0).sqrt(),
            bin.to - bin.from,
        ));
    }
    floor
}

/// Gaps of the held-out spectra.
pub(super) fn spectrum_gaps(
    problem: &Problem,
    erm: &Erm,
    fits: Fits<'_>,
    workspace: &mut Workspace,
) -> Vec<SpectrumGap> {
    let given = &problem.given;
    let start = given.encode(erm);
    let mut gaps = Vec::new();
    for k in problem.of_role(Role::HeldOut) {
        let block = &problem.blocks[k];
        let Kind::Eis { points, .. } = &block.kind else {
            continue;
        };
        let rows = 2 * points.len();
        let size = |n: usize| block.impedance_ohm(n);
        let mut gap = |at: At<'_>| {
            let predicted = problem.predict(at, k, 1, workspace);
            100.0
                * 2f64.sqrt()
                * rms(predicted[..rows]
                    .iter()
                    .zip(&block.measured)
                    .enumerate()
                    .map(|(n, (p, m))| (p - m) / size(n)))
        };
        gaps.push(SpectrumGap {
            run: block.name.clone(),
            eis_only_percent: gap(given.at(&start)),
            base_percent: gap(fits.base.at()),
            augmented_percent: gap(fits.augmented.at()),
            floor_percent: 100.0
                * 2f64.sqrt()
                * rms(problem.floors[k][..rows]
                    .iter()
                    .enumerate()
                    .map(|(n, f)| f / size(n))),
        });
    }
    gaps
}
