//! Laws and statistics of the sinusoid fit.

use std::f64::consts::TAU;

use analysis::sine::{
    Channel, CodeScale, Drift, FitOptions, Record, SineFit, Varying, fit_free_frequency,
    fit_known_frequency,
};
use num_complex::Complex64;
use proptest::prelude::*;

use crate::noise::Noise;

const PLAIN: FitOptions = with_drift(Drift::None);
const DRIFT: FitOptions = with_drift(Drift::Linear);

const fn with_drift(drift: Drift) -> FitOptions {
    FitOptions {
        drift,
        harmonics: Vec::new(),
        also_hz: Vec::new(),
        decays_s: Vec::new(),
        varying: Varying::None,
        exclude_clipped: true,
    }
}

/// A sinusoid as a bench sees it: phase in turns, so that long records lose no digits in the signal
/// itself.
#[derive(Debug, Clone, Copy)]
struct Wave {
    amplitude_v: f64,
    phase_rad: f64,
    offset_v: f64,
    drift_v_per_s: f64,
}

impl Wave {
    fn samples(&self, freq_hz: f64, interval_s: f64, count: usize) -> Vec<f64> {
        let middle_s = 0.5 * (count as f64 - 1.0) * interval_s;
        let at = |n: usize| {
            let t = n as f64 * interval_s;
            let turns = (freq_hz * t).fract();
            self.amplitude_v * (TAU * turns + self.phase_rad).cos()
                + self.offset_v
                + self.drift_v_per_s * (t - middle_s)
        };
        (0..count).map(at).collect()
    }

    fn phasor(&self) -> Complex64 {
        Complex64::from_polar(self.amplitude_v, self.phase_rad)
    }
}

fn known(samples: &[f64], interval_s: f64, freq_hz: f64, options: &FitOptions) -> SineFit {
    let channels = [Channel::volts(samples)];
    fit_known_frequency(
        &Record {
            channels: &channels,
            interval_s,
        },
        freq_hz,
        options,
    )
    .unwrap()
}

fn relative(found: Complex64, truth: Complex64) -> f64 {
    (found - truth).norm() / truth.norm()
}

prop_compose! {
    fn any_wave()(
        amplitude_v in 1e-4..20.0f64,
        phase_rad in -3.1..3.1f64,
        offset in -10.0..10.0f64,
        drift in -1.0..1.0f64,
    ) -> (Wave, f64) {
        let wave = Wave {
            amplitude_v,
            phase_rad,
            offset_v: offset * amplitude_v,
            drift_v_per_s: 0.0,
        };
        (wave, drift * amplitude_v)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn noiseless_sinusoids_come_back_exactly(
        (wave, drift_v) in any_wave(),
        periods in 1.5..60.0f64,
        per_period in 2.3..300.0f64,
        freq_hz in 0.01..1e4f64,
    ) {
        let count = ((periods * per_period).ceil() as usize).max(24);
        prop_assume!(periods / (count as f64) < 0.44);
        let interval_s = periods / freq_hz / count as f64;
        let wave = Wave { drift_v_per_s: drift_v * freq_hz / periods, ..wave };
        let samples = wave.samples(freq_hz, interval_s, count);
        let known_fit = known(&samples, interval_s, freq_hz, &DRIFT);
        let fit = known_fit.channels[0];
        prop_assert!(relative(fit.phasor, wave.phasor()) < 1e-9, "{fit:?}");
        prop_assert!((fit.offset_v - wave.offset_v).abs() < 1e-9 * wave.amplitude_v, "{fit:?}");
        prop_assert!((fit.drift_v_per_s - wave.drift_v_per_s).abs() < 1e-8 * wave.amplitude_v * freq_hz, "{fit:?}");
        prop_assert_eq!((fit.samples_used, fit.clipped_samples), (count, 0));
        prop_assert!((known_fit.periods() - periods).abs() < 1e-9 * periods);
    }

    #[test]
    fn an_unknown_frequency_comes_back_with_the_phasors(
        (wave, drift_v) in any_wave(),
        (second, _) in any_wave(),
        periods in 1.6..60.0f64,
        per_period in 5.0..100.0f64,
    ) {
        let freq_hz = 7.3;
        let count = ((periods * per_period).ceil() as usize).max(40);
        let interval_s = periods / freq_hz / count as f64;
        let wave = Wave { drift_v_per_s: 0.3 * drift_v * freq_hz / periods, ..wave };
        let (a, b) = (wave.samples(freq_hz, interval_s, count), second.samples(freq_hz, interval_s, count));
        let channels = [Channel::volts(&a), Channel::volts(&b)];
        let record = Record { channels: &channels, interval_s };
        for guess in [None, Some(freq_hz * (1.0 + 0.3 / periods))] {
            let fit = fit_free_frequency(&record, guess, &DRIFT).unwrap();
            prop_assert!((fit.freq_hz / freq_hz - 1.0).abs() < 1e-9, "{} {guess:?}", fit.freq_hz);
            prop_assert!(relative(fit.channels[0].phasor, wave.phasor()) < 1e-8, "{fit:?}");
            prop_assert!(relative(fit.channels[1].phasor, second.phasor()) < 1e-8, "{fit:?}");
        }
    }
}

#[test]
fn ten_million_samples_keep_twelve_digits() {
    // Whole periods of a short pattern, repeated, and powers of two: the signal itself is then
    // exact to the last digit at any length.
    let (pattern, count, interval_s) = (1024usize, 10_000_000usize, 2f64.powi(-20));
    let wave = Wave {
        amplitude_v: 0.3,
        phase_rad: 0.7,
        offset_v: 2.0,
        drift_v_per_s: 0.0,
    };
    let freq_hz = 1.0 / (pattern as f64 * interval_s);
    let one: Vec<f64> = (0..pattern)
        .map(|n| 0.3 * (TAU * n as f64 / pattern as f64 + 0.7).cos() + 2.0)
        .collect();
    let samples: Vec<f64> = one.iter().copied().cycle().take(count).collect();
    let fit = known(&samples, interval_s, freq_hz, &DRIFT);
    assert!(
        relative(fit.channels[0].phasor, wave.phasor()) < 1e-12,
        "{}",
        relative(fit.channels[0].phasor, wave.phasor())
    );
    assert!((fit.channels[0].offset_v - 2.0).abs() < 1e-12);
}

#[test]
fn the_phase_counts_from_sample_zero() {
    let wave = Wave {
        amplitude_v: 1.0,
        phase_rad: 0.0,
        offset_v: 0.0,
        drift_v_per_s: 0.0,
    };
    let fit = known(&wave.samples(10.0, 1e-3, 1234), 1e-3, 10.0, &PLAIN);
    assert!((fit.channels[0].phasor - Complex64::new(1.0, 0.0)).norm() < 1e-12);
    let late = known(&wave.samples(10.0, 1e-3, 1234)[25..], 1e-3, 10.0, &PLAIN);
    assert!(
        (late.channels[0].phasor - Complex64::new(0.0, 1.0)).norm() < 1e-12,
        "a quarter of a period later, cos is −sin: p = j"
    );
}

/// Errors of the phasor over seeds, and the mean of the variances that the fits state.
fn scatter(seeds: u64, count: usize, periods: f64, sigma_v: f64, free: bool) -> (f64, f64, usize) {
    let (interval_s, freq_hz) = (1e-3, periods / (count as f64 * 1e-3));
    let wave = Wave {
        amplitude_v: 1.0,
        phase_rad: 0.4,
        offset_v: 0.2,
        drift_v_per_s: 0.0,
    };
    let clean = wave.samples(freq_hz, interval_s, count);
    let (mut squares, mut stated, mut covered) = (0.0, 0.0, 0);
    for seed in 0..seeds {
        let mut noise = Noise::new(seed + 1000);
        let samples: Vec<f64> = clean.iter().map(|v| v + sigma_v * noise.gauss()).collect();
        let fit = if free {
            let channels = [Channel::volts(&samples)];
            fit_free_frequency(
                &Record {
                    channels: &channels,
                    interval_s,
                },
                Some(freq_hz),
                &PLAIN,
            )
            .unwrap()
        } else {
            known(&samples, interval_s, freq_hz, &PLAIN)
        };
        let variance = fit.absolute_covariance(0).unwrap();
        let error = fit.channels[0].phasor - wave.phasor();
        squares += error.norm_sqr();
        stated += variance.re_re + variance.im_im;
        covered += usize::from(error.re.abs() < 2.0 * variance.re_re.sqrt())
            + usize::from(error.im.abs() < 2.0 * variance.im_im.sqrt());
    }
    (squares / seeds as f64, stated / seeds as f64, covered)
}

#[test]
fn the_scatter_is_the_cramer_rao_bound() {
    let (seeds, count, sigma_v) = (4000, 200, 0.05);
    let (measured, stated, covered) = scatter(seeds, count, 7.0, sigma_v, false);
    // Re and Im have the variance 2σ²/N each.
    let bound = 2.0 * 2.0 * sigma_v * sigma_v / count as f64;
    assert!(
        (measured / bound - 1.0).abs() < 0.05,
        "measured over bound: {}",
        measured / bound
    );
    assert!(
        (stated / bound - 1.0).abs() < 0.02,
        "stated over bound: {}",
        stated / bound
    );
    let share = covered as f64 / (2 * seeds) as f64;
    assert!((0.945..0.965).contains(&share), "2σ covers {share}");
}

#[test]
fn where_samples_are_missing_the_stated_covariance_has_the_shape_of_the_scatter() {
    // All crests are clipped: the parts of the phasor are determined with unequal accuracy, and are
    // correlated.
    let (interval_s, count, sigma_v, seeds) = (1e-3, 240, 0.05, 6000);
    let freq_hz = 3.3 / (count as f64 * interval_s);
    let wave = Wave {
        amplitude_v: 1.0,
        phase_rad: 0.4,
        offset_v: 0.2,
        drift_v_per_s: 0.5,
    };
    let clean = wave.samples(freq_hz, interval_s, count);
    let (mut sums, mut stated) = ([0.0; 3], [0.0; 3]);
    for seed in 0..seeds {
        let mut noise = Noise::new(seed);
        // Chosen by the signal alone, so that the noise of those that stay is not cut.
        let sample = |v: &f64| {
            if *v > 0.4 {
                9.0
            } else {
                v + sigma_v * noise.gauss()
            }
        };
        let samples: Vec<f64> = clean.iter().map(sample).collect();
        let channels = [Channel::Volts {
            samples: &samples,
            lsb_v: None,
            range_v: Some((-9.0, 9.0)),
        }];
        let fit = fit_known_frequency(
            &Record {
                channels: &channels,
                interval_s,
            },
            freq_hz,
            &DRIFT,
        )
        .unwrap()
        .channels[0];
        let error = fit.phasor - wave.phasor();
        for (sum, product) in sums.iter_mut().zip([
            error.re * error.re,
            error.re * error.im,
            error.im * error.im,
        ]) {
            *sum += product / seeds as f64;
        }
        for (sum, element) in
            stated
                .iter_mut()
                .zip([fit.variance.re_re, fit.variance.re_im, fit.variance.im_im])
        {
            *sum += element / seeds as f64;
        }
    }
    let [re, both, im] = stated;
    assert!(
        re / im > 2.0 && both / (re * im).sqrt() > 0.3,
        "unequal and together: {stated:?}"
    );
    assert!(
        (sums[0] / re - 1.0).abs() < 0.06 && (sums[2] / im - 1.0).abs() < 0.06,
        "{sums:?} {stated:?}"
    );
    assert!(
        (sums[1] - both).abs() < 0.06 * (re * im).sqrt(),
        "{sums:?} {stated:?}"
    );
}

#[test]
fn a_free_frequency_costs_what_the_bound_says() {
    // Phase at the start with unknown frequency: var φ = 2(2N−1)/(N(N+1)) · σ²/A² · 2 ≈ 4 times
    // that with a known one.
    let (seeds, count, sigma_v) = (2000, 200, 0.05);
    let (measured, stated, covered) = scatter(seeds, count, 7.0, sigma_v, true);
    let single = 2.0 * sigma_v * sigma_v / count as f64;
    let bound = single + 4.0 * single;
    assert!(
        (measured / bound - 1.0).abs() < 0.07,
        "measured over bound: {}",
        measured / bound
    );
    assert!(
        (stated / bound - 1.0).abs() < 0.04,
        "stated over bound: {}",
        stated / bound
    );
    let share = covered as f64 / (2 * seeds) as f64;
    assert!((0.94..0.97).contains(&share), "2σ covers {share}");
}

#[test]
fn a_common_frequency_is_weighed_by_the_noise_of_the_channels() {
    // A quiet and a loud channel: the frequency must be as good as from the quiet one alone.
    let (interval_s, freq_hz, count) = (1e-3, 11.0, 1000);
    let wave = Wave {
        amplitude_v: 1.0,
        phase_rad: 0.4,
        offset_v: 0.2,
        drift_v_per_s: 0.0,
    };
    let clean = wave.samples(freq_hz, interval_s, count);
    let (mut squares, mut stated) = (0.0, 0.0);
    let seeds = 300;
    for seed in 0..seeds {
        let mut noise = Noise::new(seed);
        let quiet: Vec<f64> = clean.iter().map(|v| v + 0.01 * noise.gauss()).collect();
        let loud: Vec<f64> = clean.iter().map(|v| v + 1.0 * noise.gauss()).collect();
        let channels = [Channel::volts(&loud), Channel::volts(&quiet)];
        let fit = fit_free_frequency(
            &Record {
                channels: &channels,
                interval_s,
            },
            None,
            &PLAIN,
        )
        .unwrap();
        squares += (fit.freq_hz - freq_hz).powi(2);
        stated += fit.freq_sigma_hz.unwrap().powi(2);
    }
    // var ω = 24σ²/(A²·T²·N), the bound for one channel.
    let bound = 24.0 * 1e-4 / (count as f64) / (TAU * count as f64 * interval_s).powi(2);
    assert!(
        (squares / seeds as f64 / bound - 1.0).abs() < 0.25,
        "{}",
        squares / seeds as f64 / bound
    );
    assert!(
        (stated / seeds as f64 / bound - 1.0).abs() < 0.05,
        "{}",
        stated / seeds as f64 / bound
    );
}

/// Error of a quotient of two channels of which one drifts by 1 % of its amplitude over the record,
/// over all phases.
fn drift_bias(periods: f64, options: &FitOptions) -> f64 {
    let (freq_hz, count) = (1.0, 2000);
    let interval_s = periods / freq_hz / count as f64;
    let bias = |step: i32| {
        let phase_rad = TAU * f64::from(step) / 24.0;
        let current = Wave {
            amplitude_v: 1.0,
            phase_rad,
            offset_v: 0.1,
            drift_v_per_s: 0.0,
        };
        let drift_v_per_s = 0.01 * 0.5 / periods * freq_hz;
        let voltage = Wave {
            amplitude_v: 0.5,
            phase_rad: phase_rad - 0.3,
            offset_v: 3.8,
            drift_v_per_s,
        };
        let (i, u) = (
            current.samples(freq_hz, interval_s, count),
            voltage.samples(freq_hz, interval_s, count),
        );
        let channels = [Channel::volts(&i), Channel::volts(&u)];
        let fit = fit_known_frequency(
            &Record {
                channels: &channels,
                interval_s,
            },
            freq_hz,
            options,
        )
        .unwrap();
        relative(
            fit.channels[1].phasor / fit.channels[0].phasor,
            voltage.phasor() / current.phasor(),
        )
    };
    (0..24).map(bias).fold(0.0, f64::max)
}

#[test]
fn drift_biases_a_fit_that_does_not_know_it() {
    // A ramp of 1 % over k whole periods projects 0.01/(πk) on the sine.
    for periods in [2.0, 5.0] {
        let expected = 0.01 / (std::f64::consts::PI * periods);
        let without = drift_bias(periods, &PLAIN);
        assert!(
            (without / expected - 1.0).abs() < 0.02,
            "{periods} periods: {without} against {expected}"
        );
        assert!(drift_bias(periods, &DRIFT) < 1e-11);
    }
}

fn codes(volts: &[f64], scale: &CodeScale) -> Vec<i16> {
    let code = |v: &f64| {
        let code = ((v + scale.offset_v) / scale.volts_per_code).round();
        code.clamp(f64::from(scale.code_min), f64::from(scale.code_max)) as i16
    };
    volts.iter().map(code).collect()
}

#[test]
fn codes_give_what_their_volts_give() {
    let scale = CodeScale {
        volts_per_code: 1e-3,
        offset_v: -3.7,
        code_min: -2048,
        code_max: 2047,
        code_step: 1,
    };
    let wave = Wave {
        amplitude_v: 0.5,
        phase_rad: 1.0,
        offset_v: 3.8,
        drift_v_per_s: 0.01,
    };
    let mut noise = Noise::new(5);
    let volts: Vec<f64> = wave
        .samples(9.7, 1e-3, 3000)
        .iter()
        .map(|v| v + 2e-3 * noise.gauss())
        .collect();
    let codes = codes(&volts, &scale);
    let back: Vec<f64> = codes.iter().map(|code| scale.volts(*code)).collect();
    let channels = [
        Channel::codes(&codes, scale),
        Channel::Volts {
            samples: &back,
            lsb_v: Some(1e-3),
            range_v: None,
        },
    ];
    let fit = fit_known_frequency(
        &Record {
            channels: &channels,
            interval_s: 1e-3,
        },
        9.7,
        &DRIFT,
    )
    .unwrap();
    let [a, b] = [fit.channels[0], fit.channels[1]];
    assert!(relative(a.phasor, b.phasor) < 1e-12);
    assert!(
        (a.offset_v - b.offset_v).abs() < 1e-12
            && (a.drift_v_per_s - b.drift_v_per_s).abs() < 1e-12
    );
    // The residual of codes comes from sums over columns in fixed point, that of volts from the
    // differences themselves.
    assert!(
        (a.variance.re_re / b.variance.re_re - 1.0).abs() < 1e-7
            && (a.residual_rms_v / b.residual_rms_v - 1.0).abs() < 1e-7
    );
    assert!((a.phasor - wave.phasor()).norm() < 4.0 * (a.variance.re_re + a.variance.im_im).sqrt());
    assert!(
        (a.residual_rms_v - (4e-6f64 + 1e-6 / 12.0).sqrt()).abs() < 1e-4,
        "{}",
        a.residual_rms_v
    );
}

#[test]
fn clipped_samples_are_left_out_and_counted() {
    let scale = CodeScale {
        volts_per_code: 1e-3,
        offset_v: 0.0,
        code_min: -2048,
        code_max: 2047,
        code_step: 1,
    };
    let wave = Wave {
        amplitude_v: 2.3,
        phase_rad: 1.0,
        offset_v: 0.0,
        drift_v_per_s: 0.0,
    };
    let codes = codes(&wave.samples(9.7, 1e-3, 3000), &scale);
    let clipped = codes
        .iter()
        .filter(|code| **code == -2048 || **code == 2047)
        .count();
    assert!(clipped > 500);
    let channels = [Channel::codes(&codes, scale)];
    let record = Record {
        channels: &channels,
        interval_s: 1e-3,
    };
    let fit = fit_known_frequency(&record, 9.7, &DRIFT).unwrap();
    assert_eq!(
        (
            fit.channels[0].clipped_samples,
            fit.channels[0].samples_used
        ),
        (clipped, 3000 - clipped)
    );
    assert!(
        relative(fit.channels[0].phasor, wave.phasor()) < 1e-4,
        "{}",
        relative(fit.channels[0].phasor, wave.phasor())
    );
    let kept = fit_known_frequency(
        &record,
        9.7,
        &FitOptions {
            exclude_clipped: false,
            ..DRIFT
        },
    )
    .unwrap();
    assert_eq!(
        (
            kept.channels[0].clipped_samples,
            kept.channels[0].samples_used
        ),
        (clipped, 3000)
    );
    assert!(
        relative(kept.channels[0].phasor, wave.phasor()) > 0.01,
        "a clipped crest lowers the amplitude"
    );
    let free = fit_free_frequency(&record, None, &DRIFT).unwrap();
    assert!((free.freq_hz / 9.7 - 1.0).abs() < 1e-6 && free.channels[0].clipped_samples == clipped);
}

#[test]
fn coloured_noise_raises_the_stated_variance_as_it_raises_the_scatter() {
    let (interval_s, freq_hz, count, rho) = (1e-3, 5.0, 2000, 0.8);
    let wave = Wave {
        amplitude_v: 1.0,
        phase_rad: 0.4,
        offset_v: 0.0,
        drift_v_per_s: 0.0,
    };
    let clean = wave.samples(freq_hz, interval_s, count);
    let (mut squares, mut stated, mut white) = (0.0, 0.0, 0.0);
    for seed in 0..400 {
        let mut noise = Noise::new(seed + 77);
        let mut state = 0.0;
        let mut next = || {
            state = rho * state + 0.01 * noise.gauss();
            state
        };
        let samples: Vec<f64> = clean.iter().map(|v| v + next()).collect();
        let fit = known(&samples, interval_s, freq_hz, &PLAIN).channels[0];
        squares += (fit.phasor - wave.phasor()).norm_sqr();
        stated += fit.variance.re_re + fit.variance.im_im;
        white += (fit.variance.re_re + fit.variance.im_im) / fit.colour_factor;
        assert!(
            (fit.residual_lag1 - rho).abs() < 0.1,
            "{}",
            fit.residual_lag1
        );
    }
    assert!(
        (stated / squares - 1.0).abs() < 0.15,
        "stated over measured: {}",
        stated / squares
    );
    assert!(white / squares < 0.2, "as if white: {}", white / squares);
}
