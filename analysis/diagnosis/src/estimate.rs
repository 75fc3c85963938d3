//! Estimates the σ of the noise's terms from repeats: restricted maximum likelihood on the
//! differences between them, in which all errors of the model cancel. The misfit is never used. The
//! bench's history is the prior.
//!
//! The effect of a σ on the rows is in `noise`.

use super::block::{Block, Kind};
use super::noise::{LogSigmas, Prior, Shape, TERMS, Term};
use super::whitening::{Whitener, dot};
use crate::thresholds::LEAST_INFORMATION;
use analysis_numeric::linalg::{cholesky, cholesky_substitute};
use std::collections::BTreeMap;

/// Newton steps of the likelihood at most.
const ITERATIONS: usize = 12;

/// Repeats of one group: their shape and the differences between them.
struct Group<'a> {
    shape: &'a Shape,
    contrasts: Vec<Vec<f64>>,
    /// The same differences for a steady growth of all resistances with the run's order.
    trends: Vec<Vec<f64>>,
}

/// σ's as found.
#[derive(Debug, Clone)]
pub(super) struct Estimate {
    pub(super) log_sigmas: LogSigmas,
    /// Distance of each term from the history, in standard deviations; `None` if repeats do not
    /// determine it.
    pub(super) z: [Option<f64>; TERMS.len()],
    /// (χ² − dof)/√(2·dof) of the differences between repeats; none without repeats.
    pub(super) repeat_z: Option<f64>,
    /// Most repeats of any group of spectra or of records, whichever are fewer.
    pub(super) repeats: usize,
}

impl Estimate {
    /// Returns the variance of a term.
    pub(super) fn variance(&self, term: Term) -> f64 {
        (2.0 * self.log_sigmas[term as usize]).exp()
    }
}

/// σ's from the repeats among blocks; `residuals` are measured less predicted rows of each block.
pub(super) fn estimate(
    blocks: &[Block],
    shapes: &[Shape],
    residuals: &[Vec<f64>],
    prior: &Prior,
) -> Estimate {
    // Only equal measurements of the same object count as repeats.
    let mut members: BTreeMap<(&str, usize, bool, bool), Vec<usize>> = BTreeMap::new();
    for (k, b) in blocks.iter().enumerate() {
        members
            .entry((
                &b.group,
                b.rows(),
                matches!(b.kind, Kind::Eis { .. }),
                b.at.is_cell,
            ))
            .or_default()
            .push(k);
    }
    let most = |eis: bool| {
        members
            .iter()
            .filter(|(key, _)| key.2 == eis && key.3)
            .map(|(_, m)| m.len())
            .max()
    };
    let repeats = most(true).into_iter().chain(most(false)).min().unwrap_or(0);
    let mut groups: Vec<Group<'_>> = members
        .values()
        .filter(|m| m.len() > 1)
        .map(|m| Group {
            shape: &shapes[m[0]],
            contrasts: contrasts(&m.iter().map(|k| residuals[*k].clone()).collect::<Vec<_>>()),
            trends: contrasts(
                &m.iter()
                    .map(|k| shapes[*k].trend(blocks[*k].at.order))
                    .collect::<Vec<_>>(),
            ),
        })
        .collect();
    remove_trend(&mut groups, &prior.log_sigmas);
    let mut theta = prior.log_sigmas;
    if groups.is_empty() {
        return Estimate {
            log_sigmas: theta,
            z: [None; TERMS.len()],
            repeat_z: None,
            repeats,
        };
    }
    let mut information = vec![0.0; TERMS.len() * TERMS.len()];
    for _ in 0..ITERATIONS {
        let (gradient, found) = expand(&groups, &theta);
        information = found;
        let step = newton(&gradient, &information, &theta, prior);
        theta.iter_mut().zip(&step).for_each(|(t, s)| *t += s);
        if step.iter().all(|s| s.abs() < 1e-3) {
            break;
        }
    }
    let s = prior.spread;
    let z = std::array::from_fn(|j| {
        let a = information[j * TERMS.len() + j];
        (a > LEAST_INFORMATION).then(|| {
            (theta[j] - prior.log_sigmas[j]) * (1.0 + a * s * s).sqrt() / (s * s * a.sqrt())
        })
    });
    Estimate {
        log_sigmas: theta,
        z,
        repeat_z: agreement(&groups, &theta),
        repeats,
    }
}

/// Orthonormal differences of repeats (Helmert).
fn contrasts(repeats: &[Vec<f64>]) -> Vec<Vec<f64>> {
    (1..repeats.len())
        .map(|k| {
            let weight = 1.0 / ((k * (k + 1)) as f64).sqrt();
            let others = |row: usize| repeats[..k].iter().map(|r| r[row]).sum::<f64>();
            (0..repeats[0].len())
                .map(|row| weight * (k as f64 * repeats[k][row] - others(row)))
                .collect()
        })
        .collect()
}

/// Takes the best common growth of resistance over run order off the differences: ageing is an
/// effect to be named, not noise.
fn remove_trend(groups: &mut [Group<'_>], theta: &LogSigmas) {
    let (mut along, mut size) = (0.0, 0.0);
    for group in groups.iter() {
        let Some(white) = Whitener::new(group.shape.covariance(theta), group.shape.n) else {
            return;
        };
        for (h, t) in group.contrasts.iter().zip(&group.trends) {
            let solved = white.solve(t);
            along += dot(&solved, h);
            size += dot(&solved, t);
        }
    }
    if size <= 0.0 {
        return;
    }
    let growth = along / size;
    for group in groups {
        for (h, t) in group.contrasts.iter_mut().zip(&group.trends) {
            h.iter_mut().zip(t).for_each(|(h, t)| *h -= growth * t);
        }
    }
}

/// Returns the gradient of −ln L and the average information matrix.
fn expand(groups: &[Group<'_>], theta: &LogSigmas) -> (LogSigmas, Vec<f64>) {
    let n = TERMS.len();
    let (mut gradient, mut information) = ([0.0; TERMS.len()], vec![0.0; n * n]);
    for group in groups {
        let Some(white) = Whitener::new(group.shape.covariance(theta), group.shape.n) else {
            continue;
        };
        let inverse = if group.shape.drift.is_empty() {
            Vec::new()
        } else {
            white.inverse()
        };
        let variance = |j: usize| (2.0 * theta[j]).exp();
        for (j, (term, _)) in TERMS.iter().enumerate() {
            gradient[j] += 0.5
                * group.contrasts.len() as f64
                * group.shape.trace(*term, variance(j), &white, &inverse);
        }
        for h in &group.contrasts {
            let x = white.solve(h);
            let sides: Vec<Option<Vec<f64>>> = TERMS
                .iter()
                .enumerate()
                .map(|(j, (term, _))| group.shape.derivative_times(*term, variance(j), &x))
                .collect();
            let solved: Vec<Option<Vec<f64>>> = sides
                .iter()
                .map(|s| s.as_ref().map(|s| white.solve(s)))
                .collect();
            for j in 0..n {
                let Some(side) = &sides[j] else { continue };
                gradient[j] -= 0.5 * dot(&x, side);
                for l in 0..n {
                    information[j * n + l] +=
                        solved[l].as_ref().map_or(0.0, |w| 0.5 * dot(side, w));
                }
            }
        }
    }
    (gradient, information)
}

fn newton(
    gradient: &LogSigmas,
    information: &[f64],
    theta: &LogSigmas,
    prior: &Prior,
) -> LogSigmas {
    let n = TERMS.len();
    let weight = prior.spread.powi(-2);
    let mut a = information.to_vec();
    let mut step: Vec<f64> = (0..n)
        .map(|j| -gradient[j] - weight * (theta[j] - prior.log_sigmas[j]))
        .collect();
    (0..n).for_each(|j| a[j * n + j] += weight);
    if !cholesky(&mut a, n) {
        return [0.0; TERMS.len()];
    }
    cholesky_substitute(&a, n, &mut step);
    std::array::from_fn(|j| step[j].clamp(-0.7, 0.7))
}

fn agreement(groups: &[Group<'_>], theta: &LogSigmas) -> Option<f64> {
    let (mut chi2, mut dof) = (0.0, 0.0);
    for group in groups {
        let white = Whitener::new(group.shape.covariance(theta), group.shape.n)?;
        for h in &group.contrasts {
            let mut w = Vec::with_capacity(group.shape.n);
            white.apply(h, &mut w);
            chi2 += dot(&w, &w);
            dof += w.len() as f64;
        }
    }
    (dof > 0.0).then(|| (chi2 - dof) / (2.0 * dof).sqrt())
}
