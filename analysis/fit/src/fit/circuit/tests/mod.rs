//! Tests of a circuit's fit: known circuits, honest uncertainty, seeds, real files, refusals.

mod known;
mod real;
mod refusal;
mod shared;
mod sums;

use analysis_model::model::Circuit;
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use num_complex::Complex64;

/// `count` frequencies, evenly over the logarithm.
fn frequencies((low, high): (f64, f64), count: u32) -> Vec<f64> {
    (0..count)
        .map(|k| low * (high / low).powf(f64::from(k) / f64::from(count.max(2) - 1)))
        .collect()
}

/// A spectrum of any impedance with independent normal noise of `relative`·|Z| in each part, its
/// covariance stated.
fn noisy(
    truth: impl Fn(f64) -> Complex64,
    freqs: &[f64],
    (relative, rng): (f64, &mut Rng),
) -> Spectrum {
    let point = |freq_hz: &f64| {
        let z = truth(*freq_hz);
        let sigma = relative * z.norm();
        let z_ohm = z + sigma * Complex64::new(rng.normal(), rng.normal());
        let covariance = if relative > 0.0 {
            Covariance2::circular(sigma * sigma)
        } else {
            Covariance2::UNKNOWN
        };
        ImpedancePoint {
            freq_hz: *freq_hz,
            z_ohm,
            covariance,
            amplitude_a: 1.0,
        }
    };
    Spectrum {
        name: "simulated".into(),
        points: freqs.iter().map(point).collect(),
        ..Spectrum::default()
    }
}

/// The same without any stated uncertainty.
fn without_covariance(mut spectrum: Spectrum) -> Spectrum {
    spectrum
        .points
        .iter_mut()
        .for_each(|p| p.covariance = Covariance2::UNKNOWN);
    spectrum
}

fn parse(text: &str) -> Circuit {
    text.parse().unwrap()
}
