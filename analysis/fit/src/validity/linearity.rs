//! Does the cell answer in proportion? From sweeps at different amplitudes.
//!
//! The change of Z from the smallest to the largest is held against its uncertainty at every
//! frequency, the probabilities corrected for their number after Holm.

use super::noise::Noise;
use super::tail::{holm, pair_tail};
use super::{FALSE_ALARM_RATE, same_grid};
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;
use serde::Serialize;

/// Amplitudes that differ by less than this share are one.
const SAME_AMPLITUDE: f64 = 0.1;

/// Change of the impedance at one frequency.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LinearityPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// |ΔZ|/|Z| from the smallest to the largest amplitude, %.
    pub change_percent: f64,
    /// Standard deviation that noise alone gives to each part of the change, %.
    pub sigma_percent: f64,
    /// Probability of such a change in a linear system, corrected for the number of frequencies.
    pub p: f64,
    /// The change is beyond what noise explains.
    pub nonlinear: bool,
}

/// Comparison of sweeps at different amplitudes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Linearity {
    /// Smallest and largest amplitude of the sweeps, A (median over the band).
    pub amplitudes_a: (f64, f64),
    /// The points, by rising frequency.
    pub points: Vec<LinearityPoint>,
}

/// Compares the sweeps at the smallest with those at the largest amplitude; `None` unless one grid
/// has two amplitudes.
pub fn linearity(spectra: &[Spectrum], noises: &[Noise]) -> Option<Linearity> {
    let first = spectra.first()?;
    let known: Vec<(f64, &Spectrum, &Noise)> = spectra
        .iter()
        .zip(noises)
        .filter(|(s, _)| same_grid(s, first))
        .map(|(s, n)| (amplitude(s), s, n))
        .filter(|(a, ..)| *a > 0.0)
        .collect();
    let lowest = known.iter().map(|k| k.0).fold(f64::INFINITY, f64::min);
    let highest = known.iter().map(|k| k.0).fold(0.0, f64::max);
    if highest.is_nan() || highest <= lowest * (1.0 + SAME_AMPLITUDE) {
        return None;
    }
    let group = |at: f64| {
        known
            .iter()
            .filter(move |k| (k.0 / at - 1.0).abs() < SAME_AMPLITUDE)
    };
    let dof = known.iter().filter_map(|k| k.2.dof).reduce(f64::min);
    let made = (0..first.points.len()).map(|k| {
        let (small, cov_small) = mean(group(lowest), k);
        let (large, cov_large) = mean(group(highest), k);
        let (change, covariance) = (large - small, cov_small + cov_large);
        let scale = 100.0 / small.norm();
        LinearityPoint {
            freq_hz: first.points[k].freq_hz,
            change_percent: scale * change.norm(),
            sigma_percent: scale * (0.5 * (covariance.re_re + covariance.im_im)).sqrt(),
            p: pair_tail(squared_distance(change, covariance), dof),
            nonlinear: false,
        }
    });
    let mut points: Vec<LinearityPoint> = made.collect();
    let adjusted = holm(&points.iter().map(|p| p.p).collect::<Vec<_>>());
    for (point, p) in points.iter_mut().zip(adjusted) {
        point.p = p;
        point.nonlinear = p < FALSE_ALARM_RATE;
    }
    Some(Linearity {
        amplitudes_a: (lowest, highest),
        points,
    })
}

/// Returns the median amplitude of a spectrum, A; NaN if it is unknown.
pub(super) fn amplitude(spectrum: &Spectrum) -> f64 {
    super::noise::median(
        spectrum
            .points
            .iter()
            .map(|p| p.amplitude_a)
            .filter(|a| !a.is_nan())
            .collect(),
    )
}

fn mean<'a>(
    group: impl Iterator<Item = &'a (f64, &'a Spectrum, &'a Noise)>,
    point: usize,
) -> (Complex64, Covariance2) {
    let (mut count, mut sum, mut covariance) = (0.0, Complex64::ZERO, Covariance2::ZERO);
    for (_, spectrum, noise) in group {
        count += 1.0;
        sum += spectrum.points[point].z_ohm;
        covariance = covariance + noise.covariance[point];
    }
    (sum / count, covariance.scaled((1.0 / count).into()))
}

/// dᵀ C⁻¹ d.
pub(super) fn squared_distance(d: Complex64, c: Covariance2) -> f64 {
    let determinant = c.re_re * c.im_im - c.re_im * c.re_im;
    (c.im_im * d.re * d.re - 2.0 * c.re_im * d.re * d.im + c.re_re * d.im * d.im) / determinant
}
