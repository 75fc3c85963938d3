//! Impedances that are known, their measurements, and the reasons why they give no correction.

use num_complex::Complex64;

use crate::spectrum::ChannelPhasors;

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
    /// Returns the impedance at a frequency, Ω.
    pub fn at(&self, freq_hz: f64) -> Complex64 {
        Complex64::new(self.r_ohm, std::f64::consts::TAU * freq_hz * self.l_h)
    }
}

/// Conductance and capacitance between the contacts of the empty jig, beside whatever is clamped
/// into it, with standard deviations.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct StrayAdmittance {
    /// Conductance, S.
    pub g_s: f64,
    /// Its standard deviation, S.
    pub g_sigma_s: f64,
    /// Capacitance, F.
    pub c_f: f64,
    /// Its standard deviation, F.
    pub c_sigma_f: f64,
}

impl StrayAdmittance {
    /// None, exactly.
    pub const NONE: Self = Self {
        g_s: 0.0,
        g_sigma_s: 0.0,
        c_f: 0.0,
        c_sigma_f: 0.0,
    };

    /// Stray admittance known from bounds: a leak of at least `least_ohm` and a capacitance of at
    /// most `greatest_f`. Any value between zero and the bound is equally likely.
    pub fn within(least_ohm: f64, greatest_f: f64) -> Self {
        let middle = |bound: f64| (0.5 * bound, bound / 12.0f64.sqrt());
        let ((g_s, g_sigma_s), (c_f, c_sigma_f)) = (middle(least_ohm.recip()), middle(greatest_f));
        Self {
            g_s,
            g_sigma_s,
            c_f,
            c_sigma_f,
        }
    }
}

/// Source of a correction's uncertainty.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The current shunt's resistance and inductance as they are known.
    Shunt,
    /// Gains that no control determines.
    Gain,
    /// Time skews that no control determines.
    Skew,
    /// Mutual inductances that no control determines.
    Mutual,
    /// The fake cell's impedance as it is known.
    FakeCell,
    /// The short's impedance as it is known.
    Short,
    /// The admittance of the open jig as it is known.
    Open,
    /// Noise of the runs over the controls.
    ControlNoise,
}

impl Source {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Shunt,
        Self::Gain,
        Self::Skew,
        Self::Mutual,
        Self::FakeCell,
        Self::Short,
        Self::Open,
        Self::ControlNoise,
    ];
}

/// Standard deviations of the harness parameters before any measurement.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Priors {
    /// Standard deviation of the gain of channels 2…4 relative to channel 1, around 1.
    pub gain_sigma: f64,
    /// Standard deviation of the time skew of channels 2…4 against channel 1, s, around 0.
    pub skew_sigma_s: f64,
    /// Standard deviation of the mutual inductance between current and voltage leads, H, around 0.
    pub mutual_sigma_h: f64,
}

impl Default for Priors {
    /// Gains within 1 %, skews within 1 µs, mutual inductances within 1 µH: looser than any bench
    /// that works.
    fn default() -> Self {
        Self {
            gain_sigma: 0.01,
            skew_sigma_s: 1e-6,
            mutual_sigma_h: 1e-6,
        }
    }
}

/// Measured controls that the harness is corrected by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controls<'a> {
    /// The current shunt, between C1 and C2 in all runs.
    pub current_shunt: KnownImpedance,
    /// Run with C3 and C4 moved onto the current shunt; may be empty.
    pub shunt: &'a [ChannelPhasors],
    /// Run with a fake cell of known impedance in the jig.
    pub fake_cell: Option<(KnownImpedance, &'a [ChannelPhasors])>,
    /// Run with a short in the jig.
    pub short: Option<(KnownImpedance, &'a [ChannelPhasors])>,
    /// Meter reading of the open jig. If it was not measured, it has no effect: no admittance, and
    /// no uncertainty of it.
    pub open: Option<StrayAdmittance>,
    /// Prior knowledge of the harness.
    pub priors: Priors,
}

/// Reason why controls give no correction.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// There is nothing to correct by.
    #[error("expected points of at least one control, met none")]
    NoPoints,
    /// A known impedance is none.
    #[error(
        "{name}: expected a positive resistance, a finite inductance and standard deviations of 0 \
        or more, met {known:?}"
    )]
    Known {
        /// Name of the impedance.
        name: &'static str,
        /// Impedance that was given.
        known: KnownImpedance,
    },
    /// An open jig is none.
    #[error(
        "open jig: expected a finite conductance and capacitance and standard deviations of 0 or \
        more, met {stray:?}"
    )]
    Stray {
        /// Admittance that was given.
        stray: StrayAdmittance,
    },
    /// A prior leaves nothing open, or all.
    #[error("expected priors with positive, finite standard deviations, met {priors:?}")]
    Priors {
        /// Priors that were given.
        priors: Priors,
    },
    /// A measured point is unusable.
    #[error("{control} control, point {number} ({freq_hz} Hz): expected {expected}, met {found}")]
    Point {
        /// Name of the control.
        control: &'static str,
        /// Number of the point, from 1.
        number: usize,
        /// Frequency, Hz.
        freq_hz: f64,
        /// Allowed values, as text.
        expected: &'static str,
        /// Value found.
        found: String,
    },
    /// The parameters do not settle.
    #[error(
        "correction did not settle after {steps} steps; the sum of squares stands at \
        {sum_squares:.3}"
    )]
    NotConverged {
        /// Steps taken.
        steps: usize,
        /// Sum of squares at the end.
        sum_squares: f64,
    },
}
