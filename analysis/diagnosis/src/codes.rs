//! Quantisation error of a converter whose noise is too small to dither the codes. Samples of one
//! voltage share this error, so no mean removes it.
//!
//! A converter of step q after noise of standard deviation σ reads v + b(v) on average, b(v) = Σₖ
//! (−1)ᵏ·q/(πk)·sin(2πkv/q)·exp(−2π²k²σ²/q²) (Widrow and Kollár, Quantization Noise, chapter 9).
//! The position of the codes relative to the voltages is not known: averaged over all positions, b
//! at two voltages has the covariance K(Δ) = Σₖ q²/(2π²k²)·exp(−4π²k²σ²/q²)·cos(2πkΔ/q). The rest
//! of q²/12 is independent in every sample.

use crate::thresholds::DITHERED_PART;
use std::f64::consts::{PI, TAU};

/// Harmonics of the error.
const HARMONICS: i32 = 12;

/// A converter with the noise before it, both in the unit of the reading.
#[derive(Debug, Clone, Copy)]
pub(super) struct Codes {
    /// Step; 0 if it is unknown.
    pub(super) step: f64,
    /// Standard deviation of the noise of a sample.
    pub(super) sigma: f64,
}

impl Codes {
    /// Returns the covariance of the errors that samples at two voltages share.
    pub(super) fn covariance(self, apart: f64) -> f64 {
        if self.step <= 0.0 {
            return 0.0;
        }
        let (ratio, phase) = (self.sigma / self.step, TAU * apart / self.step);
        let term = |k: f64| (-(TAU * k * ratio).powi(2)).exp() / (k * k) * (k * phase).cos();
        self.step * self.step / (2.0 * PI * PI)
            * (1..=HARMONICS).map(|k| term(f64::from(k))).sum::<f64>()
    }

    /// Returns the shared variance, or `None` if the noise dithers the codes.
    pub(super) fn shared(self) -> Option<f64> {
        let shared = self.covariance(0.0);
        (shared > DITHERED_PART * self.whole()).then_some(shared)
    }

    /// Returns the variance that is new in every sample.
    pub(super) fn fresh(self) -> f64 {
        (self.whole() - self.shared().unwrap_or(0.0)).max(0.0)
    }

    fn whole(self) -> f64 {
        self.step * self.step / 12.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shared_error_is_that_of_a_rounded_mean() {
        let step = 5.0;
        for (sigma, apart) in [(1.0, 0.0), (1.0, 1.5), (0.5, 2.5), (1.4, 0.7)] {
            let codes = Codes { step, sigma };
            // Means over the noise, by a fine quadrature, at all places of the codes.
            let bias = |v: f64| {
                let density = |x: f64| (-0.5 * (x / sigma).powi(2)).exp() / (sigma * TAU.sqrt());
                let (count, reach) = (4000, 8.0 * sigma);
                let h = 2.0 * reach / f64::from(count);
                (0..count)
                    .map(|k| -reach + (f64::from(k) + 0.5) * h)
                    .map(|x| h * density(x) * (((v + x) / step).round() * step - v))
                    .sum::<f64>()
            };
            let places = 200;
            let mean = (0..places)
                .map(|k| step * f64::from(k) / f64::from(places))
                .map(|v| bias(v) * bias(v + apart))
                .sum::<f64>()
                / f64::from(places);
            let met = codes.covariance(apart);
            assert!(
                (met - mean).abs() < 2e-3 * step * step / 12.0,
                "σ {sigma}, {apart} apart: {met} against {mean}"
            );
        }
    }

    #[test]
    fn noise_of_half_a_code_leaves_nothing_to_share() {
        let codes = Codes {
            step: 1.22e-3,
            sigma: 0.5e-3,
        };
        assert!(
            codes.shared().is_none() && (codes.fresh() - codes.step.powi(2) / 12.0).abs() < 1e-20
        );
        assert!(
            Codes {
                step: 5e-3,
                sigma: 1e-3
            }
            .shared()
            .is_some_and(|v| v > 0.1 * 25e-6 / 12.0)
        );
        assert!(
            Codes {
                step: 0.0,
                sigma: 1e-3
            }
            .shared()
            .is_none()
        );
    }
}
