//! Distribution of relaxation times: a spectrum as R∞, L and a continuum of RC elements, γ(τ) d ln
//! τ. The part below the band is a series capacitance and a Warburg element.
//!
//! Tikhonov's regularisation (see Wan, Saccoccio, Chen and Ciucci, Electrochim. Acta 184
//! (2015) 483): weighted least squares plus λ times the squared second derivative of γ, under γ ≥
//! 0, γ → 0 beyond the grid. λ is chosen by generalised cross-validation, because it needs neither
//! the noise nor a corner found by eye; degrees of freedom count 1.4-fold, for plain
//! cross-validation of few points follows the noise now and then. The uncertainty is that of the
//! Gaussian posterior of the elements that are not held at zero: it tells what noise does for this
//! λ, not what another smoothness would show.
//!
//! Inductive and diffusive ends have elements of their own, so that they do not come out as peaks.
//! Knows no fit; [`start_values`] serves one.

mod design;
pub(crate) mod nonnegative;
mod peaks;
mod solve;
mod start;

pub use peaks::Peak;
pub use solve::drt;
pub use start::start_values;

use analysis_signal::spectrum::SpectrumError;
use num_complex::Complex64;
use serde::Serialize;

/// A value with its standard deviation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// Distribution of relaxation times of a spectrum.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Drt {
    /// Time constants of the grid, s, rising, equally spaced in the logarithm.
    pub tau_s: Vec<f64>,
    /// Resistance per unit of ln τ, Ω; zero or more.
    pub gamma_ohm: Vec<f64>,
    /// Standard deviation of `gamma_ohm` by the noise, Ω.
    pub sigma_ohm: Vec<f64>,
    /// Resistance at infinite frequency, Ω.
    pub r_inf_ohm: Estimate,
    /// Series inductance, H.
    pub inductance_h: Estimate,
    /// Inverse of the series capacitance, 1/F: the tail below the band that is like 1/(jωC).
    pub elastance_per_f: Estimate,
    /// Coefficient A of the Warburg element A/√(jω), Ω/√s: the tail that is like diffusion.
    pub warburg_ohm_per_sqrt_s: Estimate,
    /// Area under γ, Ω.
    pub polarisation_ohm: Estimate,
    /// Strength of the regularisation.
    pub lambda: f64,
    /// Effective number of parameters.
    pub freedom: f64,
    /// Weighted sum of squared residuals over their degrees of freedom.
    pub reduced_chi2: f64,
    /// Peaks of γ by rising time constant.
    pub peaks: Vec<Peak>,
    /// Time constants 1/ω of the ends of the band, s.
    pub band_tau_s: (f64, f64),
    /// The model at the measured frequencies, Ω.
    #[serde(skip)]
    pub fitted_ohm: Vec<Complex64>,
}

/// Reason why there is no distribution.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DrtError {
    /// Numbers that are no spectrum.
    #[error(transparent)]
    Spectrum(#[from] SpectrumError),
    /// Nothing to distribute.
    #[error(
        "distribution of relaxation times of {spectrum:?}: expected at least {expected} points, \
        met {met}"
    )]
    TooFewPoints {
        /// Name of the spectrum.
        spectrum: String,
        /// Points needed.
        expected: usize,
        /// Points met.
        met: usize,
    },
    /// Numbers too large or too unequal to be squared.
    #[error(
        "distribution of relaxation times of {spectrum:?}: expected a problem that can be solved, \
        met a singular one"
    )]
    Singular {
        /// Name of the spectrum.
        spectrum: String,
    },
}

#[cfg(test)]
mod tests;
