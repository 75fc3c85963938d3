//! Simulated campaign on a cell for the tests of the gate, by small Euler steps. Effects are added
//! by hand, each in a line or two.

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
use std::f64::consts::TAU;

/// Effects of the true cell and bench beyond the base.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Hidden {
    /// Kelvin of warming lower all resistances by 2 % each; J/K is 70.
    pub(crate) heat: bool,
    /// mV of hysteresis after 2 % of SOC.
    pub(crate) hysteresis_v: f64,
    /// Resistance and time constant of a slow branch.
    pub(crate) slow: Option<(f64, f64)>,
    /// β of the second branch, 1/A.
    pub(crate) beta: f64,
    /// Resistances under charge are larger by this share.
    pub(crate) asymmetry: f64,
    /// All resistances grow by this share per run.
    pub(crate) ageing: f64,
    /// Lag of the logged current in every record, s.
    pub(crate) lag_s: f64,
    /// Addition to a spectrum: a function of frequency and of the base's impedance.
    pub(crate) spectrum: Option<fn(f64, Complex64) -> Complex64>,
}

pub(crate) fn model() -> BaseModel {
    let rc = |r_ohm: f64, tau_s: f64| RcBranch {
        r_ohm,
        c_f: tau_s / r_ohm,
    };
    let soc: Vec<f64> = (0..=10).map(|k| f64::from(k) / 10.0).collect();
    let ocv_v = soc.iter().map(|z| 3.2 + 0.9 * z).collect();
    BaseModel {
        name: "m".to_owned(),
        erm: Erm {
            r_ohm: 6.5e-3,
            branches: vec![rc(1.5e-3, 5e-3), rc(2e-3, 60e-3), rc(3e-3, 2.0)],
        },
        ocv: OcvCurve::monotone(4.5, soc, ocv_v).unwrap(),
    }
}

pub(super) fn history() -> BenchHistory {
    BenchHistory {
        voltage_noise_v: 5e-4,
        voltage_resolution_v: 1.22e-3,
        voltage_offset_v: 5e-4,
        voltage_drift_v: 1.5e-4,
        voltage_drift_s: 2.0,
        resistance_rel: 4e-3,
        current_gain_rel: 1e-3,
        current_offset_a: 0.03,
        current_noise_a: 0.03,
        current_resolution_a: 0.1,
        eis_noise_rel: 1e-3,
        start_voltage_v: 0.0,
        calibration_rel: 0.0,
        channel_gain_rel: 0.0,
    }
}

/// Deterministic normal numbers.
pub(super) struct Chance(u64);

impl Chance {
    fn even(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.even().ln()).sqrt() * (TAU * self.even()).cos()
    }
}

/// Duration (s) and current (A, discharge positive).
type Segments = &'static [(f64, f64)];

pub(super) const PULSES: Segments = &[
    (2.0, 0.0),
    (5.0, 10.0),
    (40.0, 0.0),
    (5.0, -10.0),
    (40.0, 0.0),
    (5.0, 30.0),
    (40.0, 0.0),
    (5.0, 100.0),
    (40.0, 0.0),
    (5.0, -40.0),
    (40.0, 0.0),
];
pub(super) const DISCHARGE: Segments = &[(2.0, 0.0), (360.0, 9.0), (120.0, 0.0)];
pub(super) const PROFILE: Segments = &[
    (2.0, 0.0),
    (1.2, 20.0),
    (0.6, 75.0),
    (0.8, -25.0),
    (2.0, 15.0),
    (0.4, 80.0),
    (1.6, 5.0),
    (0.6, -30.0),
    (1.0, 40.0),
    (2.0, 12.0),
    (0.4, 70.0),
    (0.8, -20.0),
    (1.4, 25.0),
    (0.6, 60.0),
    (2.0, 10.0),
];

fn grid(segments: Segments) -> (Vec<f64>, Vec<f64>) {
    let (mut time_s, mut current_a, mut start_s) = (Vec::new(), Vec::new(), 0.0);
    for (span_s, amps) in segments {
        let mut since_s = 0.0;
        while since_s < span_s - 1e-9 {
            time_s.push(start_s + since_s);
            current_a.push(*amps);
            since_s += match since_s {
                t if t < 0.099 => 0.01,
                t if t < 0.499 => 0.05,
                t if t < 4.99 => 0.2,
                _ => 1.0,
            };
        }
        start_s += span_s;
    }
    (time_s, current_a)
}

fn record(segments: Segments, hidden: &Hidden, order: f64, chance: &mut Chance) -> TimeRecord {
    let (time_s, current_a) = grid(segments);
    let m = model();
    let size = (1.0 + hidden.ageing * order) * (1.0 + 4e-3 * chance.normal());
    let level_v = 5e-4 * chance.normal();
    let (mut v, mut slow_v, mut warm_k, mut soc, mut h, mut logged) =
        (vec![0.0; 3], 0.0, 0.0f64, 0.5, 0.0f64, 0.0);
    let (mut voltage_v, mut shown_a) = (Vec::new(), Vec::new());
    for k in 0..time_s.len() {
        let i = current_a[k];
        let factor =
            size * (-0.02 * warm_k).exp() * if i < 0.0 { 1.0 + hidden.asymmetry } else { 1.0 };
        let drop_v = factor * m.erm.r_ohm * i + v.iter().sum::<f64>() + slow_v;
        let terminal_v = m.ocv.voltage_v(soc) - drop_v
            + hidden.hysteresis_v * h
            + level_v
            + 5e-4 * chance.normal();
        voltage_v.push((terminal_v / 1.22e-3).round() * 1.22e-3);
        let step_s = time_s.get(k + 1).map_or(0.01, |t| t - time_s[k]);
        let parts = (step_s / 5e-4).ceil();
        let part_s = step_s / parts;
        let mut mean = 0.0;
        for _ in 0..parts as usize {
            for (n, branch) in m.erm.branches.iter().enumerate() {
                let r = factor * branch.r_ohm;
                let through = if n == 1 && hidden.beta > 0.0 {
                    (hidden.beta * v[n] / r).sinh() / hidden.beta
                } else {
                    v[n] / r
                };
                v[n] += part_s / (branch.time_constant_s() / r) * (i - through);
            }
            if let Some((r, tau_s)) = hidden.slow {
                slow_v += part_s / tau_s * (r * i - slow_v);
            }
            if hidden.heat {
                warm_k += part_s * (i * drop_v - 0.1 * warm_k) / 70.0;
            }
            h -= part_s * i.abs() / 16_200.0 * 50.0 * (h + i.signum());
            soc -= part_s * i / 16_200.0;
            logged = if hidden.lag_s > 0.0 {
                logged + part_s / hidden.lag_s.max(part_s) * (i - logged)
            } else {
                i
            };
            mean += logged / parts;
        }
        shown_a.push(((mean + 0.03 * chance.normal()) / 0.1).round() * 0.1);
    }
    let series = TimeSeries {
        name: "s".to_owned(),
        time_s,
        current_a: shown_a,
        voltage_v,
        temperature_degc: None,
    };
    TimeRecord {
        series,
        between: Between::Hold,
        compared_from_s: 0.0,
        level_sigma_v: 0.0,
        sigma_v: None,
        averaged_s: None,
        current_errors_a: Vec::new(),
    }
}

fn sweep(control_ohm: Option<f64>, hidden: &Hidden, order: f64, chance: &mut Chance) -> Sweep {
    let erm = model().erm;
    let size = (1.0 + hidden.ageing * order) * (1.0 + 4e-3 * chance.normal());
    let points = (0..25).map(|k| {
        let freq_hz = 0.1 * 3000f64.powf(f64::from(k) / 24.0);
        let clean = control_ohm.map_or_else(|| size * erm.impedance(freq_hz), Complex64::from);
        let clean = hidden.spectrum.map_or(clean, |more| more(freq_hz, clean));
        let noise = Complex64::new(chance.normal(), chance.normal());
        SweepPoint {
            freq_hz,
            z_ohm: clean + 1e-3 * clean.norm() * noise,
            sigma_ohm: None,
            amplitude_a: Some(1.0),
        }
    });
    Sweep {
        bias_a: 0.0,
        common_mode: CommonModeImpedance::default(),
        elapsed_s: Vec::new(),
        charge_coulomb: Vec::new(),
        harmonics: Vec::new(),
        points: points.collect(),
    }
}

pub(super) const SHUNT_OHM: f64 = 9.96e-3;

/// Four sweeps of the cell, one of the shunt, three each of pulses, discharges and profiles,
/// interleaved.
pub(crate) fn campaign(hidden: &Hidden, seed: u64) -> DataSet {
    let mut chance = Chance(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x5851_F42D_4C95_7F2D);
    let mut runs = Vec::new();
    for repeat in 0..4 {
        for (group, segments) in [
            ("eis", None),
            ("shunt", None),
            ("pulse", Some(PULSES)),
            ("discharge", Some(DISCHARGE)),
            ("profile", Some(PROFILE)),
        ] {
            if (repeat == 3 && group != "eis") || (repeat > 0 && group == "shunt") {
                continue;
            }
            let order = runs.len() as u32;
            let control_ohm = (group == "shunt").then_some(SHUNT_OHM);
            let data = match segments {
                Some(segments) => {
                    RunData::Time(record(segments, hidden, f64::from(order), &mut chance))
                }
                None => RunData::Eis(sweep(control_ohm, hidden, f64::from(order), &mut chance)),
            };
            runs.push(Run {
                name: format!("{group}_{repeat}"),
                fixture: control_ohm.map_or_else(|| Fixture::Cell("c".to_owned()), Fixture::Shunt),
                role: Role::Train,
                repeat_group: group.to_owned(),
                order,
                start_s: 7200.0 * f64::from(order),
                temperature_degc: 25.0,
                start: Start::Soc(0.5),
                data,
            });
        }
    }
    DataSet {
        name: "d".to_owned(),
        runs,
        history: Some(history()),
        calibration: None,
    }
}

/// Returns the record of a run, to be damaged.
pub(crate) fn series<'a>(set: &'a mut DataSet, name: &str) -> &'a mut TimeSeries {
    let run = set.runs.iter_mut().find(|run| run.name == name).unwrap();
    let RunData::Time(record) = &mut run.data else {
        panic!("{name} is not a record")
    };
    &mut record.series
}

/// Returns the points of a sweep, to be damaged.
pub(crate) fn points<'a>(set: &'a mut DataSet, name: &str) -> &'a mut Vec<SweepPoint> {
    let run = set.runs.iter_mut().find(|run| run.name == name).unwrap();
    let RunData::Eis(sweep) = &mut run.data else {
        panic!("{name} is not a sweep")
    };
    &mut sweep.points
}

/// Exchanges what two runs hold.
pub(super) fn exchange(set: &mut DataSet, a: &str, b: &str) {
    let at = |name: &str| set.runs.iter().position(|run| run.name == name).unwrap();
    let (a, b) = (at(a), at(b));
    let held = set.runs[a].data.clone();
    set.runs[a].data = std::mem::replace(&mut set.runs[b].data, held);
}
