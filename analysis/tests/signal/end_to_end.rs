//! From ADC codes to corrected impedance: waveforms with offset, drift and noise, digitised by 12
//! bits, fitted, corrected, against the cell.

use std::f64::consts::TAU;

use analysis::calibration::{Controls, Correction, KnownImpedance, Priors};
use analysis::dataset::{Capture, CaptureMeta, ChannelMeta, read_capture, write_capture};
use analysis::sine::{
    CodeScale, FitOptions, Record, SineFit, fit_free_frequency, fit_known_frequency,
};
use analysis::spectrum::{ChannelPhasors, ImpedancePoint};
use num_complex::Complex64;

use crate::bench::{Bench, FAKE_CELL, Probes, SHUNT, cell, fake_cell};
use crate::noise::Noise;

const SAMPLES: usize = 4000;
/// Vertical scales, V/div: as many millivolts as the loop's impedances ask for at 1 A.
const VOLTS_PER_DIV: [f64; 4] = [0.01, 0.02, 0.02, 0.02];
const NOISE_V: f64 = 0.2e-3;

/// Digitises 11.3 periods of the channels' signals, from a separate instant.
fn capture(
    phasors: &ChannelPhasors,
    levels_v: [f64; 4],
    drift_v: f64,
    noise: &mut Noise,
) -> Capture {
    let interval_s = 11.3 / phasors.freq_hz / SAMPLES as f64;
    let start_s = noise.uniform() / phasors.freq_hz;
    let channels = VOLTS_PER_DIV.map(|volts_per_div| {
        let scale = CodeScale {
            volts_per_code: 8.0 * volts_per_div / 4096.0,
            offset_v: 0.0,
            code_min: -2048,
            code_max: 2047,
            code_step: 1,
        };
        ChannelMeta {
            scale,
            volts_per_div,
        }
    });
    let mut channels = channels;
    let mut codes: [Vec<i16>; 4] = Default::default();
    for (k, meta) in channels.iter_mut().enumerate() {
        meta.scale.offset_v = -levels_v[k];
        let mut code = |n: usize| {
            let part = n as f64 / SAMPLES as f64;
            let wave = (phasors.volts[k]
                * Complex64::cis(TAU * phasors.freq_hz * (start_s + n as f64 * interval_s)))
            .re;
            let drift = if k == 3 { drift_v * part } else { 0.0 };
            let volts = levels_v[k] + wave + drift + NOISE_V * noise.gauss();
            ((volts + meta.scale.offset_v) / meta.scale.volts_per_code)
                .round()
                .clamp(-2048.0, 2047.0) as i16
        };
        codes[k] = (0..SAMPLES).map(&mut code).collect();
    }
    Capture {
        meta: CaptureMeta {
            label: String::new(),
            freq_hz: phasors.freq_hz,
            interval_s,
            start_s,
            channels,
        },
        codes,
    }
}

fn fit(capture: &Capture, free: bool) -> SineFit {
    let channels = capture.channels();
    let record = Record {
        channels: &channels,
        interval_s: capture.meta.interval_s,
    };
    let fit = if free {
        fit_free_frequency(&record, Some(capture.meta.freq_hz), &FitOptions::default()).unwrap()
    } else {
        fit_known_frequency(&record, capture.meta.freq_hz, &FitOptions::default()).unwrap()
    };
    assert!(
        fit.channels
            .iter()
            .all(|channel| channel.clipped_samples == 0 && channel.colour_factor < 1.3),
        "{fit:?}"
    );
    fit
}

fn sweep(
    bench: &Bench,
    probes: Probes,
    in_jig: fn(f64) -> Complex64,
    noise: &mut Noise,
) -> Vec<ChannelPhasors> {
    // Copper has no voltage that could drift.
    let (levels_v, drift_v) = if probes == Probes::OnJig && in_jig(0.1) == cell(0.1) {
        ([0.0, 0.0, 0.0, 3.8], 2e-3)
    } else {
        ([0.0; 4], 0.0)
    };
    let digitised = bench
        .sweep(probes, in_jig, noise)
        .into_iter()
        .step_by(2)
        .map(|phasors| {
            let fit = fit(&capture(&phasors, levels_v, drift_v, noise), false);
            ChannelPhasors::from_fit(&fit).unwrap()
        });
    digitised.collect()
}

#[test]
fn twelve_bits_give_the_cell_with_an_honest_sigma() {
    let (mut within, mut all, mut worst) = (0, 0, (0.0f64, 0.0f64));
    for seed in 0..10 {
        let mut noise = Noise::new(seed + 500);
        // The noise comes with the samples.
        let bench = Bench {
            skews_s: [0.3e-6, -0.2e-6, 0.4e-6],
            ..Bench::any(&mut noise, 1e-12)
        };
        let known = |(r_ohm, l_h): (f64, f64)| KnownImpedance {
            r_ohm,
            r_sigma_ohm: 1e-6,
            l_h,
            l_sigma_h: 2e-9,
        };
        let shunt = sweep(&bench, Probes::OnShunt, fake_cell, &mut noise);
        let fake = sweep(&bench, Probes::OnJig, fake_cell, &mut noise);
        let measured = sweep(&bench, Probes::OnJig, cell, &mut noise);
        let fake_cell = Some((known(FAKE_CELL), fake.as_slice()));
        let priors = Priors {
            skew_sigma_s: 0.3e-6,
            ..Priors::default()
        };
        let correction = Correction::fit(&Controls {
            current_shunt: known(SHUNT),
            shunt: &shunt,
            fake_cell,
            short: None,
            open: None,
            priors,
        })
        .unwrap();
        assert!(
            (0.5..1.6).contains(&correction.reduced_chi2.unwrap()),
            "{:?}",
            correction.reduced_chi2
        );
        for phasors in &measured {
            let point = correction.apply(phasors);
            let truth = cell(point.freq_hz);
            let error = point.z_ohm - truth;
            worst.0 = worst
                .0
                .max((point.magnitude_ohm() / truth.norm() - 1.0).abs());
            worst.1 = worst.1.max((point.z_ohm / truth).arg().to_degrees().abs());
            within += usize::from(error.re.abs() < 2.0 * point.covariance.re_re.sqrt());
            within += usize::from(error.im.abs() < 2.0 * point.covariance.im_im.sqrt());
            all += 2;
        }
    }
    let share = f64::from(within as u32) / f64::from(all);
    assert!((0.90..=0.99).contains(&share), "2σ covers {share}");
    assert!(
        worst.0 < 0.005 && worst.1 < 0.3,
        "worst magnitude {} and phase {}°",
        worst.0,
        worst.1
    );
}

#[test]
fn a_frequency_that_is_a_little_off_is_found() {
    let mut noise = Noise::new(3);
    let bench = Bench::any(&mut noise, 1e-12);
    let phasors = bench.measure(10.0, Probes::OnJig, cell(10.0), &mut noise);
    let mut capture = capture(&phasors, [0.0, 0.0, 0.0, 3.8], 0.0, &mut noise);
    let impedance = |fit: &SineFit| {
        analysis::spectrum::raw_impedance(&ChannelPhasors::from_fit(fit).unwrap(), SHUNT.0)
    };
    let right: ImpedancePoint = impedance(&fit(&capture, false));
    // A generator that is off by 0.2 %: the phase at the ends is off by 4°.
    capture.meta.freq_hz *= 1.002;
    let free = fit(&capture, true);
    assert!(
        (free.freq_hz - 10.0).abs() < 4.0 * free.freq_sigma_hz.unwrap()
            && free.freq_sigma_hz.unwrap() < 1e-3,
        "{free:?}"
    );
    let found = impedance(&free);
    assert!(
        (found.z_ohm - right.z_ohm).norm() < 0.5 * right.covariance.re_re.sqrt(),
        "{found:?} {right:?}"
    );
    assert!(
        (found.covariance.re_re / right.covariance.re_re - 1.0).abs() < 0.1,
        "a common frequency costs the quotient nothing"
    );
}

#[test]
fn a_capture_from_the_disk_fits_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("point.parquet");
    let mut noise = Noise::new(4);
    let phasors = Bench::any(&mut noise, 1e-12).measure(3.0, Probes::OnJig, cell(3.0), &mut noise);
    let capture = capture(&phasors, [0.0, 0.0, 0.0, 3.8], 0.0, &mut noise);
    write_capture(&path, &capture).unwrap();
    assert_eq!(
        fit(&read_capture(&path).unwrap(), true),
        fit(&capture, true)
    );
}
