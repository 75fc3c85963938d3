//! A plain cell and a plain bench for the tests of the workflow: one series resistance, two
//! branches, a curve, and the effects that a test hides in them.
//!
//! Written out by hand, step by step; it shares only the types of the data with the tested code.

use crate::{
    BaseModel, BenchHistory, DataSet, Fixture, Role, Run, RunData, Start, Sweep, SweepPoint,
    TimeRecord,
};
use analysis_effects::{augmented::Between, contract::CommonModeImpedance};
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};
use analysis_signal::series::TimeSeries;
use num_complex::Complex64;

pub(super) const R0: f64 = 7e-3;
pub(super) const BRANCHES: [(f64, f64); 2] = [(2e-3, 0.05), (3e-3, 2.0)];
pub(super) const CAPACITY_AH: f64 = 4.5;
const START: f64 = 0.5;
const COOLING_S: f64 = 500.0;

/// Numbers between −1.7 and 1.7 of variance 1, from a multiplicative congruence.
pub(super) struct Chance(u64);

impl Chance {
    pub(super) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Returns the sum of twelve, about normal.
    pub(super) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Hidden effects of the simulated cell and bench, all absent by default.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Hidden {
    /// R × (1 + k(z − ½)).
    pub(super) per_soc: f64,
    /// OCV moves (1 + q) times as far.
    pub(super) slope: f64,
    /// R × exp(−g·heat); the heat decays with a time constant of [`COOLING_S`].
    pub(super) heat_per_j: f64,
    /// Resistance of an intermittent contact, Ω.
    pub(super) telegraph_ohm: f64,
    /// A ripple of the voltage over charge, V.
    pub(super) ripple_v: f64,
    /// Part by which all resistances are larger from the sixth run on.
    pub(super) later_rel: f64,
    /// A further branch, Ω and s.
    pub(super) slow: (f64, f64),
}

/// OCV at a state of charge, V.
pub(super) fn ocv_v(z: f64) -> f64 {
    3.2 + 0.9 * z + 0.05 * (6.0 * z).sin()
}

pub(super) fn model() -> BaseModel {
    let soc: Vec<f64> = (0..=100).map(|k| f64::from(k) / 100.0).collect();
    let curve = OcvCurve::monotone(
        CAPACITY_AH,
        soc.clone(),
        soc.iter().map(|z| ocv_v(*z)).collect(),
    )
    .unwrap();
    let branches = BRANCHES
        .iter()
        .map(|(r_ohm, tau_s)| RcBranch {
            r_ohm: *r_ohm,
            c_f: tau_s / r_ohm,
        })
        .collect();
    BaseModel {
        name: "test".to_owned(),
        erm: Erm {
            r_ohm: R0,
            branches,
        },
        ocv: curve,
    }
}

pub(super) const HISTORY: BenchHistory = BenchHistory {
    voltage_noise_v: 5e-4,
    voltage_resolution_v: 0.0,
    voltage_offset_v: 3e-4,
    voltage_drift_v: 1e-5,
    voltage_drift_s: 2.0,
    resistance_rel: 2e-3,
    current_gain_rel: 1e-3,
    current_offset_a: 0.06,
    current_noise_a: 0.0,
    current_resolution_a: 0.0,
    eis_noise_rel: 1e-3,
    calibration_rel: 0.0,
    channel_gain_rel: 0.0,
    start_voltage_v: 0.0,
};

/// Segments of current (s, A, discharge positive).
pub(super) const PULSES: &[(f64, f64)] = &[
    (2.0, 0.0),
    (5.0, 20.0),
    (30.0, 0.0),
    (5.0, -20.0),
    (30.0, 0.0),
    (5.0, 60.0),
    (30.0, 0.0),
    (5.0, -40.0),
    (30.0, 0.0),
];
pub(super) const LONG: &[(f64, f64)] = &[(2.0, 0.0), (300.0, 9.0), (200.0, 0.0)];
pub(super) const BLOCK: &[(f64, f64)] = &[
    (2.0, 0.0),
    (60.0, 25.0),
    (30.0, 0.0),
    (30.0, -15.0),
    (60.0, 0.0),
];

/// Returns a record of one run with its own errors of both channels.
pub(super) fn record(
    segments: &[(f64, f64)],
    spacing: f64,
    hidden: &Hidden,
    chance: &mut Chance,
) -> TimeSeries {
    let (gain, zero) = (
        1.0 + HISTORY.current_gain_rel * chance.normal(),
        HISTORY.current_offset_a * chance.normal(),
    );
    let (spread, level) = (
        1.0 + HISTORY.resistance_rel * chance.normal() + hidden.later_rel,
        HISTORY.voltage_offset_v * chance.normal(),
    );
    let mut s = TimeSeries {
        name: String::new(),
        time_s: Vec::new(),
        current_a: Vec::new(),
        voltage_v: Vec::new(),
        temperature_degc: None,
    };
    let (mut t, mut moved_coulomb, mut heat_j, mut v, mut contact) = (0.0, 0.0, 0.0, [0.0; 2], 0.0);
    let mut slow_v = 0.0;
    for (duration_s, amps) in segments {
        let end = t + duration_s;
        let mut since: f64 = 0.0;
        while t < end - 1e-9 {
            let soc = |moved_coulomb: f64| {
                START - (1.0 + hidden.slope) * moved_coulomb / (3600.0 * CAPACITY_AH)
            };
            let factor = |moved_coulomb: f64, heat_j: f64| {
                spread
                    * (1.0 + hidden.per_soc * (soc(moved_coulomb) - START))
                    * (-hidden.heat_per_j * heat_j).exp()
            };
            if chance.uniform() < 0.05 {
                contact = hidden.telegraph_ohm - contact;
            }
            let loss_v =
                factor(moved_coulomb, heat_j) * R0 * amps + contact * amps + v[0] + v[1] + slow_v;
            let ripple_v = hidden.ripple_v * (std::f64::consts::TAU * moved_coulomb / 25.0).sin();
            s.time_s.push(t);
            s.current_a.push(gain * amps + zero);
            s.voltage_v.push(
                ocv_v(soc(moved_coulomb)) - loss_v
                    + ripple_v
                    + level
                    + HISTORY.voltage_noise_v * chance.normal(),
            );
            // Whole multiples of 10 ms, so that edges fall on samples.
            let step = ((spacing * since).max(0.01) * 100.0).round() / 100.0;
            let step = step.min(end - t);
            // The truth in four hundred small steps.
            for _ in 0..400 {
                let h = step / 400.0;
                let now = factor(moved_coulomb + 0.5 * amps * h, heat_j);
                for (v, (r, tau)) in v.iter_mut().zip(BRANCHES) {
                    let target = now * r * amps;
                    *v = target + (*v - target) * (-h / (tau * now)).exp();
                }
                let settled_v = spread * hidden.slow.0 * amps;
                slow_v = settled_v + (slow_v - settled_v) * (-h / hidden.slow.1.max(1e-9)).exp();
                heat_j += (amps * (now * R0 * amps + v[0] + v[1]) - heat_j / COOLING_S) * h;
                moved_coulomb += amps * h;
            }
            t += step;
            since += step;
        }
    }
    s
}

/// Returns a sweep from 0.1 to 300 Hz.
pub(super) fn sweep(hidden: &Hidden, chance: &mut Chance) -> Sweep {
    let spread = 1.0 + HISTORY.resistance_rel * chance.normal() + hidden.later_rel;
    let points = (0..20)
        .map(|k| {
            let freq_hz = 0.1 * 3000f64.powf(f64::from(k) / 19.0);
            let omega = std::f64::consts::TAU * freq_hz;
            let mut z = Complex64::new(R0, 0.0);
            for (r, tau) in BRANCHES {
                z += r / Complex64::new(1.0, omega * tau);
            }
            z += hidden.slow.0 / Complex64::new(1.0, omega * hidden.slow.1);
            let slope = (ocv_v(START + 1e-4) - ocv_v(START - 1e-4)) / 2e-4 * (1.0 + hidden.slope);
            z = spread * z - Complex64::new(0.0, slope / (3600.0 * CAPACITY_AH * omega));
            let size = HISTORY.eis_noise_rel * z.norm();
            z += Complex64::new(size * chance.normal(), size * chance.normal());
            SweepPoint {
                freq_hz,
                z_ohm: z,
                sigma_ohm: None,
                amplitude_a: Some(1.0),
            }
        })
        .collect();
    Sweep {
        bias_a: 0.0,
        common_mode: CommonModeImpedance::default(),
        elapsed_s: Vec::new(),
        charge_coulomb: Vec::new(),
        harmonics: Vec::new(),
        points,
    }
}

/// Returns three repeats of sweeps, pulses and a long discharge to train on, and two held-out
/// blocks. `held_out` may hide another effect.
pub(super) fn campaign(seed: u64, train: &Hidden, held_out: &Hidden) -> DataSet {
    let mut chance = Chance::new(seed);
    let mut runs = Vec::new();
    let mut add = |name: &str, role, data| {
        let order = runs.len() as u32;
        runs.push(Run {
            name: format!("{name}_{order}"),
            fixture: Fixture::Cell("a".to_owned()),
            role,
            repeat_group: name.to_owned(),
            order,
            start_s: 7200.0 * f64::from(order),
            temperature_degc: 25.0,
            start: Start::Soc(START),
            data,
        });
    };
    let time = |segments, hidden: &Hidden, chance: &mut Chance| {
        RunData::Time(TimeRecord {
            series: record(segments, 0.2, hidden, chance),
            between: Between::Hold,
            compared_from_s: 0.0,
            level_sigma_v: 0.0,
            sigma_v: None,
            averaged_s: None,
            current_errors_a: Vec::new(),
        })
    };
    for nth in 0..3 {
        let at = |order: u32| Hidden {
            later_rel: if order >= 5 { train.later_rel } else { 0.0 },
            ..*train
        };
        add(
            "eis",
            Role::Train,
            RunData::Eis(sweep(&at(3 * nth), &mut chance)),
        );
        add(
            "pulses",
            Role::Train,
            time(PULSES, &at(3 * nth + 1), &mut chance),
        );
        add(
            "long",
            Role::Train,
            time(LONG, &at(3 * nth + 2), &mut chance),
        );
    }
    for _ in 0..2 {
        add("block", Role::HeldOut, time(BLOCK, held_out, &mut chance));
    }
    DataSet {
        name: "test".to_owned(),
        runs,
        history: Some(HISTORY),
        calibration: None,
    }
}
