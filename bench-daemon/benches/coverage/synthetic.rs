//! Synthetic spectra and pulses of one cell, for the joint fit: the cell is solved branch by
//! branch in closed form, and shares only its parameters with the model that is fitted.

use analysis::{
    joint::{JointOptions, Role, StudyInput, StudyOptions, study},
    model::{Erm, RcBranch},
    numeric::Covariance2,
    ocv::OcvCurve,
    series::TimeSeries,
    spectrum::{ImpedancePoint, Origin, SourcedSpectrum, Spectrum},
};
use fixtures::Scenario;
use num_complex::Complex64;
use rayon::prelude::*;
use std::f64::consts::TAU;

use super::tally::Tally;

/// Noise of a part of a spectrum's point, as a share of |Z|.
const SPECTRUM_NOISE: f64 = 1.0e-3;
/// Noise of a sample of the pulses, V.
const SERIES_NOISE_V: f64 = 2.0e-4;
/// Relative difference of the cell's capacity from that of the curve, one standard deviation.
const CAPACITY_SPREAD: f64 = 0.02;
/// Relative difference between the instruments of pulses and spectra, one standard deviation: the
/// default of the joint fit.
const GAIN_SPREAD: f64 = 0.01;
/// Voltage at which the spectra are measured, V.
const AT_V: f64 = 3.72;
/// Current beside the pulses, A; and in them.
const LOAD_A: f64 = 1.0;
const PULSE_A: f64 = 5.0;

/// Evaluates synthetic sets.
pub(crate) fn play(seeds: &[u64]) -> Tally {
    seeds
        .par_iter()
        .map(|seed| one(*seed))
        .reduce(Tally::default, Tally::join)
}

/// Generator of normal numbers: SplitMix64 and Box and Muller's transform.
pub(crate) struct Normal(pub(crate) u64);

impl Normal {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn next(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}

fn truth() -> Erm {
    let cell = Scenario::default().cell;
    Erm {
        r_ohm: cell.r_ohm,
        branches: cell
            .branches
            .iter()
            .map(|b| RcBranch {
                r_ohm: b.r_ohm,
                c_f: b.c_f,
            })
            .collect(),
    }
    .ordered()
}

fn curve(capacity_ah: f64) -> Option<OcvCurve> {
    OcvCurve::monotone(
        capacity_ah,
        vec![0.0, 0.2, 0.4, 0.5, 0.6, 0.8, 1.0],
        vec![2.9, 3.42, 3.63, 3.72, 3.81, 3.99, 4.2],
    )
    .ok()
}

fn one(seed: u64) -> Tally {
    let mut tally = Tally::default();
    let mut normal = Normal(seed.wrapping_mul(0x2545_F491_4F6C_DD1D));
    let erm = truth();
    let (Some(known), Some(own)) = (
        curve(4.5),
        curve(4.5 * (1.0 + CAPACITY_SPREAD * normal.next())),
    ) else {
        return tally;
    };
    let gain = 1.0 + GAIN_SPREAD * normal.next();
    let spectra: Vec<SourcedSpectrum> = (0..5)
        .map(|repeat| sweep(&erm, &own, repeat, &mut normal))
        .collect();
    let series = pulses(&erm, &own, gain, &mut normal);
    let input = StudyInput {
        spectra: &spectra,
        series: &series,
        curve: &known,
    };
    let options = StudyOptions {
        ocv_window_v: (AT_V, 0.2),
        dcir_ohm: 0.0135,
        rc: Some(4),
        fit: JointOptions::default(),
    };
    match study(&input, &options) {
        Ok((study, pooled)) => {
            if let Some(joint) = study.joint() {
                super::played::add_fit(&mut tally, &joint.to_erm_fit(&pooled, &options.fit), &erm);
                tally.add(
                    20_000,
                    "gain of the pulses",
                    joint.gain - gain,
                    joint.gain_sigma,
                );
            }
            if let Some((alone, both)) = study.rms_v(Role::HeldOut) {
                // Within the noise of the mean of a held-out pulse.
                tally.count(
                    "held-out pulses no worse than by the spectra alone",
                    both <= alone + 0.05 * SERIES_NOISE_V,
                );
            }
        }
        Err(error) => tally.fail(format!("seed {seed}: {error}")),
    }
    tally
}

fn sweep(erm: &Erm, own: &OcvCurve, repeat: usize, normal: &mut Normal) -> SourcedSpectrum {
    let slope = own.soc_at(AT_V).map_or(0.0, |soc| own.slope_v(soc)) / (3600.0 * own.capacity_ah);
    let point = |k: i32| {
        let freq_hz = 0.1 * 3000_f64.powf(f64::from(k) / 19.0);
        let omega = TAU * freq_hz;
        // Branches as admittances in parallel.
        let branch = |b: &RcBranch| Complex64::new(1.0 / b.r_ohm, omega * b.c_f).inv();
        let z = erm.r_ohm + erm.branches.iter().map(branch).sum::<Complex64>()
            - Complex64::new(0.0, slope / omega);
        let sigma = SPECTRUM_NOISE * z.norm();
        let z_ohm = z + sigma * Complex64::new(normal.next(), normal.next());
        ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance: Covariance2::circular(sigma * sigma),
            amplitude_a: 1.0,
        }
    };
    let spectrum = Spectrum::new(format!("cell0_{repeat}"), (0..20).map(point).collect());
    SourcedSpectrum {
        origin: Origin {
            cell: Some("0".to_owned()),
            ..Origin::default()
        },
        spectrum,
        flagged: Vec::new(),
    }
}

/// Five pulses of 10 s every 600 s over a steady load, sampled every 0.5 s and every 0.2 s around a
/// pulse.
fn pulses(erm: &Erm, own: &OcvCurve, gain: f64, normal: &mut Normal) -> TimeSeries {
    let mut state: Vec<f64> = erm.branches.iter().map(|b| b.r_ohm * LOAD_A).collect();
    let (mut drawn_coulomb, start) = (0.0, own.soc_at(AT_V + 0.08).unwrap_or(0.6));
    let mut series = TimeSeries {
        name: "pulses".to_owned(),
        time_s: vec![],
        current_a: vec![],
        voltage_v: vec![],
        temperature_degc: None,
    };
    // Steps of 0.1 s over which the current is constant: edges lie on them.
    for k in 0..30_000_u32 {
        let (time_s, phase) = (0.1 * f64::from(k), k % 6000);
        let current_a = if (3000..3100).contains(&phase) {
            PULSE_A
        } else {
            LOAD_A
        };
        let near = (2999..3200).contains(&phase);
        let due = if near {
            (phase - 2999) % 2 == 0
        } else {
            phase % 5 == 4
        };
        if due {
            let ocv = own.voltage_v(start - drawn_coulomb / (3600.0 * own.capacity_ah));
            let lost = gain * (current_a * erm.r_ohm + state.iter().sum::<f64>());
            series.time_s.push(time_s);
            series.current_a.push(current_a);
            series
                .voltage_v
                .push(ocv - lost + SERIES_NOISE_V * normal.next());
        }
        for (v, b) in state.iter_mut().zip(&erm.branches) {
            let left = (-0.1 / b.time_constant_s()).exp();
            *v = *v * left + b.r_ohm * current_a * (1.0 - left);
        }
        drawn_coulomb += 0.1 * current_a;
    }
    series
}
