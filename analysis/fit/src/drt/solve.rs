//! The choice of λ, and the solution with its uncertainty.

use super::design::{Design, REACH};
use super::nonnegative::{Solution, solve};
use super::peaks::peaks;
use super::{Drt, DrtError, Estimate, InductiveBranch, SlowLoop};
use crate::validity::{LoopBand, Noise, slow_loop_band};
use analysis_signal::spectrum::Spectrum;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

const FEWEST_POINTS: usize = 6;
const PENALTY_ON_FREEDOM: f64 = 1.4;
/// Of all λ whose score is within this factor of the best, the largest is used, because many λ have
/// nearly the same score.
const AS_GOOD: f64 = 1.03;
/// Decades of λ that are tried, relative to the size of the data's normal matrix.
const DECADES: (i32, i32) = (-9, 1);
const PER_DECADE: i32 = 2;
/// Factor by which the time constant of an inductive branch may lie beyond the band of its loop,
/// and the number of tried values: evenly over the logarithm, then in halved steps.
const LOOP_REACH: f64 = 10.0;
const LOOP_STEPS: usize = 25;
const LOOP_HALVINGS: usize = 6;

/// A solution for one λ with its cross-validation score.
struct Candidate {
    solution: Solution,
    lambda: f64,
    rss: f64,
    freedom: f64,
    score: f64,
}

/// The distribution of relaxation times of a spectrum, weighted by its noise.
///
/// ```
/// use analysis_fit::{drt::drt, validity::Noise};
/// use analysis_model::model::{Erm, RcBranch};
/// use analysis_numeric::Covariance2;
/// use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
///
/// // 15 mΩ and 10 mΩ with a time constant of 0.1 s, with 10 µΩ of noise stated.
/// let cell = Erm { r_ohm: 0.015, branches: vec![RcBranch { r_ohm: 0.01, c_f: 10.0 }] };
/// let point = |k: i32| {
///     let freq_hz = 10.0_f64.powf(-2.0 + 0.1 * f64::from(k));
///     let (z_ohm, covariance) = (cell.impedance(freq_hz), Covariance2::circular(1e-10));
///     ImpedancePoint { freq_hz, z_ohm, covariance, amplitude_a: 1.0 }
/// };
/// let spectrum = Spectrum { points: (0..51).map(point).collect(), ..Spectrum::default() };
/// let drt = drt(&spectrum, &Noise::of(&spectrum, &[])?)?;
/// assert!((drt.polarisation_ohm.value - 0.01).abs() < 2e-4);
/// assert!(drt.peaks.iter().any(|p| p.in_band && (p.tau_s / 0.1 - 1.0).abs() < 0.1));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`DrtError`] for a spectrum that is none or too short, or numbers that cannot be squared.
pub fn drt(spectrum: &Spectrum, noise: &Noise) -> Result<Drt, DrtError> {
    spectrum.validate()?;
    if spectrum.points.len() < FEWEST_POINTS {
        return Err(DrtError::TooFewPoints {
            spectrum: spectrum.name.clone(),
            expected: FEWEST_POINTS,
            met: spectrum.points.len(),
        });
    }
    let singular = || DrtError::Singular {
        spectrum: spectrum.name.clone(),
    };
    let slow_loop = slow_loop_band(spectrum, noise);
    // The part below the band is either slow elements of the continuum or the tail of the series
    // elements. The continuum alone can always imitate both together, in steps. So the two are
    // tried apart.
    let tried = [REACH, 1.0].into_iter().flat_map(|reach| {
        let plain = Design::new(spectrum, noise, reach, None);
        let with_loop = slow_loop.and_then(|band| with_loop(spectrum, noise, reach, band));
        [Some(plain), with_loop]
    });
    let found = tried
        .flatten()
        .filter_map(|design| choose(&design).map(|best| (design, best)))
        .min_by(|a, b| a.1.score.total_cmp(&b.1.score));
    let (design, best) = found.ok_or_else(singular)?;
    let covariance = covariance(&design, &best).ok_or_else(singular)?;
    let mut drt = result(&design, &best, &covariance);
    drt.slow_loop = slow_loop.map(|band| SlowLoop {
        band,
        branch: inductive_branch(&design, &best, &covariance),
    });
    Ok(drt)
}

/// Returns the problem with an inductive branch. Its time constant gives the smallest residual near
/// the band of the loop, at the strength of regularisation that cross-validation chooses in its
/// middle.
fn with_loop(spectrum: &Spectrum, noise: &Noise, reach: f64, band: LoopBand) -> Option<Design> {
    let made = |tau_s: f64| Design::new(spectrum, noise, reach, Some(tau_s));
    let (fast, slow) = (1.0 / (TAU * band.to_hz), 1.0 / (TAU * band.from_hz));
    let middle = choose(&made((fast * slow).sqrt()))?;
    let mut free = middle.solution.free;
    let mut cost = |log_tau: f64| {
        let design = made(log_tau.exp());
        let matrix = &design.normal + &design.penalty * middle.lambda;
        let solution = solve(&matrix, &design.right, &free)?;
        // ½xᵀKx − cᵀx at its minimum.
        let cost = -0.5 * solution.x.dot(&design.right);
        free = solution.free;
        Some(cost)
    };
    let (lo, hi) = ((LOOP_REACH.recip() * fast).ln(), (LOOP_REACH * slow).ln());
    let mut best = (f64::INFINITY, 0.5 * (lo + hi));
    let mut step = (hi - lo) / (LOOP_STEPS - 1) as f64;
    for k in 0..LOOP_STEPS {
        let at = lo + k as f64 * step;
        best = cost(at).map_or(best, |cost| if cost < best.0 { (cost, at) } else { best });
    }
    for _ in 0..LOOP_HALVINGS {
        step *= 0.5;
        for at in [best.1 - step, best.1 + step] {
            best = cost(at).map_or(best, |cost| if cost < best.0 { (cost, at) } else { best });
        }
    }
    Some(made(best.1.exp()))
}

/// Returns the inductive branch of a solution, or `None` without one.
fn inductive_branch(
    design: &Design,
    best: &Candidate,
    covariance: &DMatrix<f64>,
) -> Option<InductiveBranch> {
    let (tau_s, at) = (design.loop_tau_s?, design.nodes().end);
    let r_ohm = Estimate {
        value: best.solution.x[at],
        sigma: covariance[(at, at)].sqrt(),
    };
    (r_ohm.value > 0.0).then_some(InductiveBranch { tau_s, r_ohm })
}

fn choose(design: &Design) -> Option<Candidate> {
    let nodes = design.tau_s.len();
    let size = design.nodes().map(|j| design.normal[(j, j)]).sum::<f64>() / nodes as f64;
    let mut free: Vec<usize> = (0..design.normal.nrows()).collect();
    let mut candidates = Vec::new();
    // From smooth to rough, each start with the free set of the last.
    for k in (DECADES.0 * PER_DECADE..=DECADES.1 * PER_DECADE).rev() {
        let lambda = size * 10f64.powf(f64::from(k) / f64::from(PER_DECADE));
        let Some(candidate) = candidate(design, lambda, &free) else {
            continue;
        };
        free.clone_from(&candidate.solution.free);
        candidates.push(candidate);
    }
    let best = candidates
        .iter()
        .map(|c| c.score)
        .fold(f64::INFINITY, f64::min);
    candidates.into_iter().find(|c| c.score <= AS_GOOD * best)
}

fn candidate(design: &Design, lambda: f64, guess: &[usize]) -> Option<Candidate> {
    let matrix = &design.normal + &design.penalty * lambda;
    let solution = solve(&matrix, &design.right, guess)?;
    let x = &solution.x;
    let rss = (design.square - 2.0 * x.dot(&design.right) + x.dot(&(&design.normal * x))).max(0.0);
    let free = &solution.free;
    let penalty = DMatrix::from_fn(free.len(), free.len(), |a, b| {
        lambda * design.penalty[(free[a], free[b])]
    });
    let freedom = free.len() as f64 - solution.factor.solve(&penalty).trace();
    let numbers = 2.0 * design.omega.len() as f64;
    let left = numbers - PENALTY_ON_FREEDOM * freedom;
    let score = if left > 0.0 {
        rss / (left * left)
    } else {
        f64::INFINITY
    };
    Some(Candidate {
        solution,
        lambda,
        rss,
        freedom,
        score,
    })
}

/// Posterior covariance of all unknowns: of those at zero, as if each alone were freed.
fn covariance(design: &Design, best: &Candidate) -> Option<DMatrix<f64>> {
    let n = design.normal.nrows();
    let free = &best.solution.free;
    let inverse = best.solution.factor.inverse();
    let scale = reduced_chi2(design, best).max(1.0);
    let mut covariance = DMatrix::zeros(n, n);
    for (a, i) in free.iter().enumerate() {
        for (b, j) in free.iter().enumerate() {
            covariance[(*i, *j)] = scale * inverse[(a, b)];
        }
    }
    let matrix = &design.normal + &design.penalty * best.lambda;
    for i in (0..n).filter(|i| !free.contains(i)) {
        let coupling = DVector::from_fn(free.len(), |a, _| matrix[(i, free[a])]);
        let own = matrix[(i, i)] - coupling.dot(&(&inverse * &coupling));
        covariance[(i, i)] = if own > 0.0 { scale / own } else { 0.0 };
    }
    covariance
        .iter()
        .all(|v| v.is_finite())
        .then_some(covariance)
}

fn reduced_chi2(design: &Design, best: &Candidate) -> f64 {
    best.rss / (2.0 * design.omega.len() as f64 - best.freedom).max(1.0)
}

fn result(design: &Design, best: &Candidate, covariance: &DMatrix<f64>) -> Drt {
    let x = &best.solution.x;
    let estimate = |j: usize| Estimate {
        value: x[j],
        sigma: covariance[(j, j)].sqrt(),
    };
    let nodes = design.nodes();
    let held = |j: &usize| best.solution.free.contains(j);
    let area_variance: f64 = nodes
        .clone()
        .filter(held)
        .flat_map(|i| nodes.clone().filter(held).map(move |j| (i, j)))
        .map(|ij| covariance[ij])
        .sum();
    let band = (
        1.0 / design.omega[design.omega.len() - 1],
        1.0 / design.omega[0],
    );
    Drt {
        gamma_ohm: nodes.clone().map(|j| x[j] / design.step).collect(),
        sigma_ohm: nodes
            .clone()
            .map(|j| covariance[(j, j)].sqrt() / design.step)
            .collect(),
        r_inf_ohm: estimate(0),
        inductance_h: estimate(1),
        elastance_per_f: estimate(2),
        warburg_ohm_per_sqrt_s: estimate(3),
        polarisation_ohm: Estimate {
            value: nodes.clone().map(|j| x[j]).sum(),
            sigma: area_variance.max(0.0).sqrt(),
        },
        lambda: best.lambda,
        freedom: best.freedom,
        reduced_chi2: reduced_chi2(design, best),
        peaks: peaks(
            &design.tau_s,
            &x.as_slice()[nodes.clone()],
            &covariance.view_range(nodes.clone(), nodes).into_owned(),
            band.0..=band.1,
        ),
        band_tau_s: band,
        slow_loop: None,
        tau_s: design.tau_s.clone(),
        fitted_ohm: design.impedance(x),
    }
}
