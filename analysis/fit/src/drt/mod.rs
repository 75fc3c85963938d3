//! Distribution of relaxation times: a spectrum as R∞, L and a continuum of RC elements, γ(τ) d ln
//! τ. The part below the band is a series capacitance and a Warburg element.
//!
//! Tikhonov's regularisation (see Wan, Saccoccio, Chen and Ciucci, Electrochim. Acta 184 (2015)
//! 483): weighted least squares plus λ times the squared second derivative of γ, under γ ≥ 0, γ → 0
//! beyond the grid. λ is chosen by generalised cross-validation, because it needs neither the noise
//! nor a corner found by eye; degrees of freedom count 1.4-fold, because plain cross-validation of
//! few points sometimes follows the noise. The uncertainty is that of the Gaussian posterior of the
//! elements that are not held at zero: it covers the effect of the noise at this λ, but not the
//! effect of another smoothness.
//!
//! Inductive and diffusive ends have elements of their own, so that they do not come out as peaks.
//! A loop with Im Z > 0 at low frequency has one branch with a negative resistance, whose time
//! constant is searched.
//! Knows no fit; [`start_values`] serves one.

mod design;
pub(crate) mod nonnegative;
mod peaks;
mod solve;
mod start;

pub use peaks::Peak;
pub use solve::drt;
pub use start::start_values;

use crate::validity::LoopBand;
use analysis_numeric::significant::format_significant;
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

/// A band below the upper end of a sweep in which Im Z > 0, which resistances and capacitances
/// cannot describe.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SlowLoop {
    /// Where it is.
    pub band: LoopBand,
    /// The inductive branch that describes it; `None` if the spectrum is described as well without.
    pub branch: Option<InductiveBranch>,
}

/// A branch −R/(1 + jωτ): a resistance in parallel with the inductance Rτ, less the resistance.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct InductiveBranch {
    /// Its time constant, s; without an uncertainty.
    pub tau_s: f64,
    /// Amount by which it lowers the resistance at zero frequency, Ω.
    pub r_ohm: Estimate,
}

impl SlowLoop {
    /// Describes the loop and its treatment in a sentence.
    pub fn in_words(&self) -> String {
        let short = |value| format_significant(value, 3);
        let LoopBand { from_hz, to_hz } = self.band;
        let seen = format!(
            "Im Z > 0 from {} Hz to {} Hz, a slow inductive loop",
            short(from_hz),
            short(to_hz)
        );
        match &self.branch {
            Some(InductiveBranch { tau_s, r_ohm }) => format!(
                "{seen}: it is followed by a branch of its own, −{} ± {} mΩ with {} s, which counts \
                in no peak",
                short(1e3 * r_ohm.value),
                format_significant(1e3 * r_ohm.sigma, 2),
                short(*tau_s)
            ),
            None => format!(
                "{seen}: this distribution cannot follow it, and its slow resistances come out too \
                small"
            ),
        }
    }
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
    /// A loop at low frequency with Im Z > 0; `None` without such a loop.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub slow_loop: Option<SlowLoop>,
    /// The model at the measured frequencies, Ω.
    #[serde(skip)]
    pub fitted_ohm: Vec<Complex64>,
}

/// Reason why a distribution cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DrtError {
    /// The numbers are not a valid spectrum.
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
