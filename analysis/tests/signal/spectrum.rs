//! Phasors to impedance, and the checks of a spectrum.

use analysis::{
    numeric::Covariance2,
    sine::{Channel, FitOptions, Record, fit_known_frequency},
    spectrum::{ChannelPhasors, ImpedancePoint, PhasorVariance, Spectrum, raw_impedance},
};
use num_complex::Complex64;
use proptest::prelude::*;

use crate::noise::Noise;

fn c(re: f64, im: f64) -> Complex64 {
    Complex64::new(re, im)
}

/// Loop of 1.2 A through 17 mΩ, the 10 mΩ shunt, 12 mΩ and a thing of (9 − 2j) mΩ.
fn phasors() -> ChannelPhasors {
    let i = Complex64::from_polar(1.2, 0.5);
    let volts = [i * 0.017, i * 0.027, i * 0.039, i * c(0.048, -0.002)];
    ChannelPhasors {
        freq_hz: 10.0,
        volts,
        variance: [1e-12, 2e-12, 9e-12, 4e-12].map(PhasorVariance::circular),
    }
}

#[test]
fn the_quotient_of_the_pairs_is_the_impedance() {
    let point = raw_impedance(&phasors(), 0.010);
    assert!((point.z_ohm - c(0.009, -0.002)).norm() < 1e-15);
    assert!((point.amplitude_a - 1.2).abs() < 1e-12);
    assert!(
        (point.magnitude_ohm() - 85e-6f64.sqrt()).abs() < 1e-12
            && (point.phase_rad() + (2.0f64 / 9.0).atan()).abs() < 1e-12
    );
}

#[test]
fn its_covariance_is_that_of_its_scatter() {
    let clean = phasors();
    let stated = raw_impedance(&clean, 0.010);
    let mut noise = Noise::new(3);
    let (mut sums, count) = ([0.0; 5], 20_000);
    for _ in 0..count {
        let mut noisy = clean;
        for (volts, variance) in noisy.volts.iter_mut().zip(clean.variance) {
            *volts += c(noise.gauss(), noise.gauss()) * variance.noise.re_re.sqrt();
        }
        let point = raw_impedance(&noisy, 0.010);
        let error = point.z_ohm - stated.z_ohm;
        sums[0] += error.re * error.re;
        sums[1] += error.re * error.im;
        sums[2] += error.im * error.im;
        sums[3] += (point.magnitude_ohm() - stated.magnitude_ohm()).powi(2);
        sums[4] += (point.phase_rad() - stated.phase_rad()).powi(2);
    }
    let mean = sums.map(|sum| sum / f64::from(count));
    assert!(
        (mean[0] / stated.covariance.re_re - 1.0).abs() < 0.03,
        "{mean:?} {stated:?}"
    );
    assert!(
        (mean[2] / stated.covariance.im_im - 1.0).abs() < 0.03,
        "{mean:?} {stated:?}"
    );
    assert!(
        (mean[1] - stated.covariance.re_im).abs() < 0.03 * stated.covariance.re_re,
        "{mean:?} {stated:?}"
    );
    assert!(
        (mean[3].sqrt() / stated.magnitude_sigma_ohm() - 1.0).abs() < 0.02,
        "{mean:?} {stated:?}"
    );
    assert!(
        (mean[4].sqrt() / stated.phase_sigma_rad() - 1.0).abs() < 0.02,
        "{mean:?} {stated:?}"
    );
}

#[test]
fn four_channels_make_phasors() {
    let (freq_hz, interval_s) = (5.0, 1e-3);
    let truth = phasors().volts;
    // A pattern of + − − + that nothing in the model resembles, of one step of the quantisation:
    // its variance is known, and it moves no phasor.
    let left = |n: i32| {
        if n % 4 == 0 || n % 4 == 3 {
            1e-5
        } else {
            -1e-5
        }
    };
    let wave = |p: Complex64| -> Vec<f64> {
        (0..2000)
            .map(|n| {
                (p * Complex64::cis(std::f64::consts::TAU * freq_hz * f64::from(n) * interval_s)).re
                    + 1.0
                    + left(n)
            })
            .collect()
    };
    let samples = truth.map(wave);
    let channels: Vec<_> = samples
        .iter()
        .map(|s| Channel::Volts {
            samples: s,
            lsb_v: Some(1e-5),
            range_v: None,
        })
        .collect();
    let mut fit = fit_known_frequency(
        &Record {
            channels: &channels,
            interval_s,
        },
        freq_hz,
        &FitOptions::default(),
    )
    .unwrap();
    let phasors = ChannelPhasors::from_fit(&fit).unwrap();
    assert!(
        phasors
            .volts
            .iter()
            .zip(truth)
            .all(|(found, truth)| (found - truth).norm() < 1e-13),
        "{phasors:?}"
    );
    // Whole periods; the trend takes a little of the sine's part.
    let expected = 2.0 * 1e-10 / 2000.0;
    assert!(
        phasors
            .totals()
            .iter()
            .all(|v| (v.re_re / expected - 1.0).abs() < 0.01
                && (v.im_im / expected - 1.0).abs() < 0.01),
        "{phasors:?}"
    );
    assert!((raw_impedance(&phasors, 0.01).z_ohm - c(0.009, -0.002)).norm() < 1e-13);
    fit.channels.pop();
    assert_eq!(
        ChannelPhasors::from_fit(&fit).unwrap_err().to_string(),
        "expected fits of 4 channels, met 3"
    );
}

fn point(freq_hz: f64) -> ImpedancePoint {
    ImpedancePoint {
        freq_hz,
        z_ohm: c(0.01, -0.001),
        covariance: Covariance2::circular(1e-10),
        amplitude_a: 1.0,
    }
}

type Change = fn(&mut ImpedancePoint);

#[test]
fn a_spectrum_is_checked() {
    let bad = |change: Change| {
        let mut points = vec![point(1.0), point(2.0), point(3.0)];
        change(&mut points[1]);
        Spectrum {
            name: "run 7".into(),
            points,
            ..Spectrum::default()
        }
        .validate()
        .unwrap_err()
        .to_string()
    };
    let cases: [(Change, &str); 6] = [
        (
            |p| p.freq_hz = 1.0,
            "spectrum \"run 7\", point 2 (1 Hz): expected rising frequencies, met 1 Hz after 1 Hz",
        ),
        (
            |p| p.freq_hz = f64::NAN,
            "spectrum \"run 7\", point 2 (NaN Hz): expected a frequency above 0 Hz, met NaN Hz",
        ),
        (
            |p| p.z_ohm.im = f64::INFINITY,
            "spectrum \"run 7\", point 2 (2 Hz): expected a finite impedance, met 0.01+infi Ω",
        ),
        (
            |p| p.covariance.re_re = -1.0,
            "spectrum \"run 7\", point 2 (2 Hz): expected a covariance of positive variances, or \
            none, met -1, 0, 0.0000000001 Ω²",
        ),
        (
            |p| p.covariance.re_im = 2e-10,
            "spectrum \"run 7\", point 2 (2 Hz): expected a covariance of positive variances, or \
            none, met 0.0000000001, 0.0000000002, 0.0000000001 Ω²",
        ),
        (
            |p| p.amplitude_a = -1.0,
            "spectrum \"run 7\", point 2 (2 Hz): expected an amplitude of 0 A or more, or none, \
            met -1 A",
        ),
    ];
    for (change, text) in cases {
        assert_eq!(bad(change), text);
    }
    let empty = Spectrum {
        name: "run 7".into(),
        points: vec![],
        ..Spectrum::default()
    };
    assert_eq!(
        empty.validate().unwrap_err().to_string(),
        "spectrum \"run 7\": expected at least one point, met none"
    );
    let mut shuffled = Spectrum {
        name: "s".into(),
        points: vec![point(3.0), point(1.0), point(2.0)],
        ..Spectrum::default()
    };
    shuffled.sort();
    shuffled.points[2].covariance = Covariance2::UNKNOWN;
    shuffled.points[2].amplitude_a = f64::NAN;
    assert_eq!(shuffled.validate(), Ok(()));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_scaled_covariance_is_that_of_the_scaled_number(
        re in -3.0..3.0f64,
        im in -3.0..3.0f64,
        a in -3.0..3.0f64,
        b in -3.0..3.0f64,
    ) {
        let (direction, factor) = (c(re, im), c(a, b));
        let scaled = (Covariance2::along(direction) + Covariance2::circular(0.5)).scaled(factor);
        let expected =
            Covariance2::along(direction * factor) + Covariance2::circular(0.5 * factor.norm_sqr());
        prop_assert!((scaled.re_re - expected.re_re).abs() < 1e-9);
        prop_assert!((scaled.re_im - expected.re_im).abs() < 1e-9);
        prop_assert!((scaled.im_im - expected.im_im).abs() < 1e-9);
        prop_assert!(scaled.is_valid());
    }
}
