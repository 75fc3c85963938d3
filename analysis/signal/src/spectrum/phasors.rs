//! Phasors of the four probe channels with their uncertainty, by cause.

use num_complex::Complex64;

use super::SpectrumError;
use crate::sine::{ChannelFit, RELAXATION_LEFT, SineFit};
use analysis_numeric::Covariance2;

/// Phasors of the four single-ended probe channels at one frequency, before any correction.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ChannelPhasors {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Phasors of channels 1…4, V (zero to peak).
    pub volts: [Complex64; 4],
    /// Uncertainty of each phasor; the channels are independent of each other.
    pub variance: [PhasorVariance; 4],
}

/// Covariance of a phasor's real and imaginary part, V², by cause. The causes are independent of
/// each other.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PhasorVariance {
    /// Noise of the record, without that of rounding to codes.
    pub noise: Covariance2,
    /// Rounding to codes, LSB²/12 per sample.
    pub quantisation: Covariance2,
    /// Error by a drift that is not straight: see [`ChannelPhasors::from_codes`].
    pub drift: Covariance2,
}

impl PhasorVariance {
    /// Returns the variance of pure noise, equal in both parts, V².
    pub const fn circular(variance: f64) -> Self {
        Self {
            noise: Covariance2::circular(variance),
            quantisation: Covariance2::ZERO,
            drift: Covariance2::ZERO,
        }
    }

    /// All causes together, V².
    pub fn total(&self) -> Covariance2 {
        self.noise + self.quantisation + self.drift
    }
}

impl ChannelPhasors {
    /// Returns phasors of a fit of the four probe channels whose samples were not rounded, or whose
    /// rounding step is not known: rounding then counts as noise.
    ///
    /// # Errors
    /// [`SpectrumError::Channels`] unless the fit has four channels.
    pub fn from_fit(fit: &SineFit) -> Result<Self, SpectrumError> {
        Self::from_codes(fit, [0.0; 4])
    }

    /// Returns phasors of a fit of the four probe channels, sampled in steps of `lsb_v`.
    ///
    /// The fit's own covariance is that of its residual, rounding included; the share of rounding
    /// is LSB²/12 over the variance of a sample. Model of the drift: the fit removes a straight
    /// line. It is not known whether the drift is straight; its slope may change by as much as
    /// itself over the record (one standard deviation), as that of a relaxation with a time
    /// constant of one record does. The curvature d/T then adds (−1)ⁿ·d·T/(2π²n²) to the phasor of
    /// a record of n whole periods, in phase with a cosine about its middle. Fitted relaxations
    /// remove the curvature except for [`RELAXATION_LEFT`] of it. The same holds for a fitted change of
    /// the phasor: if its slope changes by itself over a record of length T, the phasor of the middle is
    /// wrong by slope·T/24.
    ///
    /// # Errors
    /// [`SpectrumError::Channels`] unless the fit has four channels.
    pub fn from_codes(fit: &SineFit, lsb_v: [f64; 4]) -> Result<Self, SpectrumError> {
        let channels = <&[ChannelFit; 4]>::try_from(fit.channels.as_slice()).map_err(|_| {
            SpectrumError::Channels {
                found: fit.channels.len(),
            }
        })?;
        let curve = curve_per_drift(fit);
        let variance = |slot: usize| {
            let (channel, lsb_v) = (&channels[slot], lsb_v[slot]);
            let fitted = channel.variance;
            let rounding = 2.0 * lsb_v * lsb_v / 12.0 / channel.samples_used.max(1) as f64;
            let mean = 0.5 * (fitted.re_re + fitted.im_im);
            let share = if mean > 0.0 {
                (rounding / mean).min(1.0)
            } else {
                0.0
            };
            PhasorVariance {
                noise: fitted.times(1.0 - share),
                quantisation: fitted.times(share),
                drift: if fit.relaxed {
                    Covariance2::circular(0.5 * (RELAXATION_LEFT * channel.relaxation_v).powi(2))
                } else {
                    Covariance2::along(curve * channel.drift_v_per_s)
                } + bent_change(fit, channel),
            }
        };
        Ok(Self {
            freq_hz: fit.freq_hz,
            volts: channels.map(|channel| channel.phasor),
            variance: [0, 1, 2, 3].map(variance),
        })
    }

    /// Returns the covariance of each phasor, V².
    pub fn totals(&self) -> [Covariance2; 4] {
        self.variance.map(|variance| variance.total())
    }
}

/// Returns the variance by a change of the phasor that is not straight; zero unless a change was fitted.
fn bent_change(fit: &SineFit, channel: &ChannelFit) -> Covariance2 {
    let length_s = fit.interval_s * fit.samples as f64;
    if fit.varying {
        Covariance2::along(channel.phasor_slope * (length_s / 24.0))
    } else {
        Covariance2::ZERO
    }
}

/// Returns the phasor (t = 0 at sample 0) that a curvature of 1 V/s per record leaves in a fit of
/// sine and offset, V per V/s.
///
/// With u = −1…1 over the record and a = πn for n periods, least squares of u² on 1 and cos au give
/// ⟨(u² − ⅓)·cos au⟩/⟨cos² au⟩ after the means are taken off; a straight drift and the sine are odd
/// and do not mix in.
fn curve_per_drift(fit: &SineFit) -> Complex64 {
    let (length_s, a) = (
        fit.interval_s * fit.samples as f64,
        std::f64::consts::PI * fit.periods(),
    );
    let (sin, cos) = a.sin_cos();
    let mean = sin / a;
    let mixed = mean + 2.0 * cos / (a * a) - 2.0 * sin / (a * a * a) - mean / 3.0;
    let square = 0.5 + sin * cos / (2.0 * a) - mean * mean;
    let in_middle = length_s / 8.0 * mixed / square;
    // The phasor at sample 0 of a cosine whose zero of time is the middle of the record.
    let middle_s = 0.5 * fit.interval_s * (fit.samples as f64 - 1.0);
    in_middle * Complex64::cis(-std::f64::consts::TAU * fit.freq_hz * middle_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sine::{Channel, FitOptions, Record, fit_known_frequency};

    /// Fit of four equal channels.
    fn fit(freq_hz: f64, samples: &[f64]) -> SineFit {
        let channels = [Channel::volts(samples); 4];
        fit_known_frequency(
            &Record {
                channels: &channels,
                interval_s: 1e-3,
            },
            freq_hz,
            &FitOptions::default(),
        )
        .unwrap()
    }

    #[test]
    fn drift_counts_as_much_as_a_slope_that_changes_by_itself_over_the_record() {
        // Whole and broken numbers of periods.
        for freq_hz in [5.0, 3.3, 1.72] {
            // Over 2 s the slope goes from half to three halves of 1 V/s: the mean is 1 V/s, and it
            // changes by 1 V/s.
            let curved: Vec<f64> = (0..2000)
                .map(|n| 1e-3 * f64::from(n))
                .map(|t| 0.5 * t + 0.25 * t * t)
                .collect();
            let fit = fit(freq_hz, &curved);
            assert!((fit.channels[0].drift_v_per_s - 1.0).abs() < 0.3, "{fit:?}");
            let stated = ChannelPhasors::from_fit(&fit).unwrap().variance[3]
                .drift
                .times(fit.channels[0].drift_v_per_s.powi(-2));
            let met = Covariance2::along(fit.channels[0].phasor);
            let scale = met.re_re + met.im_im;
            for (stated, met) in [
                (stated.re_re, met.re_re),
                (stated.re_im, met.re_im),
                (stated.im_im, met.im_im),
            ] {
                assert!(
                    (stated - met).abs() < 0.02 * scale,
                    "{freq_hz} Hz: {stated} V², met {met} V²"
                );
            }
        }
    }

    #[test]
    fn rounding_is_a_share_of_the_whole_and_never_more() {
        let wave: Vec<f64> = (0..1000)
            .map(|n| (0.1 * f64::from(n)).sin() + 0.01 * (1e3 * f64::from(n * n)).sin())
            .collect();
        let fit = fit(15.915, &wave);
        let plain = ChannelPhasors::from_fit(&fit).unwrap();
        assert_eq!(
            (plain.variance[0].quantisation, plain.variance[0].noise),
            (Covariance2::ZERO, fit.channels[0].variance)
        );
        // Steps of 10 mV in 1000 samples: 2·(10 mV)²/12/1000 in each part, near enough.
        let rounded = ChannelPhasors::from_codes(&fit, [0.01, 0.0, 1.0, 0.0]).unwrap();
        let [first, _, third, _] = rounded.variance;
        let mean = 0.5 * (first.quantisation.re_re + first.quantisation.im_im);
        assert!(
            (mean / (2.0 * 1e-4 / 12.0 / 1000.0) - 1.0).abs() < 1e-9,
            "{mean}"
        );
        let whole = first.noise + first.quantisation;
        assert!((whole.re_re / fit.channels[0].variance.re_re - 1.0).abs() < 1e-12);
        assert_eq!(
            (third.noise, third.quantisation),
            (Covariance2::ZERO, fit.channels[0].variance),
            "no more than there is"
        );
    }
}
