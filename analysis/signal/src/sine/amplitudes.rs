//! Amplitude spectrum of a record, for inspection: it shows which other frequencies are present.

use std::f64::consts::TAU;

use num_complex::Complex64;
use rustfft::FftPlanner;

/// Returns the amplitudes of the frequencies above 0 Hz up to half the sampling rate, as (Hz, V
/// zero to peak).
///
/// The mean is subtracted, and the record is weighted by a Hann window, so that a strong line does
/// not hide distant ones: a sinusoid in the middle of a bin has its amplitude there and half of it
/// in the adjacent bins.
///
/// ```
/// use analysis_signal::sine::amplitudes;
///
/// let turn = |k: i32| std::f64::consts::TAU * 8.0 * f64::from(k) / 256.0;
/// let samples: Vec<f64> = (0..256).map(|k| 1.0 + 0.3 * turn(k).sin()).collect();
/// let found = amplitudes(&samples, 1e-3);
/// assert!((found[7].0 - 31.25).abs() < 1e-9 && (found[7].1 - 0.3).abs() < 1e-9);
/// assert!(found[20..].iter().all(|(_, amplitude)| *amplitude < 1e-9));
/// ```
pub fn amplitudes(samples: &[f64], interval_s: f64) -> Vec<(f64, f64)> {
    let count = samples.len();
    if count < 4 {
        return Vec::new();
    }
    let mean = samples.iter().sum::<f64>() / count as f64;
    let window = |k: usize| 0.5 * (1.0 - (TAU * k as f64 / count as f64).cos());
    let mut values: Vec<Complex64> = samples
        .iter()
        .enumerate()
        .map(|(k, value)| Complex64::from((value - mean) * window(k)))
        .collect();
    FftPlanner::new()
        .plan_fft_forward(count)
        .process(&mut values);
    let weight: f64 = (0..count).map(window).sum();
    let resolution_hz = 1.0 / (count as f64 * interval_s);
    (1..=count / 2)
        .map(|k| (k as f64 * resolution_hz, 2.0 * values[k].norm() / weight))
        .collect()
}
