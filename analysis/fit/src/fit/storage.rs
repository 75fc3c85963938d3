//! Charge storage beside the extended Randles model: fits the slope of the open-circuit voltage
//! whose share was subtracted from the spectra.

use super::common::Common;
use super::options::{FitOptions, Objective};
use super::problem::{Problem, to_erm};
use super::search::{log_bounds, polish};
use super::uncertainty::{Uncertainty, sigma_of};
use analysis_model::model::Erm;
use analysis_numeric::significant::format_significant;
use analysis_signal::spectrum::{OCV_SLOPE, OcvSlope, Spectrum};
use serde::{Deserialize, Serialize};

/// Rounds in which the scale of relative noise and the fit settle: each changes the fit by less
/// than the one before.
const NOISE_ROUNDS: usize = 3;

/// Slope of the open-circuit voltage beside a fitted model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChargeStorage {
    /// Slope dU/dQ, V/C: the given value, moved within its uncertainty towards the data.
    #[serde(rename = "v_per_c")]
    pub v_per_coulomb: f64,
    /// Its standard deviation, V/C; `None` if the data do not determine it.
    #[serde(rename = "sigma_v_per_c")]
    pub sigma_v_per_coulomb: Option<f64>,
    /// Slope that was given.
    pub given: OcvSlope,
    /// Resistance at zero frequency of the same model with the share of the slope left in the
    /// impedances, Ω: branches then imitate charge storage.
    pub apparent_dc_resistance_ohm: f64,
}

/// Scale of relative noise at which a prior is effectively absent: a standard deviation of 0.001 %
/// of
/// Z|.
const FAINT_NOISE: f64 = 1.0e-10;
/// Standard deviations beyond which a fitted slope contradicts the given one: 3 of 1000 do by
/// chance.
const CONTRADICTED: f64 = 3.0;

/// Fits again until the noise of relative weights is that of the residuals, so that what is known
/// of common errors counts for what it is worth.
///
/// The noise is first read where common errors are free. A misfit caused by the given values must
/// not count as noise, because that would hold the errors even closer to these values.
pub(super) fn settle_noise(
    problem: &mut Problem,
    options: &FitOptions,
    minimum: &mut analysis_numeric::Minimum,
) {
    if problem.absolute_weights || problem.common.is_none() {
        return;
    }
    let bounds = log_bounds(options);
    let freedom = (2 * problem.points).saturating_sub(minimum.x.len()) as f64;
    let scale = |problem: &mut Problem, noise: f64| {
        problem
            .common
            .as_mut()
            .and_then(|common| common.set_noise(noise))
            .is_some()
    };
    if !scale(problem, FAINT_NOISE) {
        return;
    }
    let mut noise = misfit(problem, &polish(problem, &minimum.x, &bounds)) / freedom.max(1.0);
    for _ in 0..NOISE_ROUNDS {
        if !(noise > 0.0 && noise.is_finite() && scale(problem, noise)) {
            return;
        }
        *minimum = polish(problem, &minimum.x, &bounds);
        noise = misfit(problem, minimum) / freedom.max(1.0);
    }
}

/// The objective without the share of the common errors themselves.
fn misfit(problem: &Problem, minimum: &analysis_numeric::Minimum) -> f64 {
    let own = problem.common.as_ref().map_or(0.0, |common| {
        common.own_share(&common.best(&problem.model(&minimum.x)).0)
    });
    minimum.value - own
}

impl ChargeStorage {
    /// Returns a sentence if the data contradict the given slope.
    pub(super) fn contradiction(&self) -> Option<String> {
        let off = (self.v_per_coulomb - self.given.v_per_coulomb) / self.given.sigma_v_per_coulomb;
        (off.abs() > CONTRADICTED && off.is_finite()).then(|| {
            let micro = |v: f64| format_significant(1.0e6 * v, 3);
            let source = if self.given.is_prior() {
                "of the prior (no slope was given)"
            } else {
                "given"
            };
            format!(
                "these data want {} µV/C as the slope of the open-circuit voltage, {} times its \
                uncertainty from the {} ± {} µV/C {source}: \
                 the curve, the state of charge or the prior is another, and the slow branches and \
                 the misfit depend on it; give the slope that holds here",
                micro(self.v_per_coulomb),
                format_significant(off.abs(), 3),
                micro(self.given.v_per_coulomb),
                micro(self.given.sigma_v_per_coulomb)
            )
        })
    }
}

/// Returns the slope of the fit; `None` if no charge storage was subtracted from the spectra.
pub(super) fn charge_storage(
    problem: &Problem,
    spectra: &[Spectrum],
    options: &FitOptions,
    fitted: &Fitted<'_>,
) -> Option<ChargeStorage> {
    let given: Vec<OcvSlope> = spectra
        .iter()
        .map(|spectrum| spectrum.less)
        .collect::<Option<_>>()?;
    let count = given.len() as f64;
    let mean = |of: fn(&OcvSlope) -> f64| given.iter().map(of).sum::<f64>() / count;
    let given = OcvSlope {
        v_per_coulomb: mean(|slope| slope.v_per_coulomb),
        sigma_v_per_coulomb: mean(|slope| slope.sigma_v_per_coulomb),
    };
    let deviation = problem
        .common
        .as_ref()
        .and_then(|common| slope_deviation(problem, common, fitted));
    let with: Vec<Spectrum> = spectra.iter().map(Spectrum::with_charge_storage).collect();
    let apparent = polish(
        &Problem::new(&with, options.objective),
        fitted.x,
        &log_bounds(options),
    );
    let (moved, sigma) = deviation.unwrap_or((0.0, Some(1.0)));
    Some(ChargeStorage {
        v_per_coulomb: given.v_per_coulomb + moved * given.sigma_v_per_coulomb,
        sigma_v_per_coulomb: sigma.map(|sigma| sigma * given.sigma_v_per_coulomb),
        given,
        apparent_dc_resistance_ohm: to_erm(&apparent.x).dc_resistance_ohm(),
    })
}

/// A fit as the slope is read from it.
pub(super) struct Fitted<'a> {
    /// Logarithmic parameters.
    pub(super) x: &'a [f64],
    /// Covariance of them.
    pub(super) log_covariance: Option<&'a [Vec<f64>]>,
    /// Variance of a residual of weight 1: 1 for weights that are inverse covariances.
    pub(super) noise: f64,
}

/// Returns the deviation of the slope and its standard deviation, in units of the given value.
fn slope_deviation(
    problem: &Problem,
    common: &Common,
    fitted: &Fitted<'_>,
) -> Option<(f64, Option<f64>)> {
    let error = common.names.iter().position(|name| name == OCV_SLOPE)?;
    let (best, _) = common.best(&problem.model(fitted.x));
    let flat = fitted
        .log_covariance
        .map(|rows| rows.iter().flatten().copied().collect::<Vec<f64>>());
    let sigma = flat.map(|flat| {
        common
            .variance(error, &problem.mixed(fitted.x), &flat, fitted.noise)
            .max(0.0)
            .sqrt()
    });
    Some((best.get(error).copied()?, sigma))
}

/// Adds the effect of the slope's uncertainty to a fit whose objective is not a sum of squares: the
/// change by one standard deviation of the slope.
pub(super) fn carry(
    spectra: &[Spectrum],
    options: &FitOptions,
    x: &[f64],
    uncertainty: &mut Uncertainty,
) {
    if options.objective == Objective::Complex
        || spectra
            .iter()
            .all(|spectrum| spectrum.less.is_none_or(|s| s.sigma_v_per_coulomb <= 0.0))
    {
        return;
    }
    let moved: Vec<Spectrum> = spectra.iter().map(with_slope_one_sigma_up).collect();
    let other = polish(
        &Problem::new(&moved, options.objective),
        x,
        &log_bounds(options),
    );
    let by: Vec<f64> = other.x.iter().zip(x).map(|(a, b)| a - b).collect();
    let Some(rows) = &mut uncertainty.log_covariance else {
        return;
    };
    rows.iter_mut().enumerate().for_each(|(i, row)| {
        row.iter_mut()
            .enumerate()
            .for_each(|(j, cell)| *cell += by[i] * by[j]);
    });
    let Ok(erm) = Erm::from_log_parameters(x) else {
        return;
    };
    uncertainty.sigma = sigma_of(&erm, &|i: usize, j: usize| {
        rows.get(i).and_then(|row| row.get(j)).copied()
    });
}

/// A spectrum as if the slope were larger by its standard deviation.
fn with_slope_one_sigma_up(spectrum: &Spectrum) -> Spectrum {
    let mut moved = spectrum.clone();
    if let Some(slope) = spectrum.less {
        let up = OcvSlope {
            v_per_coulomb: slope.sigma_v_per_coulomb,
            ..slope
        };
        moved
            .points
            .iter_mut()
            .for_each(|point| point.z_ohm -= up.impedance(point.freq_hz));
    }
    moved
}
