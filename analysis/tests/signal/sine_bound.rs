//! The sinusoid fit against the Cramér–Rao bound on 12-bit codes, and where quantisation does not
//! act as noise.
//!
//! The bound is computed here from the model's derivatives, sample by sample; the noise is that of
//! the signal and of the rounding, σ² + 1/12 LSB².

use std::f64::consts::TAU;

use analysis::sine::{
    Channel, CodeScale, Drift, FitOptions, Note, Record, SineFit, fit_free_frequency,
    fit_known_frequency,
};
use nalgebra::DMatrix;
use num_complex::Complex64;
use rayon::prelude::*;

use crate::sine_model::codes;

const ADC: CodeScale = CodeScale {
    volts_per_code: 1.0,
    offset_v: 0.0,
    code_min: -2048,
    code_max: 2047,
    code_step: 1,
};
const INTERVAL_S: f64 = 1e-3;
const COUNT: usize = 700;

/// A record to be measured often.
#[derive(Debug, Clone, Copy)]
struct Case {
    freq_hz: f64,
    amplitude: f64,
    /// Amplitude of the third harmonic over that of the sinusoid; 0 for none in the signal.
    third: f64,
    noise_lsb: f64,
    free: bool,
}

impl Case {
    fn signal(&self, t: f64) -> f64 {
        let theta = TAU * self.freq_hz * t;
        self.amplitude * ((theta + 0.4).cos() + self.third * (3.0 * theta + 1.1).cos())
            + 0.37
            + 2.0 * t
    }

    fn fit(&self, seed: u64, options: &FitOptions) -> SineFit {
        let codes = codes(COUNT, self.noise_lsb, seed, |t| self.signal(t));
        let channels = [Channel::codes(&codes, ADC)];
        let record = Record {
            channels: &channels,
            interval_s: INTERVAL_S,
        };
        if self.free {
            fit_free_frequency(&record, Some(self.freq_hz), options).unwrap()
        } else {
            fit_known_frequency(&record, self.freq_hz, options).unwrap()
        }
    }

    /// Returns the least variance of the phasor (both parts), and of the frequency: the inverse of
    /// the Fisher information.
    fn bound(&self, options: &FitOptions) -> (f64, f64) {
        let drift = if options.drift == Drift::None { 1 } else { 2 };
        let tones = 1 + options.harmonics.len();
        let columns = 2 * tones + drift + usize::from(self.free);
        let derivatives = DMatrix::from_fn(COUNT, columns, |n, column| {
            let t = n as f64 * INTERVAL_S;
            let order = if column / 2 == 0 {
                1.0
            } else {
                options
                    .harmonics
                    .get(column / 2 - 1)
                    .map_or(0.0, |order| f64::from(*order))
            };
            let theta = TAU * order * self.freq_hz * t;
            match column {
                _ if column < 2 * tones && column % 2 == 0 => theta.cos(),
                _ if column < 2 * tones => -theta.sin(),
                _ if column == 2 * tones => 1.0,
                _ if column == 2 * tones + 1 && drift == 2 => t,
                // Of the whole signal by the frequency.
                _ => {
                    let step = 1e-6;
                    let moved = |by: f64| {
                        Self {
                            freq_hz: self.freq_hz + by,
                            ..*self
                        }
                        .signal(t)
                    };
                    (moved(step) - moved(-step)) / (2.0 * step)
                }
            }
        });
        let noise = self.noise_lsb * self.noise_lsb + 1.0 / 12.0;
        let inverse = (derivatives.transpose() * derivatives)
            .try_inverse()
            .unwrap()
            * noise;
        (
            inverse[(0, 0)] + inverse[(1, 1)],
            inverse[(columns - 1, columns - 1)],
        )
    }

    /// Returns the mean square errors of phasor and frequency over the bound, and the stated
    /// variances over the bound.
    fn efficiency(&self, trials: u64, options: &FitOptions) -> [f64; 4] {
        let truth = Complex64::from_polar(self.amplitude, 0.4);
        let one = |seed: u64| {
            let fit = self.fit(seed, options);
            let variance = fit.absolute_covariance(0).unwrap();
            let stated_hz2 = fit.freq_sigma_hz.map_or(0.0, |sigma| sigma * sigma);
            [
                (fit.channels[0].phasor - truth).norm_sqr(),
                (fit.freq_hz - self.freq_hz).powi(2),
                variance.re_re + variance.im_im,
                stated_hz2,
            ]
        };
        let sums: Vec<[f64; 4]> = (0..trials).into_par_iter().map(one).collect();
        let mean = |index: usize| sums.iter().map(|sum| sum[index]).sum::<f64>() / trials as f64;
        let (phasor, freq) = self.bound(options);
        [
            mean(0) / phasor,
            mean(1) / freq,
            mean(2) / phasor,
            mean(3) / freq,
        ]
    }
}

fn options(drift: Drift, harmonics: &[u32]) -> FitOptions {
    FitOptions {
        drift,
        harmonics: harmonics.to_vec(),
        ..FitOptions::default()
    }
}

#[test]
fn a_known_frequency_is_as_good_as_the_bound() {
    // 5000 trials of two parts determine a variance to 1.4 %; the requirement is 1.05.
    for (amplitude, third, noise_lsb) in [
        (2.5, 0.0, 0.5),
        (11.3, 0.0, 0.5),
        (900.0, 0.0, 1.0),
        (900.0, 0.2, 0.5),
    ] {
        let case = Case {
            freq_hz: 17.3,
            amplitude,
            third,
            noise_lsb,
            free: false,
        };
        let options = options(Drift::Linear, if third > 0.0 { &[3] } else { &[] });
        let [phasor, _, stated, _] = case.efficiency(5000, &options);
        assert!(
            (0.94..1.05).contains(&phasor),
            "{case:?}: variance over bound {phasor}"
        );
        assert!(
            (0.96..1.05).contains(&stated),
            "{case:?}: stated over bound {stated}"
        );
    }
}

#[test]
fn a_free_frequency_is_as_good_as_the_bound() {
    for (amplitude, third, noise_lsb) in [(2.5, 0.0, 0.5), (900.0, 0.0, 0.5), (300.0, 0.5, 0.7)] {
        let case = Case {
            freq_hz: 17.3,
            amplitude,
            third,
            noise_lsb,
            free: true,
        };
        let options = options(Drift::Linear, if third > 0.0 { &[3] } else { &[] });
        let [phasor, freq, stated, stated_freq] = case.efficiency(2000, &options);
        assert!(
            phasor < 1.1 && freq < 1.1,
            "{case:?}: variances over bounds {phasor} {freq}"
        );
        assert!(
            phasor > 0.9 && freq > 0.9,
            "{case:?}: nothing beats the bound: {phasor} {freq}"
        );
        assert!(
            (stated - 1.0).abs() < 0.05 && (stated_freq - 1.0).abs() < 0.05,
            "{case:?}: stated {stated} {stated_freq}"
        );
    }
}

fn quantisation(fit: &SineFit) -> Option<(f64, Option<usize>, f64)> {
    fit.notes.iter().find_map(|note| match note {
        Note::Quantisation {
            noise_lsb,
            phases,
            bound_v,
            ..
        } => Some((*noise_lsb, *phases, *bound_v)),
        _ => None,
    })
}

#[test]
fn without_noise_the_error_stays_within_the_bound_and_the_covariance_says_it() {
    // (frequency, phases): few phases, a signal of few codes at many phases, both.
    for (freq_hz, phases, amplitude) in [
        (125.0, Some(8), 700.3),
        (200.0, Some(5), 3.7),
        (17.3, None, 0.8),
        (17.3, None, 2.4),
    ] {
        let mut worst: f64 = 0.0;
        for step in 0..40 {
            let (offset, extra) = (f64::from(step) * 0.137, f64::from(step) * 0.0731);
            let truth = amplitude + extra;
            let codes = codes(4000, 0.0, 1, |t| {
                truth * (TAU * freq_hz * t + 0.1).cos() + offset
            });
            let channels = [Channel::codes(&codes, ADC)];
            let fit = fit_known_frequency(
                &Record {
                    channels: &channels,
                    interval_s: INTERVAL_S,
                },
                freq_hz,
                &options(Drift::None, &[]),
            )
            .unwrap();
            let (_, found, bound) =
                quantisation(&fit).unwrap_or_else(|| panic!("{freq_hz} Hz, {truth}: {fit:?}"));
            assert_eq!(found, phases);
            let error = (fit.channels[0].phasor - Complex64::from_polar(truth, 0.1)).norm();
            let stated = fit.channels[0].variance;
            assert!(
                stated.re_re.sqrt() >= bound * 0.999 && stated.im_im.sqrt() >= bound * 0.999,
                "{stated:?} below {bound}"
            );
            assert!(
                error <= 1.2 * bound,
                "{freq_hz} Hz, amplitude {truth}, offset {offset}: {error} beyond {bound}"
            );
            worst = worst.max(error / bound);
        }
        assert!(
            worst > 0.2,
            "a bound that is never approached says nothing: {freq_hz} Hz, {amplitude}: {worst}"
        );
    }
}

#[test]
fn enough_noise_or_enough_codes_and_phases_need_no_warning() {
    for (freq_hz, amplitude, noise_lsb) in
        [(125.0, 700.3, 0.5), (17.3, 0.8, 0.6), (17.317, 900.4, 0.3)]
    {
        let codes = codes(4000, noise_lsb, 5, |t| {
            amplitude * (TAU * freq_hz * t + 0.1).cos()
        });
        let channels = [Channel::codes(&codes, ADC)];
        let fit = fit_known_frequency(
            &Record {
                channels: &channels,
                interval_s: INTERVAL_S,
            },
            freq_hz,
            &FitOptions::default(),
        )
        .unwrap();
        assert_eq!(
            quantisation(&fit),
            None,
            "{freq_hz} {amplitude} {noise_lsb}"
        );
    }
}

#[test]
fn the_warning_is_in_words() {
    let codes: Vec<i16> = [0, 1000, 0, -1000]
        .iter()
        .copied()
        .cycle()
        .take(4000)
        .collect();
    let channels = [Channel::codes(
        &codes,
        CodeScale {
            volts_per_code: 1e-3,
            ..ADC
        },
    )];
    let fit = fit_known_frequency(
        &Record {
            channels: &channels,
            interval_s: INTERVAL_S,
        },
        250.0,
        &options(Drift::None, &[]),
    )
    .unwrap();
    // Four phases, each rounded by up to half a code: both parts may be wrong by half a code.
    let (noise_lsb, phases, bound_v) = quantisation(&fit).unwrap();
    let worst_v = 0.5f64.sqrt() * 1e-3;
    assert!(
        noise_lsb == 0.0 && phases == Some(4),
        "{noise_lsb} {phases:?}"
    );
    assert!(
        (0.93 * worst_v..1.0001 * worst_v).contains(&bound_v),
        "{bound_v} against {worst_v}"
    );
    assert_eq!(
        fit.notes[0].to_string(),
        "channel 1: 0.00 LSB of noise are too few to average the quantisation out, for the samples \
        come back to 4 phases; \
         the phasor may be 0.07 % wrong, which its uncertainty includes"
    );
}

#[test]
fn codes_in_the_upper_bits_are_the_same_codes() {
    let plain: Vec<i16> = [0, 1000, 0, -1000]
        .iter()
        .copied()
        .cycle()
        .take(4000)
        .collect();
    let upper: Vec<i16> = plain.iter().map(|code| 16 * code).collect();
    let wide = CodeScale {
        volts_per_code: ADC.volts_per_code / 16.0,
        code_min: i16::MIN,
        code_max: 16 * 2047,
        code_step: 16,
        ..ADC
    };
    let fit = |codes: &[i16], scale| {
        let channels = [Channel::codes(codes, scale)];
        fit_known_frequency(
            &Record {
                channels: &channels,
                interval_s: INTERVAL_S,
            },
            250.0,
            &options(Drift::None, &[]),
        )
        .unwrap()
    };
    let (narrow, justified) = (fit(&plain, ADC), fit(&upper, wide));
    assert_eq!(justified.notes.len(), 1);
    assert_eq!(justified.notes[0].to_string(), narrow.notes[0].to_string());
    let (a, b) = (justified.channels[0].variance, narrow.channels[0].variance);
    assert!(
        (a.re_re / b.re_re - 1.0).abs() < 1e-3 && (a.im_im / b.im_im - 1.0).abs() < 1e-3,
        "{a:?} against {b:?}"
    );
}
