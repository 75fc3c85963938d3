//! The fit of an extended Randles model: global search, polish, uncertainty.

use super::between::{Between, between_cells};
use super::cells::CellSweeps;
use super::clusters::Clusters;
use super::minima::other_minima;
use super::options::{FitError, FitOptions, check_spectra};
use super::outliers;
use super::problem::{Problem, to_erm};
use super::result::ErmFit;
use super::search::search;
use super::storage::{ChargeStorage, Fitted, carry, charge_storage, settle_noise};
use super::uncertainty::Uncertainty;
use super::warning::{WarningCode, Warnings};
use super::warnings::warnings;
use crate::validity::sign_remarks;
use analysis_numeric::Smooth;
use analysis_signal::spectrum::Spectrum;

/// Fits one model to all points of all spectra together.
///
/// Points of equal frequency are pooled, so that many sweeps cost little more than one. The result
/// depends on the data and the options alone.
///
/// ```
/// use analysis_fit::fit::{FitOptions, fit_erm};
/// use analysis_model::model::{Erm, RcBranch};
/// use analysis_numeric::Covariance2;
/// use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
///
/// // A cell of 15 mΩ and 10 mΩ ‖ 30 F, from 10 mHz to 1 kHz without noise.
/// let cell = Erm { r_ohm: 0.015, branches: vec![RcBranch { r_ohm: 0.01, c_f: 30.0 }] };
/// let point = |k: i32| {
///     let freq_hz = 10.0_f64.powf(-2.0 + 0.2 * f64::from(k));
///     let (z_ohm, covariance) = (cell.impedance(freq_hz), Covariance2::UNKNOWN);
///     ImpedancePoint { freq_hz, z_ohm, covariance, amplitude_a: 1.0 }
/// };
/// let spectrum = Spectrum { points: (0..26).map(point).collect(), ..Spectrum::default() };
/// let fit = fit_erm(&[spectrum], &FitOptions { rc: 1, ..FitOptions::default() })?;
/// assert!((fit.erm.r_ohm - 0.015).abs() < 1e-6);
/// assert!((fit.erm.time_constants_s()[0] - 0.3).abs() < 1e-4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`FitError`] for options or data that cannot be fitted: no points, invalid impedances, more
/// parameters than numbers, bad bounds.
pub fn fit_erm(spectra: &[Spectrum], options: &FitOptions) -> Result<ErmFit, FitError> {
    fit(spectra, options, &Clusters::sweeps(spectra.len()), 0)
}

/// As [`fit_erm`], with sigmas from the scatter of the cells if two or more are known, and with
/// `starts` additional descents from random time constants, which make the search more reliable and
/// find more of the other minima.
///
/// # Errors
/// As [`fit_erm`].
pub fn fit_cells(
    cells: &[CellSweeps],
    options: &FitOptions,
    starts: usize,
) -> Result<ErmFit, FitError> {
    let (spectra, clusters) = Clusters::of_cells(cells);
    fit(&spectra, options, &clusters, starts)
}

fn fit(
    spectra: &[Spectrum],
    options: &FitOptions,
    clusters: &Clusters,
    starts: usize,
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
        .and_then(|_| between_cells(spectra, options, clusters, &x, &mut uncertainty));
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
        rms_ohm: problem.rms_ohm(&problem.seen(&x)),
        reduced_chi2: within_chi2.or(pooled_chi2),
        sigma: uncertainty.sigma,
        charge_storage,
        log_covariance: uncertainty.log_covariance,
        erm,
        warnings: Warnings::default(),
        other_minima: other_minima(&problem, options, &found),
        bounds: options.bounds,
        seed: options.seed,
    };
    if !fit.objective.is_finite() {
        return Err(FitError::TooLarge);
    }
    fit.warnings = warnings(&fit, &problem, spectra, minimum.converged);
    fit.warnings.extend(
        fit.charge_storage
            .as_ref()
            .and_then(ChargeStorage::contradiction)
            .map(|words| WarningCode::ChargeStorage.says(words)),
    );
    let repeats = clusters.remark(fit.cells.is_none() && problem.absolute_weights);
    let signs = sign_remarks(spectra, options.rc);
    let outliers = outliers::remarks(spectra, Some(&fit.erm));
    fit.warnings
        .extend(repeats.map(|words| WarningCode::Repeats.says(words)));
    fit.warnings
        .extend(signs.into_iter().map(|words| WarningCode::Sign.says(words)));
    fit.warnings.extend(outliers);
    Ok(fit)
}
