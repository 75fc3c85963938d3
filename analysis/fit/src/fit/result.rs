//! A fitted model.

use super::minima::LocalMinimum;
use super::options::{Bounds, Objective};
use super::storage::ChargeStorage;
use super::uncertainty::ErmSigma;
use super::warning::{WarningCode, Warnings};
use analysis_model::model::Erm;
use analysis_numeric::stats::t_factor;
use analysis_signal::spectrum::OcvSlope;
use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// A fitted model and what is known of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErmFit {
    /// The model, branches by rising time constant.
    pub erm: Erm,
    /// Value of the objective at the model, in the unit of its kind.
    pub objective: f64,
    /// Objective that was minimised.
    pub objective_kind: Objective,
    /// Number of points fitted, over all spectra.
    pub points: usize,
    /// Number of spectra pooled.
    pub spectra: usize,
    /// Number of cells whose scatter gives the sigmas; `None` if they come from the noise of points
    /// or sweeps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cells: Option<usize>,
    /// Standard uncertainty (1σ) of the parameters.
    pub sigma: ErmSigma,
    /// Covariance of the logarithmic parameters ln R, ln R₁, ln C₁, … (so: relative), row by row;
    /// `None` if the data do not determine all of them.
    pub log_covariance: Option<Vec<Vec<f64>>>,
    /// Slope of the open-circuit voltage beside the model; `None` if the spectra contain it or it
    /// was left in them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub charge_storage: Option<ChargeStorage>,
    /// Root mean square of |Z_model − Z_data|, Ω. Errors that the points have in common count as
    /// part of the model.
    pub rms_ohm: f64,
    /// χ² per degree of freedom; only for complex least squares with a covariance at every point.
    /// Where the sigmas rest on cells, of the fits to each cell.
    pub reduced_chi2: Option<f64>,
    /// Warnings to a user of the model, in sentences; empty when there is nothing.
    #[serde(flatten)]
    pub warnings: Warnings,
    /// Other minima of the objective that the search met, deepest first: a fit that starts badly
    /// ends in one of these.
    #[serde(default)]
    pub other_minima: Vec<LocalMinimum>,
    /// Bounds the parameters were kept in.
    pub bounds: Bounds,
    /// Seed of the global search.
    pub seed: u64,
}

/// Degrees of freedom of noise that is known.
const MANY: f64 = 1e8;

impl ErmFit {
    /// Returns why the model is not a result: its parameters at a bound, in sentences. There the
    /// bound decides and not the data, so that neither the parameter nor a sum with it is measured.
    pub fn at_bounds(&self) -> Option<String> {
        let held = self
            .warnings
            .iter()
            .filter(|warning| warning.code == WarningCode::AtBound);
        let words: Vec<&str> = held.map(|warning| warning.words.as_str()).collect();
        (!words.is_empty()).then(|| words.join("; "))
    }

    /// Returns the half width of a 95 % interval in sigmas: 1.96, or more if the sigmas come from
    /// few cells (Student's t).
    pub fn sigmas_of_95(&self) -> f64 {
        t_factor(
            0.95,
            self.cells
                .map_or(MANY, |cells| cells.saturating_sub(1) as f64),
        )
    }

    /// Returns the impedance that would be measured, Ω: that of the model and, if it was
    /// subtracted, the share of the open-circuit voltage.
    pub fn impedance(&self, freq_hz: f64) -> Complex64 {
        let storage = |s: ChargeStorage| {
            OcvSlope {
                v_per_coulomb: s.v_per_coulomb,
                sigma_v_per_coulomb: 0.0,
            }
            .impedance(freq_hz)
        };
        self.erm.impedance(freq_hz) + self.charge_storage.map_or(Complex64::ZERO, storage)
    }
}
