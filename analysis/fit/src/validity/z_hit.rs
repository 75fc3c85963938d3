//! Z-HIT: the modulus rebuilt from the phase, after Ehm, Göhr, Kaus, Röseler and Schiller (ACH
//! Models in Chemistry 137 (2000) 145): ln|Z(ω)| ≈ const + 2/π ∫ φ d ln ω − π/6 · dφ/d ln ω.
//!
//! The phase is local and hardly drifts, the modulus drifts with the cell: where they part at low
//! frequencies, the cell changed during the sweep. The relation is itself an approximation, good to
//! a per cent or so; it is applied here to what is left of modulus and phase after the
//! Kramers–Kronig ladder, for which both are exact, so that its own error and that of the smoothing
//! vanish to first order. Only the difference matters.

use super::kramers_kronig::KramersKronig;
use super::ladder::Whitening;
use super::noise::Noise;
use super::smooth::Whittaker;
use super::tail::deviate_tail;
use analysis_signal::spectrum::Spectrum;
use nalgebra::DMatrix;
use num_complex::Complex64;
use serde::Serialize;
use std::f64::consts::{FRAC_2_PI, PI};

/// Weight of the phase's slope.
const GAMMA: f64 = -PI / 6.0;

/// One point of the reconstruction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ZHitPoint {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Measured modulus, Ω.
    pub measured_ohm: f64,
    /// Modulus that the phase asks for, Ω.
    pub rebuilt_ohm: f64,
    /// Measured less rebuilt, %.
    pub deviation_percent: f64,
    /// Standard deviation that noise alone gives to it, %.
    pub sigma_percent: f64,
    /// Probability of such a deviation in a valid spectrum.
    pub p: f64,
}

/// Outcome of the Z-HIT test.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ZHit {
    /// The band in which the rebuilt modulus was set equal to the measured one, Hz: the middle half
    /// of the sweep, where neither drift nor inductance is large.
    pub anchor_hz: (f64, f64),
    /// Degrees of freedom that the smoothed phase difference has.
    pub smoothing_freedom: f64,
    /// The points, by rising frequency.
    pub points: Vec<ZHitPoint>,
}

/// Rebuilds the modulus of a spectrum that was tested by Kramers–Kronig. Points that the test left
/// out are passed over.
pub fn z_hit(spectrum: &Spectrum, noise: &Noise, kk: &KramersKronig) -> ZHit {
    let points = &spectrum.points;
    let n = points.len();
    let ratio: Vec<Complex64> = points
        .iter()
        .zip(&kk.fitted_ohm)
        .enumerate()
        .map(|(k, (p, f))| {
            if kk.is_single(k) {
                1.0.into()
            } else {
                p.z_ohm / f
            }
        })
        .collect();
    let ln_ratio: Vec<f64> = ratio.iter().map(|r| r.norm().ln()).collect();
    let phase: Vec<f64> = ratio.iter().map(|r| r.arg()).collect();
    let ln_omega: Vec<f64> = points.iter().map(|p| p.freq_hz.ln()).collect();
    let (smoothing, smoothing_freedom) = Whittaker::new(&ln_omega).matrix(&phase);
    let rebuild = transform(&ln_omega) * smoothing;
    let anchor = (n / 4, n - 1 - n / 4);
    let anchored = |rows: DMatrix<f64>| {
        let count = (anchor.1 - anchor.0 + 1) as f64;
        let mean: Vec<f64> = (0..n)
            .map(|k| (anchor.0..=anchor.1).map(|i| rows[(i, k)]).sum::<f64>() / count)
            .collect();
        DMatrix::from_fn(n, n, |i, k| rows[(i, k)] - mean[k])
    };
    let of_modulus = anchored(DMatrix::identity(n, n));
    let of_phase = anchored(rebuild);
    let point = |i: usize| {
        let deviation: f64 = (0..n)
            .map(|k| of_modulus[(i, k)] * ln_ratio[k] - of_phase[(i, k)] * phase[k])
            .sum();
        // Of ΔZ/Z, the real part is that of the modulus' logarithm and the imaginary part that of
        // the phase.
        let weight = |k: usize| {
            Complex64::new(of_modulus[(i, k)], -of_phase[(i, k)]) * points[k].z_ohm.inv().conj()
        };
        let variance = kk.ladder.variance(&whitened(kk.ladder.whitening(), weight));
        let measured_ohm = points[i].z_ohm.norm();
        let sigma = variance.sqrt();
        ZHitPoint {
            freq_hz: points[i].freq_hz,
            measured_ohm,
            rebuilt_ohm: if kk.is_single(i) {
                kk.fitted_ohm[i].norm()
            } else {
                measured_ohm * (-deviation).exp()
            },
            deviation_percent: 100.0 * deviation,
            sigma_percent: 100.0 * sigma,
            p: if sigma > 0.0 {
                deviate_tail(deviation / sigma, noise.dof)
            } else {
                1.0
            },
        }
    };
    let points_made = (0..n).map(point).collect();
    ZHit {
        anchor_hz: (points[anchor.0].freq_hz, points[anchor.1].freq_hz),
        smoothing_freedom,
        points: points_made,
    }
}

/// Weights of a linear function of the whitened residuals, from its weights (real, imaginary) for
/// those of each point in Ω.
fn whitened(whitening: &[Whitening], weight: impl Fn(usize) -> Complex64) -> Vec<f64> {
    let n = whitening.len();
    let mut weights = vec![0.0; 2 * n];
    for (k, w) in whitening
        .iter()
        .enumerate()
        .filter(|(_, w)| **w != Whitening::NONE)
    {
        let of = weight(k);
        weights[k] = (of.re - of.im * w.b / w.c) / w.a;
        weights[n + k] = of.im / w.c;
    }
    weights
}

/// The matrix that makes 2/π ∫ φ dx − π/6 dφ/dx of a phase φ over x = ln ω, the integral from the
/// first point.
fn transform(x: &[f64]) -> DMatrix<f64> {
    let n = x.len();
    let slope = slopes(x);
    let mut matrix = DMatrix::zeros(n, n);
    for i in 1..n {
        let h = x[i] - x[i - 1];
        for k in 0..n {
            // Trapezoid with its end correction, exact for cubics.
            let corner = f64::from(u8::from(k == i)) + f64::from(u8::from(k == i - 1));
            let area = 0.5 * h * corner - h * h / 12.0 * (slope[(i, k)] - slope[(i - 1, k)]);
            matrix[(i, k)] = matrix[(i - 1, k)] + FRAC_2_PI * area;
        }
    }
    matrix + slope * GAMMA
}

/// The matrix that makes the slope at every place, by the parabola through it and its neighbours.
fn slopes(x: &[f64]) -> DMatrix<f64> {
    let n = x.len();
    let mut matrix = DMatrix::zeros(n, n);
    for i in 0..n {
        let middle = i.clamp(1, n - 2);
        let places = [middle - 1, middle, middle + 1];
        for a in places {
            let others: Vec<f64> = places.iter().filter(|b| **b != a).map(|b| x[*b]).collect();
            matrix[(i, a)] =
                (2.0 * x[i] - others[0] - others[1]) / ((x[a] - others[0]) * (x[a] - others[1]));
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn grid(points: u32, low_hz: f64, high_hz: f64) -> Vec<f64> {
        (0..points)
            .map(|k| low_hz * (high_hz / low_hz).powf(f64::from(k) / f64::from(points - 1)))
            .collect()
    }

    /// 10 mΩ + a ZARC of 15 mΩ, 20 ms and the exponent 0.8.
    fn zarc(freq_hz: f64) -> Complex64 {
        let turn = Complex64::from_polar((TAU * freq_hz * 0.02).powf(0.8), 0.8 * PI / 2.0);
        0.010 + 0.015 / (1.0 + turn)
    }

    /// ln|Z| that the phases ask for, set equal to the true one at the first frequency.
    fn rebuilt(freqs_hz: &[f64], z: impl Fn(f64) -> Complex64) -> Vec<f64> {
        let ln_omega: Vec<f64> = freqs_hz.iter().map(|f| (TAU * f).ln()).collect();
        let matrix = transform(&ln_omega);
        let asked = |i: usize| {
            freqs_hz
                .iter()
                .enumerate()
                .map(|(k, f)| matrix[(i, k)] * z(*f).arg())
                .sum::<f64>()
        };
        (0..freqs_hz.len())
            .map(|i| z(freqs_hz[0]).norm().ln() + asked(i) - asked(0))
            .collect()
    }

    #[test]
    fn the_modulus_of_a_zarc_follows_from_its_phase() {
        // Of a modulus that falls by a factor of 2.49, the formula leaves 0.82 % by a summation
        // over 6000 frequencies, the next term of the series, which has the third derivative of the
        // phase. Without the slope it would be 5.4 %, with the other sign 11 %.
        let freqs_hz = grid(60, 0.01, 1e4);
        for (met, f) in rebuilt(&freqs_hz, zarc).iter().zip(&freqs_hz) {
            assert!(
                (met - zarc(*f).norm().ln()).abs() < 0.0090,
                "{f} Hz: {met}, expected {}",
                zarc(*f).norm().ln()
            );
        }
        assert!(zarc(0.01).norm() / zarc(1e4).norm() > 2.45);
    }

    #[test]
    fn a_power_law_is_rebuilt_exactly() {
        // |Z| of (jω)^−0.7 falls as ω^−0.7 while its phase stays: the integral alone, in closed form.
        let freqs_hz = grid(20, 0.1, 201.0);
        for (met, f) in rebuilt(&freqs_hz, |f| {
            Complex64::from_polar(f.powf(-0.7), -0.35 * PI)
        })
        .iter()
        .zip(&freqs_hz)
        {
            assert!((met - -0.7 * f.ln()).abs() < 1e-9, "{f} Hz: {met}");
        }
    }
}
