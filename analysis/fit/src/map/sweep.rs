//! A spectrum at one state of the cell.

use super::{
    log::check_temperatures,
    options::{MapFitError, MapSpectrum},
};
use analysis_model::ocv::OcvCurve;
use analysis_signal::series::Role;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Error of a map with fixed time constants on an impedance, as a part of its modulus.
pub(super) const ERROR_PART: f64 = 0.02;
/// Points of a spectrum at least.
const LEAST_POINTS: usize = 3;

/// The points of a spectrum that a map describes: those without an inductive part.
#[derive(Debug, Clone)]
pub(super) struct Sweep {
    pub(super) name: String,
    pub(super) role: Role,
    pub(super) soc: f64,
    pub(super) temperature_degc: f64,
    pub(super) points: Vec<SweepPoint>,
    /// Number of points at low frequencies that are predicted only.
    low: usize,
    /// Number of points with an inductive part, which are left out.
    pub(super) inductive: usize,
}

/// A point of a spectrum.
#[derive(Debug, Clone, Copy)]
pub(super) struct SweepPoint {
    /// Angular frequency, rad/s.
    pub(super) omega: f64,
    /// Impedance without that of the OCV's change with the charge, Ω.
    pub(super) z_ohm: Complex64,
    /// Error that the weights assume, Ω.
    pub(super) error_ohm: f64,
}

impl Sweep {
    pub(super) fn new(spectrum: &MapSpectrum, ocv: &OcvCurve) -> Result<Self, MapFitError> {
        let name = spectrum.name.clone();
        check_temperatures(&name, &[spectrum.temperature_degc])?;
        if !(0.0..=1.0).contains(&spectrum.soc) {
            return Err(MapFitError::Soc {
                name,
                met: spectrum.soc,
            });
        }
        // Ω·rad/s: the OCV follows the charge as the voltage of a capacitor does.
        let stored = ocv.slope_v(spectrum.soc) / (3600.0 * ocv.capacity_ah);
        let points = spectrum
            .points
            .iter()
            .filter(|p| p.freq_hz > 0.0 && p.z_ohm.im <= 0.0);
        let mut points: Vec<SweepPoint> = points
            .map(|p| {
                let omega = TAU * p.freq_hz;
                SweepPoint {
                    omega,
                    z_ohm: p.z_ohm + Complex64::new(0.0, stored / omega),
                    error_ohm: p
                        .sigma_ohm
                        .unwrap_or(0.0)
                        .hypot(ERROR_PART * p.z_ohm.norm()),
                }
            })
            .collect();
        points.sort_by(|a, b| a.omega.total_cmp(&b.omega));
        let is_bad =
            |p: &SweepPoint| !(p.z_ohm.is_finite() && p.error_ohm.is_finite() && p.error_ohm > 0.0);
        if let Some(bad) = points.iter().find(|p| is_bad(p)) {
            let freq_hz = bad.omega / TAU;
            return Err(MapFitError::Impedance { name, freq_hz });
        }
        if points.len() < LEAST_POINTS {
            return Err(MapFitError::FewPoints {
                name,
                expected: LEAST_POINTS,
                met: points.len(),
            });
        }
        Ok(Self {
            role: spectrum.role,
            soc: spectrum.soc,
            temperature_degc: spectrum.temperature_degc,
            inductive: spectrum.points.len() - points.len(),
            points,
            low: 0,
            name,
        })
    }

    /// Fits only the points from a frequency on, Hz, and predicts the others.
    pub(super) fn fit_from(mut self, freq_hz: f64) -> Self {
        let is_low = |p: &SweepPoint| p.omega < TAU * freq_hz;
        self.low = self.points.partition_point(is_low);
        self
    }

    /// Points that are fitted.
    pub(super) fn fitted(&self) -> &[SweepPoint] {
        &self.points[self.low..]
    }

    /// Number of points that are predicted only.
    pub(super) fn low(&self) -> usize {
        self.low
    }

    /// Returns whether enough points are fitted to count as a spectrum.
    pub(super) fn is_fitted(&self) -> bool {
        self.role == Role::Train && self.fitted().len() >= LEAST_POINTS
    }

    /// Returns whether a branch of this time constant changes within the fitted frequencies.
    pub(super) fn shows(&self, tau_s: f64) -> bool {
        let points = self.fitted();
        match (points.first(), points.last()) {
            (Some(first), Some(last)) => (1.0 / last.omega..=1.0 / first.omega).contains(&tau_s),
            _ => false,
        }
    }

    /// Real part of the impedance at the lowest frequency, Ω.
    pub(super) fn lowest_ohm(&self) -> f64 {
        self.points[0].z_ohm.re
    }
}
