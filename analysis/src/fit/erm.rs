//! The fit of an extended Randles model: global search, polish, uncertainty.

use super::cells::CellSweeps;
use super::clusters::Clusters;
use super::minima::{LocalMinimum, other_minima};
use super::options::{Bounds, FitError, FitOptions, Objective, check_spectra};
use super::outliers;
use super::problem::{Problem, impedance};
use super::search::search;
use super::uncertainty::{ErmSigma, Uncertainty};
use super::warnings::warnings;
use crate::model::{Erm, RcBranch};
use crate::spectrum::Spectrum;
use crate::validity::sign_remarks;
use serde::{Deserialize, Serialize};

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
    /// Number of cells whose scatter the sigmas rest on; none where they rest on the noise of points or sweeps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cells: Option<usize>,
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
    /// Other minima of the objective that the search met, deepest first: a fit that starts badly ends in one of these.
    #[serde(default)]
    pub other_minima: Vec<LocalMinimum>,
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
    fit(spectra, options, (&Clusters::sweeps(spectra.len()), 0))
}

/// As [`fit_erm`], with sigmas from the scatter of the cells where two or more are known, and with `starts` more descents from random time
/// constants: surer, and it meets more of the other minima.
///
/// # Errors
/// As [`fit_erm`].
pub fn fit_cells(cells: &[CellSweeps], options: &FitOptions, starts: usize) -> Result<ErmFit, FitError> {
    let (spectra, clusters) = Clusters::of_cells(cells);
    fit(&spectra, options, (&clusters, starts))
}

fn fit(spectra: &[Spectrum], options: &FitOptions, (clusters, starts): (&Clusters, usize)) -> Result<ErmFit, FitError> {
    options.check()?;
    check_spectra(spectra)?;
    let problem = Problem::new(spectra, options.objective);
    options.check_size(problem.groups.len())?;
    let found = search(&problem, options, starts);
    let minimum = &found.deepest.minimum;
    let erm = to_erm(&minimum.x).ordered();
    let uncertainty = Uncertainty::of(&problem, &erm, options, clusters);
    let mut fit = ErmFit {
        objective: minimum.value,
        objective_kind: options.objective,
        points: problem.points,
        spectra: spectra.len(),
        cells: clusters.cells().filter(|_| !problem.absolute_weights),
        rms_ohm: rms_ohm(&problem, &minimum.x),
        reduced_chi2: problem.absolute_weights.then_some(minimum.value / uncertainty.freedom).filter(|c| c.is_finite()),
        sigma: uncertainty.sigma,
        log_covariance: uncertainty.log_covariance,
        erm,
        warnings: Vec::new(),
        other_minima: other_minima(&problem, options, &found),
        bounds: options.bounds,
        seed: options.seed,
    };
    fit.warnings = warnings(&fit, &problem, spectra, minimum.converged);
    fit.warnings.extend(clusters.remark(problem.absolute_weights));
    fit.warnings.extend(sign_remarks(spectra).into_iter().chain(outliers::remarks(spectra, &fit.erm)));
    Ok(fit)
}

pub(super) fn to_erm(x: &[f64]) -> Erm {
    let branches = x[1..].chunks_exact(2).map(|p| RcBranch { r_ohm: p[0].exp(), c_f: p[1].exp() }).collect();
    Erm { r_ohm: x[0].exp(), branches }
}

fn rms_ohm(problem: &Problem, x: &[f64]) -> f64 {
    let square = |g: &super::problem::Group| {
        let z = impedance(x, g.freq_hz);
        g.points.iter().map(|p| (z - p.z).norm_sqr()).sum::<f64>()
    };
    (problem.groups.iter().map(square).sum::<f64>() / problem.points as f64).sqrt()
}
