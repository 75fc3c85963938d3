//! Sinusoids that change over the record: the fit against plain least squares, its uncertainty, and when
//! it is chosen.

use std::f64::consts::TAU;

use analysis::{
    sine::{
        Channel, CodeScale, FitOptions, Record, SineFit, Varying, fit_known_frequency,
        fit_with_change, relaxations,
    },
    spectrum::ChannelPhasors,
};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

use crate::{noise::Noise, sine_model::codes};

const INTERVAL_S: f64 = 1e-3;

fn changing() -> FitOptions {
    FitOptions {
        varying: Varying::Linear,
        harmonics: vec![2],
        ..FitOptions::default()
    }
}

#[test]
fn a_changing_sinusoid_agrees_with_plain_least_squares_in_every_kernel() {
    let scale = |bound: i16| CodeScale {
        volts_per_code: 1.0,
        offset_v: 0.0,
        code_min: -bound,
        code_max: bound - 1,
        code_step: 1,
    };
    // Within the range, clipped at the crests, and more codes than the integer kernel takes.
    for (amplitude, scale) in [
        (1500.0, scale(2048)),
        (2300.0, scale(2048)),
        (20_000.0, scale(32_767)),
    ] {
        let count = 3585;
        let middle_s = 0.5 * (f64::from(count) - 1.0) * INTERVAL_S;
        let volts = |t: f64| {
            let u = (t - middle_s) / middle_s;
            amplitude
                * ((1.0 + 0.1 * u) * (TAU * 7.3 * t + 0.4).cos() + 0.05 * u * (TAU * 7.3 * t).sin())
                + 0.02 * amplitude * (TAU * 14.6 * t).cos()
                + 30.0 * u
        };
        let codes: Vec<i16> = codes(count as usize, 0.6, 3, volts)
            .into_iter()
            .map(|code| code.clamp(scale.code_min, scale.code_max))
            .collect();
        let rows: Vec<usize> = (0..codes.len())
            .filter(|n| codes[*n] > scale.code_min && codes[*n] < scale.code_max)
            .collect();
        let matrix = DMatrix::from_fn(rows.len(), 8, |row, column| {
            let t = rows[row] as f64 * INTERVAL_S;
            let (u, turn) = ((t - middle_s) / middle_s, TAU * 7.3 * t);
            [
                turn.cos(),
                -turn.sin(),
                (2.0 * turn).cos(),
                -(2.0 * turn).sin(),
                1.0,
                u,
                u * turn.cos(),
                -u * turn.sin(),
            ][column]
        });
        let values = DVector::from_iterator(rows.len(), rows.iter().map(|n| f64::from(codes[*n])));
        let qr = matrix.clone().qr();
        let beta = qr
            .r()
            .solve_upper_triangular(&(qr.q().transpose() * &values))
            .unwrap();
        let rms = ((values - matrix * &beta).norm_squared() / rows.len() as f64).sqrt();
        let channels = [Channel::codes(&codes, scale)];
        let record = Record {
            channels: &channels,
            interval_s: INTERVAL_S,
        };
        let found = fit_known_frequency(&record, 7.3, &changing()).unwrap();
        let channel = &found.channels[0];
        let off = |met: Complex64, re: usize| (met - Complex64::new(beta[re], beta[re + 1])).norm();
        assert!(found.varying);
        assert!(
            off(channel.phasor, 0) < 1e-8 * amplitude,
            "{amplitude}: {}",
            channel.phasor
        );
        assert!(off(found.tones[0].channels[0].phasor, 2) < 1e-8 * amplitude);
        let slope = channel.phasor_slope * middle_s;
        assert!(
            off(slope, 6) < 1e-8 * amplitude,
            "{amplitude}: {slope} against {beta}"
        );
        assert!(
            (channel.residual_rms_v / rms - 1.0).abs() < 1e-6,
            "{} against {rms}",
            channel.residual_rms_v
        );
        // The model as a whole, at both ends.
        for n in [0, count - 1] {
            let t = f64::from(n) * INTERVAL_S;
            let value = found.value_v(0, t).unwrap();
            assert!(
                (value - volts(t)).abs() < 1.0 + 3e-4 * amplitude,
                "{value} against {}",
                volts(t)
            );
        }
    }
}

/// Four channels of a cell whose impedance changes linearly by `change` over 20 periods.
fn record(change: f64, noise_v: f64, seed: u64) -> [Vec<f64>; 4] {
    let mut noise = Noise::new(seed);
    let count = 8000;
    let mut channel = |amplitude_v: f64, change: f64| -> Vec<f64> {
        let value = |n: usize| {
            let u = (2.0 * n as f64 + 1.0) / f64::from(count) - 1.0;
            let turn = TAU * 2.5 * INTERVAL_S * n as f64;
            amplitude_v * (1.0 + 0.5 * change * u) * (turn + 0.3).cos()
                + 0.01 * u
                + noise_v * noise.gauss()
        };
        (0..count as usize).map(value).collect()
    };
    [
        channel(0.001, 0.0),
        channel(0.05, 0.0),
        channel(0.002, 0.0),
        channel(0.1, change),
    ]
}

fn fitted(volts: &[Vec<f64>; 4]) -> SineFit {
    let channels = volts.each_ref().map(|v| Channel::volts(v));
    let record = Record {
        channels: &channels,
        interval_s: INTERVAL_S,
    };
    fit_with_change(&record, 2.5, &options()).unwrap()
}

fn options() -> FitOptions {
    FitOptions {
        decays_s: relaxations(8.0),
        ..FitOptions::default()
    }
}

#[test]
fn the_phasor_of_a_changing_cell_is_that_of_the_middle_and_its_interval_covers_it() {
    let exact = fitted(&record(0.2, 1e-9, 1));
    assert!(exact.varying);
    let truth = Complex64::from_polar(0.1, 0.3);
    assert!(
        (exact.channels[3].phasor - truth).norm() < 1e-4 * 0.1,
        "{}",
        exact.channels[3].phasor
    );
    let over_record = exact.channels[3].phasor_slope * 8.0 / truth;
    assert!((over_record - 0.2).norm() < 1e-4, "{over_record}");
    let (mut inside, mut chosen) = (0, 0);
    for seed in 0..400 {
        let fit = fitted(&record(0.02, 1e-3, seed));
        chosen += usize::from(fit.varying);
        let phasors = ChannelPhasors::from_fit(&fit).unwrap();
        let sigma = phasors.variance[3].noise.re_re.sqrt();
        inside += usize::from((phasors.volts[3] - truth).re.abs() < 1.96 * sigma);
    }
    assert!(chosen >= 390, "the change is seen in {chosen} of 400");
    assert!(
        (368..=392).contains(&inside),
        "{inside} of 400 lie within 95 %"
    );
}

#[test]
fn a_constant_cell_keeps_the_simple_fit_bit_by_bit() {
    for seed in 0..300 {
        let volts = record(0.0, 1e-3, seed);
        let fit = fitted(&volts);
        assert!(!fit.varying, "seed {seed}");
        if seed == 0 {
            let channels = volts.each_ref().map(|v| Channel::volts(v));
            let record = Record {
                channels: &channels,
                interval_s: INTERVAL_S,
            };
            let known = fit_known_frequency(&record, 2.5, &options()).unwrap();
            assert_eq!(known, fit);
        }
    }
}

#[test]
fn a_change_that_is_not_straight_widens_the_interval() {
    let fit = fitted(&record(0.2, 1e-4, 3));
    let phasors = ChannelPhasors::from_fit(&fit).unwrap();
    // The phasor of 0.1 V changes by 0.2 of itself over the record: a 24th of that.
    let expected = 0.1 * 0.2 / 24.0;
    let drift = phasors.variance[3].drift;
    let stated = (drift.re_re + drift.im_im).sqrt();
    assert!(
        (stated / expected - 1.0).abs() < 0.05,
        "{stated} against {expected}"
    );
}
