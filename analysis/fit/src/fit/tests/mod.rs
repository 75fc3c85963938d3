//! Tests of the fit as a whole: the thesis' data, known circuits, noise, refusals, files.

mod additions;
mod clusters;
mod known;
mod minima;
mod order;
mod outliers;
mod profile;
mod refusal;
mod scale;
mod spread;
mod storage;
mod thesis;

use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use num_complex::Complex64;

/// A circuit R, (R₁, C₁), … written down independently of the model under test.
type Circuit<'a> = (f64, &'a [(f64, f64)]);

/// Impedance by real arithmetic: conductances and susceptances, not the model's own formula.
fn true_impedance((r, branches): Circuit<'_>, freq_hz: f64) -> Complex64 {
    let w = 2.0 * std::f64::consts::PI * freq_hz;
    branches.iter().fold(Complex64::new(r, 0.0), |z, (r, c)| {
        let (g, b) = (1.0 / r, w * c);
        z + Complex64::new(g / (g * g + b * b), -b / (g * g + b * b))
    })
}

/// `count` frequencies from 0.1 to 300 Hz, evenly over the logarithm.
fn frequencies(count: u32) -> Vec<f64> {
    (0..count)
        .map(|k| 0.1 * 3000f64.powf(f64::from(k) / f64::from(count - 1)))
        .collect()
}

/// A spectrum of a circuit with independent normal noise of `relative`·|Z| in each part, its
/// covariance stated.
fn noisy(circuit: Circuit<'_>, count: u32, relative: f64, rng: &mut Rng) -> Spectrum {
    let point = |freq_hz| {
        let z = true_impedance(circuit, freq_hz);
        let sigma = relative * z.norm();
        let z_ohm = z + sigma * Complex64::new(rng.normal(), rng.normal());
        let covariance = Covariance2 {
            re_re: sigma * sigma,
            re_im: 0.0,
            im_im: sigma * sigma,
        };
        ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance,
            amplitude_a: 1.0,
        }
    };
    Spectrum {
        name: "simulated".into(),
        points: frequencies(count).into_iter().map(point).collect(),
        ..Spectrum::default()
    }
}

fn exact(circuit: Circuit<'_>, count: u32) -> Spectrum {
    let mut spectrum = noisy(circuit, count, 0.0, &mut Rng::new(0));
    spectrum
        .points
        .iter_mut()
        .for_each(|p| p.covariance = Covariance2::UNKNOWN);
    spectrum
}
