//! The rows of the least squares, and a ladder that was fitted to them.

use analysis_model::model::RcBranch;
use num_complex::Complex64;
use std::ops::RangeInclusive;

/// Weight of the DC resistance among the rows of the band.
pub(super) const DC_WEIGHT: f64 = 3.0;
/// A resistance that is a smaller part of the largest |Z| counts as zero.
pub(super) const NOTHING: f64 = 1e-9;

/// A ladder and its error.
#[derive(Debug, Clone)]
pub(super) struct Met {
    pub(super) r_ohm: f64,
    pub(super) branches: Vec<RcBranch>,
    pub(super) elastance_per_f: f64,
    /// Largest relative error.
    pub(super) worst: f64,
    /// Angular frequency of that error, rad/s.
    pub(super) worst_omega: f64,
}

/// The rows of the least squares: what is to be followed at the frequencies that are fitted.
pub(super) struct Rows {
    pub(super) omega: Vec<f64>,
    pub(super) z_ohm: Vec<Complex64>,
    /// |Z| that errors are relative to.
    pub(super) scale_ohm: Vec<f64>,
    /// DC resistance of the rest and of all, Ω.
    pub(super) dc_ohm: Option<(f64, f64)>,
    /// Limits of the time constants, s.
    pub(super) tau_s: RangeInclusive<f64>,
}

/// Impedance of a capacitance by its inverse.
pub(super) fn pole(omega: f64, elastance_per_f: f64) -> Complex64 {
    Complex64::new(0.0, -elastance_per_f / omega)
}
