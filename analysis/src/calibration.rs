//! Correction of the harness by the measured control impedances.
//!
//! Along the loop, from earth: return wire – C1 | current shunt | C2 – wire – C3 | thing in the jig | C4, every channel single-ended. Channel k shows
//! cₖ = aₖ·exp(−jωτₖ) times the potential of its tip, relative to channel 1 (c₁ = 1), and the loop of the voltage leads picks up jωM·i at C4:
//!
//! * i = (V₂/c₂ − V₁)/(R_s + jωL_s)
//! * u = V₄/c₄ − V₃/c₃ − jωM·i
//! * Z = u/i
//!
//! Since the potential that C3 and C4 share is several times the voltage between them, a mismatch of their gains *adds* an error to Z that is
//! proportional to that shared potential. No factor on Z can take it off, and one found on the shunt is wrong on the cell.
//!
//! Two controls determine the parameters: the voltage probes on the shunt (V₃/c₃ = V₁; V₄/c₄ − V₂/c₂ = jωM_shunt·i) and a fake cell of known
//! impedance in the jig (u = (R_f + jωL_f)·i). Every parameter has a Gaussian prior, so that what was not measured stays as uncertain as it was, and
//! the uncertainty of the correction travels with every impedance. Combinations that the controls cannot tell apart, such as a skew of C4 and
//! the pick-up, share their prior uncertainty; where they act alike on the cell too, that cancels.
//!
//! Knows no file and no fit of sinusoids: phasors with their noise come in.

mod model;
mod solve;
mod verdict;

use crate::spectrum::{ChannelPhasors, Covariance2, ImpedancePoint};
use model::{COUNT, Harness};
pub use verdict::{ControlTolerance, ControlVerdict, check_control};

/// An impedance R + jωL known from elsewhere, with standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct KnownImpedance {
    /// Resistance, Ω; positive.
    pub r_ohm: f64,
    /// Standard deviation of the resistance, Ω.
    pub r_sigma_ohm: f64,
    /// Inductance, H.
    pub l_h: f64,
    /// Standard deviation of the inductance, H.
    pub l_sigma_h: f64,
}

impl KnownImpedance {
    /// Impedance at a frequency, Ω.
    pub fn at(&self, freq_hz: f64) -> num_complex::Complex64 {
        num_complex::Complex64::new(self.r_ohm, std::f64::consts::TAU * freq_hz * self.l_h)
    }
}

/// Standard deviations of what the harness is before anything is measured.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Priors {
    /// Of the gain of channels 2…4 relative to channel 1, around 1.
    pub gain_sigma: f64,
    /// Of the time skew of channels 2…4 against channel 1, s, around 0.
    pub skew_sigma_s: f64,
    /// Of the mutual inductance between current and voltage leads, H, around 0.
    pub mutual_sigma_h: f64,
}

impl Default for Priors {
    /// Gains within 1 %, skews within 1 µs, mutual inductances within 1 µH: looser than any bench that works.
    fn default() -> Self {
        Self { gain_sigma: 0.01, skew_sigma_s: 1e-6, mutual_sigma_h: 1e-6 }
    }
}

/// What was measured to correct the harness by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controls<'a> {
    /// The current shunt, between C1 and C2 in all runs.
    pub current_shunt: KnownImpedance,
    /// Run with C3 and C4 moved onto the current shunt; may be empty.
    pub shunt: &'a [ChannelPhasors],
    /// Run with a fake cell of known impedance in the jig.
    pub fake_cell: Option<(KnownImpedance, &'a [ChannelPhasors])>,
    /// What is known of the harness beforehand.
    pub priors: Priors,
}

/// The harness as it turned out, to correct measurements by.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Correction {
    values: [f64; COUNT],
    covariance: [[f64; COUNT]; COUNT],
    has_fake_cell: bool,
    /// Sum of squared deviations, each over its standard deviation, per degree of freedom: near 1 if model and noise are right. `None` if nothing
    /// was measured.
    pub reduced_chi2: Option<f64>,
    /// Degrees of freedom: real numbers measured. Every parameter has a prior and so takes none.
    pub dof: usize,
    /// Factor on the stated noise of the controls that the scatter asked for; 1 unless `reduced_chi2` is significantly above 1.
    pub noise_factor: f64,
    /// Lowest and highest frequency of the controls, Hz.
    pub span_hz: Option<(f64, f64)>,
}

/// A parameter of the harness.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct HarnessParameter {
    /// Name.
    pub name: &'static str,
    /// Value, in `unit`.
    pub value: f64,
    /// Standard deviation, in `unit`.
    pub sigma: f64,
    /// SI unit; `1` for a pure number.
    pub unit: &'static str,
}

/// Why controls give no correction.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// There is nothing to correct by.
    #[error("expected points of at least one control, met none")]
    NoPoints,
    /// A known impedance is none.
    #[error("{name}: expected a positive resistance, a finite inductance and standard deviations of 0 or more, met {known:?}")]
    Known {
        /// Which one.
        name: &'static str,
        /// What was given.
        known: KnownImpedance,
    },
    /// A prior leaves nothing open, or all.
    #[error("expected priors with positive, finite standard deviations, met {priors:?}")]
    Priors {
        /// What was given.
        priors: Priors,
    },
    /// A measured point is unusable.
    #[error("{control} control, point {number} ({freq_hz} Hz): expected {expected}, met {found}")]
    Point {
        /// Which control.
        control: &'static str,
        /// Number of the point, from 1.
        number: usize,
        /// Frequency, Hz.
        freq_hz: f64,
        /// What it should be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// The parameters do not settle.
    #[error("correction did not settle after {steps} steps; the sum of squares stands at {sum_squares:.3}")]
    NotConverged {
        /// Steps taken.
        steps: usize,
        /// Where they ended.
        sum_squares: f64,
    },
}

impl Correction {
    /// Finds the harness that explains the controls best, by weighted least squares with priors.
    ///
    /// Where the controls scatter significantly more than their stated noise, the noise is taken for that much larger.
    ///
    /// # Errors
    /// [`CalibrationError`] for unusable input, or if the parameters do not settle.
    pub fn fit(controls: &Controls<'_>) -> Result<Self, CalibrationError> {
        solve::check(controls)?;
        solve::fit(controls)
    }

    /// Nothing measured, nothing corrected: the current shunt as given, and all else at the default [`Priors`] with their uncertainty.
    pub fn none(current_shunt: KnownImpedance) -> Self {
        let controls = Controls { current_shunt, shunt: &[], fake_cell: None, priors: Priors::default() };
        solve::unmeasured(&controls)
    }

    /// Corrected impedance, with the covariance that the noise of the phasors and the uncertainty of the correction give it together. Not finite
    /// where there is no current.
    pub fn apply(&self, phasors: &ChannelPhasors) -> ImpedancePoint {
        let harness = Harness::new(&self.values, phasors);
        let (current, impedance) = (harness.current(), harness.impedance());
        let covariance = impedance.noise(&phasors.variance) + impedance.carried(&self.covariance);
        ImpedancePoint { freq_hz: phasors.freq_hz, z_ohm: impedance.value, covariance, amplitude_a: current.value.norm() }
    }

    /// Part of the covariance of [`Self::apply`] that comes from the uncertainty of the correction, Ω². It is common to all measurements corrected
    /// so: averaging them does not lower it.
    pub fn carried_covariance(&self, phasors: &ChannelPhasors) -> Covariance2 {
        Harness::new(&self.values, phasors).impedance().carried(&self.covariance)
    }

    /// The parameters with standard deviations.
    pub fn parameters(&self) -> Vec<HarnessParameter> {
        let count = if self.has_fake_cell { COUNT } else { COUNT - model::FAKE_CELL };
        let parameter = |index: usize| {
            let (name, unit) = model::NAMES[index];
            HarnessParameter { name, value: self.values[index], sigma: self.covariance[index][index].sqrt(), unit }
        };
        (0..count).map(parameter).collect()
    }
}
