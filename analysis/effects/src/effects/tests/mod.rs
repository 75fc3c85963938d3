//! A cell, the range of its data and records to simulate, for the tests of all effects.

mod all;
mod bench;
mod cell;
mod harmonics;

use crate::{
    augmented::{self, Added, Between, Grid, Player},
    contract::{Base, CommonModeImpedance, Effect, Facts, Parameter, Point, Record, storage_ohm},
};
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};
use num_complex::Complex64;

/// Returns a cell of 4.5 Ah with three branches.
fn base() -> Base {
    let branch = |r_ohm: f64, tau_s: f64| RcBranch {
        r_ohm,
        c_f: tau_s / r_ohm,
    };
    let erm = Erm {
        r_ohm: 6.5e-3,
        branches: vec![branch(1.5e-3, 5e-3), branch(2e-3, 0.06), branch(3e-3, 2.0)],
    };
    let soc: Vec<f64> = (0..=20).map(|k| 0.05 * f64::from(k)).collect();
    let ocv_v = soc
        .iter()
        .map(|z| 2.9 + 1.25 * z - 0.35 * (z * 5.0).sin() / 5.0 + 0.4 * (1.0 - (-12.0 * z).exp()))
        .collect();
    let facts = Facts {
        lowest_hz: Some(0.1),
        highest_hz: Some(300.0),
        longest_s: 660.0,
        shortest_s: 0.01,
        greatest_a: 100.0,
        widest_soc: 0.2,
        soc: 0.5,
        temperature_degc: 25.0,
        orders: 20.0,
        span_s: 20_000.0,
        held_out: None,
    };
    Base {
        erm,
        ocv: OcvCurve::monotone(4.5, soc, ocv_v).unwrap(),
        facts,
    }
}

/// Times and currents of a record.
struct Trace {
    time_s: Vec<f64>,
    current_a: Vec<f64>,
}

impl Trace {
    /// Each segment (A, s) sampled densely after its edge, at last every five seconds, and 10 ms
    /// before the next edge.
    fn segments(segments: &[(f64, f64)]) -> Self {
        let (mut time_s, mut current_a, mut start_s) = (Vec::new(), Vec::new(), 0.0);
        for &(current, length_s) in segments {
            let mut t: f64 = 0.0;
            while t < length_s - 1e-9 {
                time_s.push(start_s + t);
                current_a.push(current);
                let step_s = [(0.1, 0.01), (0.5, 0.05), (5.0, 0.2), (60.0, 1.0)]
                    .iter()
                    .find(|(until, _)| t < until - 1e-9)
                    .map_or(5.0, |s| s.1);
                let before_edge_s = length_s - 0.01;
                t = if t < before_edge_s - 1e-9 {
                    (t + step_s).min(before_edge_s)
                } else {
                    length_s
                };
            }
            start_s += length_s;
        }
        time_s.push(start_s);
        current_a.push(segments.last().unwrap().0);
        Self { time_s, current_a }
    }

    fn pulses() -> Self {
        let segments: Vec<_> = [10.0, -10.0, 30.0, -30.0, 100.0, -40.0]
            .iter()
            .flat_map(|i| [(*i, 5.0), (0.0, 40.0)])
            .collect();
        Self::segments(&segments)
    }

    fn block() -> Self {
        Self::segments(&[(9.0, 360.0), (0.0, 300.0)])
    }

    fn record(&self, soc: f64, order: f64) -> Record<'_> {
        let (time_s, current_a) = (&self.time_s[..], &self.current_a[..]);
        Record {
            time_s,
            current_a,
            soc,
            temperature_degc: 25.0,
            order,
            start_s: 1000.0 * order,
            is_cell: true,
            before: &[],
        }
    }
}

/// Returns the voltage of a record with one addition, or none.
fn play(added: &[Added<'_>], record: &Record<'_>, between: Between, parts: usize) -> Vec<f64> {
    let mut voltage_v = Vec::new();
    Player::default().play(
        &base(),
        added,
        record,
        &Grid::new(record.time_s, between),
        parts,
        &mut voltage_v,
    );
    voltage_v
}

/// Returns the voltage of a record with an effect of the catalogue, its current held between
/// samples.
fn with(name: &str, p: &[f64], trace: &Trace, soc: f64) -> Vec<f64> {
    let effect = super::find(name).unwrap();
    play(
        &[Added { effect, p }],
        &trace.record(soc, 0.0),
        Between::Hold,
        1,
    )
}

/// Returns the impedance of the cell with an effect, Ω.
fn seen(name: &str, p: &[f64], at: &Point) -> Complex64 {
    let added = [Added {
        effect: super::find(name).unwrap(),
        p,
    }];
    augmented::impedance(
        &augmented::network(&base(), &added),
        &base(),
        &added,
        at,
        None,
    )
}

/// Returns the impedance of the cell without any, Ω.
fn plain(at: &Point) -> Complex64 {
    base().erm.impedance(at.freq_hz) + storage_ohm(&base(), at)
}

fn point(freq_hz: f64) -> Point {
    let facts = base().facts;
    Point {
        freq_hz,
        amplitude_a: Some(0.0),
        bias_a: 0.0,
        held_s: Point::HELD_S,
        soc: facts.soc,
        temperature_degc: facts.temperature_degc,
        order: 0.0,
        start_s: 0.0,
        is_cell: true,
        common_mode: CommonModeImpedance {
            r_ohm: 0.02,
            l_h: 0.0,
        },
    }
}

/// All combinations of a strength with the starts of the other parameters.
fn settings(effect: &dyn Effect, strength: impl Fn(&Parameter) -> f64) -> Vec<Vec<f64>> {
    let parameters = effect.parameters(&base());
    let mut settings = vec![vec![strength(&parameters[0])]];
    for parameter in &parameters[1..] {
        settings = settings
            .iter()
            .flat_map(|s| {
                parameter
                    .starts
                    .iter()
                    .map(move |start| [&s[..], &[*start]].concat())
            })
            .collect();
    }
    settings
}

fn largest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter()
        .zip(b)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}
