//! The fit of an extended Randles model: global search, polish, uncertainty.

use super::global::{DeOptions, Member, Strategy, differential_evolution};
use super::local::{LocalOptions, Minimum, minimise};
use super::options::{Bounds, FitError, FitOptions, Objective, check_spectra};
use super::problem::{Problem, impedance};
use super::projection::Projection;
use super::uncertainty::{ErmSigma, Uncertainty};
use super::warnings::warnings;
use crate::model::{Erm, RcBranch};
use crate::spectrum::Spectrum;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A fitted model and what is known of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErmFit {
    /// The model, branches by rising time constant.
    pub erm: Erm,
    /// Value of the objective at the model, in the unit of its kind.
    pub objective: f64,
    /// What was made small.
    pub objective_kind: Objective,
    /// Number of points fitted, over all spectra.
    pub points: usize,
    /// Number of spectra pooled.
    pub spectra: usize,
    /// Standard uncertainty (1σ) of the parameters.
    pub sigma: ErmSigma,
    /// Covariance of the logarithmic parameters ln R, ln R₁, ln C₁, … (so: relative), row by row; none when the data do not fix them all.
    pub log_covariance: Option<Vec<Vec<f64>>>,
    /// Root mean square of |Z_model − Z_data|, Ω.
    pub rms_ohm: f64,
    /// χ² per degree of freedom; only for complex least squares with a covariance at every point.
    pub reduced_chi2: Option<f64>,
    /// What a user of the model must know, in sentences; empty when there is nothing.
    pub warnings: Vec<String>,
    /// Bounds the parameters were kept in.
    pub bounds: Bounds,
    /// Seed of the global search.
    pub seed: u64,
}

/// Fits one model to all points of all spectra together.
///
/// Points of equal frequency are pooled, so that many sweeps cost little more than one. The result depends on the data and the options alone.
///
/// # Errors
/// [`FitError`] for options or data that cannot be fitted: no points, points that are no impedances, more parameters than numbers, bad bounds.
pub fn fit_erm(spectra: &[Spectrum], options: &FitOptions) -> Result<ErmFit, FitError> {
    options.check()?;
    check_spectra(spectra)?;
    let problem = Problem::new(spectra, options.objective);
    options.check_size(problem.groups.len())?;
    let minimum = best_minimum(&problem, options);
    let erm = to_erm(&minimum.x).ordered();
    let uncertainty = Uncertainty::of(&problem, &erm, options, spectra.len());
    let mut fit = ErmFit {
        objective: minimum.value,
        objective_kind: options.objective,
        points: problem.points,
        spectra: spectra.len(),
        rms_ohm: rms_ohm(&problem, &minimum.x),
        reduced_chi2: problem.absolute_weights.then_some(minimum.value / uncertainty.freedom).filter(|c| c.is_finite()),
        sigma: uncertainty.sigma,
        log_covariance: uncertainty.log_covariance,
        erm,
        warnings: Vec::new(),
        bounds: options.bounds,
        seed: options.seed,
    };
    fit.warnings = warnings(&fit, &problem, spectra, minimum.converged);
    Ok(fit)
}

/// Bounds of the logarithmic parameters.
pub(super) fn log_bounds(options: &FitOptions) -> Vec<(f64, f64)> {
    let ln = |(lo, hi): (f64, f64)| (lo.ln(), hi.ln());
    let (r, c) = (ln(options.bounds.r_ohm), ln(options.bounds.c_f));
    std::iter::once(r).chain((0..options.rc).flat_map(|_| [r, c])).collect()
}

fn to_erm(x: &[f64]) -> Erm {
    let branches = x[1..].chunks_exact(2).map(|p| RcBranch { r_ohm: p[0].exp(), c_f: p[1].exp() }).collect();
    Erm { r_ohm: x[0].exp(), branches }
}

/// Polishes every basin the search found and keeps the deepest.
fn best_minimum(problem: &Problem, options: &FitOptions) -> Minimum {
    let bounds = log_bounds(options);
    let mut projection = Projection::new(problem, &options.bounds);
    let mut best: Option<Minimum> = None;
    for log_tau in basins(problem, options, &mut projection) {
        let minimum = polish(problem, &projection.parameters(&log_tau), &bounds);
        if best.as_ref().is_none_or(|b| minimum.value < b.value) {
            best = Some(minimum);
        }
    }
    best.unwrap_or_else(|| polish(problem, &projection.parameters(&[]), &bounds))
}

/// Distinct sets of time constants (logarithms, s) worth polishing, best first.
fn basins(problem: &Problem, options: &FitOptions, projection: &mut Projection<'_>) -> Vec<Vec<f64>> {
    const MOST: usize = 16;
    if options.rc == 0 {
        return Vec::new();
    }
    let range = log_tau_range(problem, &options.bounds);
    let search = DeOptions {
        population: 8 + 8 * options.rc,
        generations: 20 + 20 * options.rc,
        strategy: Strategy::Rand1,
        crossover: 0.9,
        spread: 1e-5,
        seed: options.seed,
    };
    let mut found: Vec<Vec<f64>> = Vec::new();
    for Member { mut x, .. } in differential_evolution(|x| projection.value(x), &vec![range; options.rc], &search) {
        x.sort_by(f64::total_cmp);
        let known = |f: &Vec<f64>| f.iter().zip(&x).all(|(a, b)| (a - b).abs() < 0.3);
        if !found.iter().any(known) {
            found.push(x);
        }
        if found.len() == MOST {
            break;
        }
    }
    found
}

/// Time constants the data can tell from none and from infinite: the band widened by two decades each way, within what the bounds allow.
fn log_tau_range(problem: &Problem, bounds: &Bounds) -> (f64, f64) {
    let allowed = ((bounds.r_ohm.0 * bounds.c_f.0).ln(), (bounds.r_ohm.1 * bounds.c_f.1).ln());
    let (Some(slowest), Some(fastest)) = (problem.groups.first(), problem.groups.last()) else { return allowed };
    let lo = (0.01 / (TAU * fastest.freq_hz)).ln().max(allowed.0);
    let hi = (100.0 / (TAU * slowest.freq_hz)).ln().min(allowed.1);
    if lo < hi { (lo, hi) } else { allowed }
}

/// To the bottom of the basin. The corner of the norm is sharpened step by step: a sum of norms alone would stall at points it meets exactly.
fn polish(problem: &Problem, start: &[f64], bounds: &[(f64, f64)]) -> Minimum {
    let options = LocalOptions::default();
    if problem.kind != Objective::SumAbs {
        return minimise(problem, start, bounds, &options);
    }
    let mut minimum = Minimum { x: start.to_vec(), value: f64::INFINITY, iterations: 0, converged: false };
    for corner in [1e-3, 1e-5, 1e-7, 1e-9] {
        minimum = minimise(&problem.smoothed(corner * problem.scale_ohm), &minimum.x, bounds, &options);
    }
    minimum.value = super::local::Smooth::value(problem, &minimum.x);
    minimum
}

fn rms_ohm(problem: &Problem, x: &[f64]) -> f64 {
    let square = |g: &super::problem::Group| {
        let z = impedance(x, g.freq_hz);
        g.points.iter().map(|p| (z - p.z).norm_sqr()).sum::<f64>()
    };
    (problem.groups.iter().map(square).sum::<f64>() / problem.points as f64).sqrt()
}
