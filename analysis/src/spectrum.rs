//! Phasors of the four probe channels, and complex impedances with their uncertainty.
//!
//! A phasor `p` stands for the signal Re{p · exp(jωt)}; all phasors of one point share the same time zero. The voltage pair is channel 4 minus
//! channel 3, the current pair channel 2 minus channel 1 over the shunt (thesis 3.3.1).

use num_complex::Complex64;

/// Phasors of the four single-ended probe channels at one frequency, before any correction.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ChannelPhasors {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Phasors of channels 1…4, V (zero to peak).
    pub volts: [Complex64; 4],
    /// Variance of the real part (and, equal and independent, of the imaginary part) of each phasor, V².
    pub variance: [f64; 4],
}

/// A complex impedance at one frequency with the covariance of its parts.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ImpedancePoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Impedance, Ω.
    pub z_ohm: Complex64,
    /// Covariance of (Re, Im), Ω².
    pub covariance: Covariance2,
    /// Amplitude of the current, A (zero to peak); not a number where a file does not tell.
    pub amplitude_a: f64,
}

/// Covariance of a complex number's real and imaginary part, in its unit squared. Not a number where unknown.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Covariance2 {
    /// Variance of the real part.
    pub re_re: f64,
    /// Covariance of the real and the imaginary part.
    pub re_im: f64,
    /// Variance of the imaginary part.
    pub im_im: f64,
}

impl Covariance2 {
    /// Nothing is known of the uncertainty.
    pub const UNKNOWN: Self = Self { re_re: f64::NAN, re_im: f64::NAN, im_im: f64::NAN };
}

/// Impedance over frequency of one fixture in one run.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Spectrum {
    /// Where it comes from: a file name, a run.
    pub name: String,
    /// The points, by rising frequency.
    pub points: Vec<ImpedancePoint>,
}
