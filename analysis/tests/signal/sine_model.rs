//! The sinusoid fit against a plain least-squares fit, and its additional terms beside the
//! sinusoid.

use std::f64::consts::TAU;

use analysis::sine::{
    Channel, CodeScale, Drift, FitOptions, Note, Record, SineFit, ToneKind, Varying,
    fit_free_frequency, fit_known_frequency,
};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use crate::noise::Noise;

const ADC: CodeScale = CodeScale {
    volts_per_code: 1.0,
    offset_v: 0.0,
    code_min: -2048,
    code_max: 2047,
    code_step: 1,
};
const INTERVAL_S: f64 = 1e-3;

/// Codes of a function of time with Gaussian noise, in volts of one per code.
pub(crate) fn codes(
    count: usize,
    noise_lsb: f64,
    seed: u64,
    volts: impl Fn(f64) -> f64,
) -> Vec<i16> {
    let mut noise = Noise::new(seed);
    let one = |n: usize| {
        (volts(n as f64 * INTERVAL_S) + noise_lsb * noise.gauss())
            .round()
            .clamp(-32768.0, 32767.0) as i16
    };
    (0..count).map(one).collect()
}

/// Plain least squares by QR on columns made sample by sample: returns coefficients, rms and lag-1
/// correlation of the residual.
fn plain(samples: &[Option<f64>], freqs_hz: &[f64], degree: i32) -> (DVector<f64>, f64, f64) {
    let middle_s = 0.5 * (samples.len() as f64 - 1.0) * INTERVAL_S;
    let rows: Vec<usize> = (0..samples.len())
        .filter(|n| samples[*n].is_some())
        .collect();
    let columns = 2 * freqs_hz.len() + degree as usize + 1;
    let matrix = DMatrix::from_fn(rows.len(), columns, |row, column| {
        let t = rows[row] as f64 * INTERVAL_S;
        match freqs_hz.get(column / 2) {
            Some(freq_hz) if column % 2 == 0 => (TAU * (freq_hz * t).fract()).cos(),
            Some(freq_hz) => -(TAU * (freq_hz * t).fract()).sin(),
            None => ((t - middle_s) / middle_s).powi(column as i32 - 2 * freqs_hz.len() as i32),
        }
    });
    let values = DVector::from_iterator(rows.len(), rows.iter().map(|n| samples[*n].unwrap()));
    let qr = matrix.clone().qr();
    let beta = qr
        .r()
        .solve_upper_triangular(&(qr.q().transpose() * &values))
        .unwrap();
    let left = values - matrix * &beta;
    let neighbours = rows
        .windows(2)
        .enumerate()
        .filter(|(_, pair)| pair[1] == pair[0] + 1);
    let lagged: f64 = neighbours.map(|(k, _)| left[k] * left[k + 1]).sum();
    let squares = left.norm_squared();
    (beta, (squares / rows.len() as f64).sqrt(), lagged / squares)
}

fn fit(codes: &[i16], scale: CodeScale, freq_hz: f64, options: &FitOptions) -> SineFit {
    let channels = [Channel::codes(codes, scale)];
    fit_known_frequency(
        &Record {
            channels: &channels,
            interval_s: INTERVAL_S,
        },
        freq_hz,
        options,
    )
    .unwrap()
}

fn with(drift: Drift, harmonics: &[u32], also_hz: &[f64]) -> FitOptions {
    FitOptions {
        drift,
        harmonics: harmonics.to_vec(),
        also_hz: also_hz.to_vec(),
        decays_s: Vec::new(),
        varying: Varying::None,
        exclude_clipped: true,
    }
}

/// Returns a strong sinusoid with everything that may come with it.
fn rich(amplitude: f64, offset: f64) -> impl Fn(f64) -> f64 {
    move |t| {
        let harmonic = 0.02 * amplitude * (TAU * 2.0 * 7.3 * t + 1.0).cos();
        amplitude * (TAU * 7.3 * t + 0.4).cos()
            + harmonic
            + 0.03 * amplitude * (TAU * 50.0 * t).sin()
            + offset
            + 0.5 * t
            - 0.1 * t * t
    }
}

#[test]
fn every_kernel_agrees_with_plain_least_squares() {
    let wide = CodeScale {
        code_min: i16::MIN,
        code_max: i16::MAX,
        ..ADC
    };
    // Within the range; clipped at the crests; a small signal far from the middle; more codes than
    // the integer kernel takes.
    let cases = [
        (1500.0, 100.0, ADC),
        (2300.0, 300.0, ADC),
        (6.0, -1900.0, ADC),
        (25_000.0, 3000.0, wide),
    ];
    for (amplitude, offset, scale) in cases {
        for (count, drift, harmonics, also) in [
            (5000, Drift::Linear, &[][..], &[][..]),
            (1537, Drift::None, &[2], &[]),
            (3585, Drift::Quadratic, &[2, 3], &[50.0]),
        ] {
            let bounds = (scale.code_min, scale.code_max);
            let codes: Vec<i16> = codes(count, 0.6, 3, rich(amplitude, offset))
                .into_iter()
                .map(|code| code.clamp(bounds.0, bounds.1))
                .collect();
            let inside =
                |code: &i16| (*code > bounds.0 && *code < bounds.1).then(|| f64::from(*code));
            let samples: Vec<Option<f64>> = codes.iter().map(inside).collect();
            let freqs: Vec<f64> = [7.3]
                .into_iter()
                .chain(harmonics.iter().map(|order| 7.3 * f64::from(*order)))
                .chain(also.iter().copied())
                .collect();
            let degree = [Drift::None, Drift::Linear, Drift::Quadratic]
                .iter()
                .position(|d| *d == drift)
                .unwrap() as i32;
            let (beta, rms, lag1) = plain(&samples, &freqs, degree);
            let found = fit(&codes, scale, 7.3, &with(drift, harmonics, also));
            let (channel, what) = (&found.channels[0], format!("{amplitude} {offset} {count}"));
            let phasors = std::iter::once(channel.phasor)
                .chain(found.tones.iter().map(|tone| tone.channels[0].phasor));
            for (tone, phasor) in phasors.enumerate() {
                let error = (phasor - Complex64::new(beta[2 * tone], beta[2 * tone + 1])).norm();
                assert!(
                    error < 1e-9 * amplitude,
                    "{what}: tone {tone} is off by {error}"
                );
            }
            let middle_s = 0.5 * (count as f64 - 1.0) * INTERVAL_S;
            let power = |k: usize| {
                if k as i32 <= degree {
                    beta[2 * freqs.len() + k] / middle_s.powi(k as i32)
                } else {
                    0.0
                }
            };
            assert!(
                (channel.offset_v - power(0)).abs() < 1e-9 * amplitude.max(offset.abs()),
                "{what}: {}",
                channel.offset_v
            );
            assert!(
                (channel.drift_v_per_s - power(1)).abs() < 1e-8 * amplitude,
                "{what}: {}",
                channel.drift_v_per_s
            );
            assert!(
                (channel.curvature_v_per_s2 - power(2)).abs() < 1e-8 * amplitude,
                "{what}: {}",
                channel.curvature_v_per_s2
            );
            assert!(
                (channel.residual_rms_v / rms - 1.0).abs() < 1e-6,
                "{what}: {} against {rms}",
                channel.residual_rms_v
            );
            assert!(
                (channel.residual_lag1 - lag1).abs() < 1e-6,
                "{what}: {} against {lag1}",
                channel.residual_lag1
            );
            assert_eq!(
                channel.clipped_samples,
                samples.iter().filter(|sample| sample.is_none()).count(),
                "{what}"
            );
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let codes = codes(200_001, 0.7, 9, rich(1200.0, -50.0));
    let in_pool = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let channels = [Channel::codes(&codes, ADC), Channel::codes(&codes[..], ADC)];
        let record = Record {
            channels: &channels,
            interval_s: INTERVAL_S,
        };
        pool.install(|| {
            fit_free_frequency(&record, Some(7.3), &with(Drift::Linear, &[2], &[50.0])).unwrap()
        })
    };
    assert_eq!(in_pool(1), in_pool(3));
}

#[test]
fn mains_that_is_not_modelled_biases_and_modelled_does_not() {
    // 48 Hz beside 50 Hz over two thirds of a second: near enough to leak, far enough to be
    // separated.
    let signal = |t: f64| 500.0 * (TAU * 48.0 * t).cos() + 20.0 * (TAU * 50.0 * t + 2.0).cos();
    let codes = codes(667, 0.6, 4, signal);
    let bias =
        |options: &FitOptions| (fit(&codes, ADC, 48.0, options).channels[0].phasor - 500.0).norm();
    let without = bias(&FitOptions::default());
    let mains = FitOptions::default().with_mains(50.0, 3);
    assert!(
        without > 2.0 && bias(&mains) < 0.2,
        "{without} {}",
        bias(&mains)
    );
    let tones = fit(&codes, ADC, 48.0, &mains).tones;
    let truth = Complex64::from_polar(20.0, 2.0);
    assert!(
        (tones[0].channels[0].phasor - truth).norm() < 0.2,
        "{:?}",
        tones[0]
    );
    assert_eq!(
        tones.iter().map(|tone| tone.freq_hz).collect::<Vec<_>>(),
        [50.0, 100.0, 150.0]
    );
}

#[test]
fn distortion_is_that_of_the_signal_and_its_sigma_that_of_the_noise() {
    let signal = |t: f64| {
        let theta = TAU * 9.1 * t + 0.3;
        1000.0 * theta.cos() + 30.0 * (2.0 * theta).cos() + 40.0 * (3.0 * theta + 1.0).sin()
    };
    let options = with(Drift::Linear, &[2, 3], &[]);
    let found = fit(&codes(4000, 2.0, 8, signal), ADC, 9.1, &options)
        .distortion(0)
        .unwrap();
    // Four parts, each of variance 2σ²/N.
    let sigma = (4.0 * 2.0 * (4.0 + 1.0 / 12.0) / 4000.0f64).sqrt() / 1000.0;
    assert!((found.thd - 0.05).abs() < 4.0 * sigma, "{found:?}");
    assert!(
        (found.sigma / sigma - 1.0).abs() < 0.05,
        "{found:?} against {sigma}"
    );
    let pure = fit(
        &codes(4000, 2.0, 8, |t| 1000.0 * (TAU * 9.1 * t).cos()),
        ADC,
        9.1,
        &options,
    )
    .distortion(0)
    .unwrap();
    assert!(pure.thd < 3.0 * sigma, "{pure:?}");
    assert_eq!(
        fit(
            &codes(4000, 2.0, 8, signal),
            ADC,
            9.1,
            &FitOptions::default()
        )
        .distortion(0),
        None
    );
}

#[test]
fn what_the_record_cannot_tell_apart_is_left_out_and_said() {
    let codes = codes(1000, 0.6, 1, |t| 800.0 * (TAU * 100.0 * t).cos());
    let options = with(
        Drift::Linear,
        &[2, 5, 2, 0],
        &[100.4, 0.5, 200.0, 150.0, f64::NAN],
    );
    let found = fit(&codes, ADC, 100.0, &options);
    let fitted: Vec<(ToneKind, f64)> = found
        .tones
        .iter()
        .map(|tone| (tone.kind, tone.freq_hz))
        .collect();
    assert_eq!(
        fitted,
        [(ToneKind::Harmonic(2), 200.0), (ToneKind::Other, 150.0)]
    );
    let messages: Vec<String> = found.notes.iter().map(Note::to_string).collect();
    assert_eq!(
        messages,
        [
            "harmonic 5 (500.000000 Hz) is not fitted: half the sampling rate is 500.000000 Hz",
            "harmonic 2 (200.000000 Hz) is not fitted: the record cannot separate it from \
            200.000000 Hz, it resolves 1.000000 Hz",
            "harmonic 0 (0.000000 Hz) is not fitted: expected a frequency above 0 Hz",
            "100.400000 Hz is not fitted: the record cannot separate it from 100.000000 Hz, it \
            resolves 1.000000 Hz",
            "0.500000 Hz is not fitted: one period takes longer than the record (1.000000 Hz)",
            "200.000000 Hz is not fitted: the record cannot separate it from 200.000000 Hz, it \
            resolves 1.000000 Hz",
            "NaN Hz is not fitted: expected a frequency above 0 Hz",
        ]
    );
}

#[test]
fn gaps_that_hide_the_extras_drop_them_and_not_the_fit() {
    // Only 17 of 2000 samples are left: enough for the sinusoid and a line, not for eight harmonics
    // and a parabola.
    let signal = |t: f64| 800.0 * (TAU * 3.0 * t).cos();
    let kept = |n: usize| n % 120 == 7;
    let codes: Vec<i16> = codes(2000, 0.6, 1, signal)
        .iter()
        .enumerate()
        .map(|(n, code)| if kept(n) { *code } else { 2047 })
        .collect();
    let found = fit(
        &codes,
        ADC,
        3.0,
        &with(Drift::Quadratic, &[2, 3, 4, 5, 6, 7, 8], &[]),
    );
    assert!(
        (found.channels[0].phasor - 800.0).norm() < 3.0,
        "{:?}",
        found.channels[0]
    );
    let messages: Vec<String> = found.notes.iter().map(Note::to_string).collect();
    assert!(
        found.tones.is_empty() && messages.len() == 8,
        "{messages:?}"
    );
    assert_eq!(
        messages[0],
        "the drift is fitted as a straight line: the usable samples of channel 1 do not determine \
        a parabola"
    );
    assert_eq!(
        messages[1],
        "harmonic 2 (6.000000 Hz) is not fitted: the usable samples of channel 1 do not determine \
        it"
    );
    let short = fit(
        &codes[..600],
        CodeScale {
            code_max: i16::MAX,
            ..ADC
        },
        3.0,
        &with(Drift::Quadratic, &[], &[]),
    );
    assert_eq!(
        short.notes[0].to_string(),
        "the drift is fitted as a straight line: a parabola needs 2 periods, the record has 1.80"
    );
}
