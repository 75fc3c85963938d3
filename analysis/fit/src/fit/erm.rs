//! The fit of an extended Randles model: global search, polish, uncertainty.

use super::between::{Between, between_cells};
use super::cells::CellSweeps;
use super::clusters::Clusters;
use super::minima::{LocalMinimum, other_minima};
use super::options::{Bounds, FitError, FitOptions, Objective, check_spectra};
use super::outliers;
use super::problem::Problem;
use super::search::search;
use super::storage::{ChargeStorage, Fitted, carry, charge_storage, settle_noise};
use super::uncertainty::{ErmSigma, Uncertainty};
use super::warnings::warnings;
use crate::validity::sign_remarks;
use analysis_model::model::{Erm, RcBranch};
use analysis_numeric::{Smooth, stats::t_factor};
use analysis_signal::spectrum::{OcvSlope, Spectrum};
use num_complex::Complex64;
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
    /// Number of cells whose scatter the sigmas rest on; none where they rest on the noise of
    /// points or sweeps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cells: Option<usize>,
    /// Standard uncertainty (1σ) of the parameters.
    pub sigma: ErmSigma,
    /// Covariance of the logarithmic parameters ln R, ln R₁, ln C₁, … (so: relative), row by row;
    /// none when the data do not fix them all.
    pub log_covariance: Option<Vec<Vec<f64>>>,
    /// Slope of the open-circuit voltage beside the model; none where the spectra hold it or it was
    /// left in them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub charge_storage: Option<ChargeStorage>,
    /// Root mean square of |Z_model − Z_data|, Ω. Errors that the points have in common count as
    /// part of the model.
    pub rms_ohm: f64,
    /// χ² per degree of freedom; only for complex least squares with a covariance at every point.
    /// Where the sigmas rest on cells, of the fits to each cell.
    pub reduced_chi2: Option<f64>,
    /// What a user of the model must know, in sentences; empty when there is nothing.
    pub warnings: Vec<String>,
    /// Other minima of the objective that the search met, deepest first: a fit that starts badly
    /// ends in one of these.
    #[serde(default)]
    pub other_minima: Vec<LocalMinimum>,
    /// Bounds the parameters were kept in.
    pub bounds: Bounds,
    /// Seed of the global search.
    pub seed: u64,
}

/// Fits one model to all points of all spectra together.
///
/// Points of equal frequency are pooled, so that many sweeps cost little more than one. The result
/// depends on the data and the options alone.
///
/// # Errors
/// [`FitError`] for options or data that cannot be fitted: no points, points that are no
/// impedances, more parameters than numbers, bad bounds.
pub fn fit_erm(spectra: &[Spectrum], options: &FitOptions) -> Result<ErmFit, FitError> {
    fit(spectra, options, (&Clusters::sweeps(spectra.len()), 0))
}

/// As [`fit_erm`], with sigmas from the scatter of the cells where two or more are known, and with
/// `starts` more descents from random time constants: surer, and it meets more of the other minima.
///
/// # Errors
/// As [`fit_erm`].
pub fn fit_cells(
    cells: &[CellSweeps],
    options: &FitOptions,
    starts: usize,
) -> Result<ErmFit, FitError> {
    let (spectra, clusters) = Clusters::of_cells(cells);
    fit(&spectra, options, (&clusters, starts))
}

fn fit(
    spectra: &[Spectrum],
    options: &FitOptions,
    (clusters, starts): (&Clusters, usize),
) -> Result<ErmFit, FitError> {
    options.check()?;
    check_spectra(spectra)?;
    let mut problem = Problem::new(spectra, options.objective);
    options.check_size(problem.groups.len())?;
    let coarse = Problem::coarse(spectra, options.objective);
    let mut found = search(&problem, &coarse, options, starts);
    settle_noise(&mut problem, options, &mut found.deepest.minimum);
    let minimum = &found.deepest.minimum;
    let erm = to_erm(&minimum.x).ordered();
    let mut uncertainty = Uncertainty::of(&problem, &erm, options, clusters);
    let x = erm.log_parameters();
    carry(spectra, options, &x, &mut uncertainty);
    let noise = if problem.absolute_weights {
        1.0
    } else {
        minimum.value / uncertainty.freedom.max(1.0)
    };
    let fitted = Fitted {
        x: &x,
        log_covariance: uncertainty.log_covariance.as_deref(),
        noise,
    };
    let mut charge_storage = charge_storage(&problem, spectra, options, &fitted);
    let pooled_chi2 = problem
        .absolute_weights
        .then_some(minimum.value / uncertainty.freedom)
        .filter(|c| c.is_finite());
    let cells = clusters.cells();
    let between = cells
        .filter(|_| problem.absolute_weights)
        .and_then(|_| between_cells(spectra, options, (clusters, &x), &mut uncertainty));
    let rests_on_cells = between.is_some() || !problem.absolute_weights;
    let (within_chi2, erm, x) = match between {
        Some(Between { erm, reduced_chi2 }) => {
            let more_ohm = erm.dc_resistance_ohm() - to_erm(&x).dc_resistance_ohm();
            charge_storage
                .iter_mut()
                .for_each(|storage| storage.apparent_dc_resistance_ohm += more_ohm);
            let x = erm.log_parameters();
            (reduced_chi2, erm, x)
        }
        None => (None, erm, x),
    };
    let mut fit = ErmFit {
        objective: if within_chi2.is_some() {
            problem.value(&x)
        } else {
            minimum.value
        }
        .max(0.0),
        objective_kind: options.objective,
        points: problem.points,
        spectra: spectra.len(),
        cells: cells.filter(|_| rests_on_cells),
        rms_ohm: rms_ohm(&problem, &x),
        reduced_chi2: within_chi2.or(pooled_chi2),
        sigma: uncertainty.sigma,
        charge_storage,
        log_covariance: uncertainty.log_covariance,
        erm,
        warnings: Vec::new(),
        other_minima: other_minima(&problem, options, &found),
        bounds: options.bounds,
        seed: options.seed,
    };
    fit.warnings = warnings(&fit, &problem, spectra, minimum.converged);
    fit.warnings.extend(
        fit.charge_storage
            .as_ref()
            .and_then(ChargeStorage::contradiction),
    );
    fit.warnings
        .extend(clusters.remark(fit.cells.is_none() && problem.absolute_weights));
    fit.warnings.extend(
        sign_remarks(spectra)
            .into_iter()
            .chain(outliers::remarks(spectra, &fit.erm)),
    );
    Ok(fit)
}

/// Degrees of freedom of noise that is known.
const MANY: f64 = 1e8;

impl ErmFit {
    /// Half width of a 95 % interval in sigmas: 1.96, more where the sigmas rest on few cells
    /// (Student's t).
    pub fn sigmas_of_95(&self) -> f64 {
        t_factor(
            0.95,
            self.cells
                .map_or(MANY, |cells| cells.saturating_sub(1) as f64),
        )
    }

    /// Impedance that the fit expects to be measured: the model and, where it was taken out, the
    /// share of the open-circuit voltage, Ω.
    pub fn impedance(&self, freq_hz: f64) -> Complex64 {
        let storage = |s: ChargeStorage| {
            OcvSlope {
                v_per_c: s.v_per_c,
                sigma_v_per_c: 0.0,
            }
            .impedance(freq_hz)
        };
        self.erm.impedance(freq_hz) + self.charge_storage.map_or(Complex64::ZERO, storage)
    }
}

pub(super) fn to_erm(x: &[f64]) -> Erm {
    let branches = x[1..]
        .chunks_exact(2)
        .map(|p| RcBranch {
            r_ohm: p[0].exp(),
            c_f: p[1].exp(),
        })
        .collect();
    Erm {
        r_ohm: x[0].exp(),
        branches,
    }
}

fn rms_ohm(problem: &Problem, x: &[f64]) -> f64 {
    let square = |(g, seen): (&super::problem::Group, &Vec<Complex64>)| {
        g.points
            .iter()
            .zip(seen)
            .map(|(p, z)| (z - p.z).norm_sqr())
            .sum::<f64>()
    };
    (problem
        .groups
        .iter()
        .zip(&problem.seen(x))
        .map(square)
        .sum::<f64>()
        / problem.points as f64)
        .sqrt()
}
