//! The formulas of the bench's effects.

use crate::{
    augmented::{Added, Between, Grid, Player, impedance, network},
    contract::{
        Base, CommonModeImpedance, Effect, Facts, Group, Point, Record, Scale, storage_ohm,
    },
    effects::{catalogue, find},
};
use analysis_model::{
    model::{Erm, RcBranch},
    ocv::OcvCurve,
};
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Impedance between every swept object and the ground of the channels.
const COMMON_MODE: CommonModeImpedance = CommonModeImpedance {
    r_ohm: 0.08,
    l_h: 1e-6,
};

fn base() -> Base {
    let branch = |r_ohm: f64, tau_s: f64| RcBranch {
        r_ohm,
        c_f: tau_s / r_ohm,
    };
    let erm = Erm {
        r_ohm: 6e-3,
        branches: vec![branch(2e-3, 3e-3), branch(3e-3, 4.0)],
    };
    let ocv = OcvCurve::monotone(4.5, vec![0.0, 0.5, 1.0], vec![3.0, 3.7, 4.2]).unwrap();
    let facts = Facts {
        lowest_hz: Some(0.1),
        highest_hz: Some(300.0),
        longest_s: 40.0,
        shortest_s: 0.1,
        greatest_a: 40.0,
        widest_soc: 0.02,
        soc: 0.5,
        temperature_degc: 25.0,
        orders: 5.0,
        span_s: 3600.0,
        held_out: None,
    };
    Base { erm, ocv, facts }
}

/// Irregular times; a pulse of 40 A, a step back to −10 A, rest.
fn samples() -> (Vec<f64>, Vec<f64>) {
    let mut time_s = vec![0.0];
    for k in 0..200 {
        time_s.push(time_s[k] + if k % 3 == 0 { 0.3 } else { 0.1 });
    }
    let current_a = time_s
        .iter()
        .map(|t| {
            if *t < 1.0 {
                0.0
            } else if *t < 15.0 {
                40.0
            } else if *t < 20.0 {
                -10.0
            } else {
                0.0
            }
        })
        .collect();
    (time_s, current_a)
}

fn record<'a>((time_s, current_a): (&'a [f64], &'a [f64]), is_cell: bool) -> Record<'a> {
    Record {
        time_s,
        current_a,
        soc: 0.5,
        temperature_degc: 25.0,
        order: 2.0,
        start_s: 600.0,
        is_cell,
        before: &[],
    }
}

fn point(freq_hz: f64, is_cell: bool) -> Point {
    Point {
        freq_hz,
        amplitude_a: Some(1.0),
        bias_a: 0.0,
        held_s: Point::HELD_S,
        soc: 0.5,
        temperature_degc: 25.0,
        order: 0.0,
        start_s: 0.0,
        is_cell,
        common_mode: COMMON_MODE,
    }
}

fn play(added: &[Added<'_>], is_cell: bool) -> Vec<f64> {
    let (time_s, current_a) = samples();
    let grid = Grid::new(&time_s, Between::Hold);
    let mut voltage_v = Vec::new();
    Player::default().play(
        &base(),
        added,
        &record((&time_s, &current_a), is_cell),
        &grid,
        1,
        &mut voltage_v,
    );
    voltage_v
}

fn bench() -> impl Iterator<Item = &'static dyn Effect> {
    catalogue()
        .iter()
        .copied()
        .filter(|e| e.card().group == Group::Bench)
}

/// Returns the values of the parameters with this strength, shapes at their first start.
fn at_strength(effect: &dyn Effect, strength: f64) -> Vec<f64> {
    let parameters = effect.parameters(&base());
    std::iter::once(strength)
        .chain(parameters.iter().skip(1).map(|p| p.starts[0]))
        .collect()
}

fn effect(name: &str) -> &'static dyn Effect {
    find(name).unwrap_or_else(|| panic!("{name} is in the catalogue"))
}

#[test]
fn fourteen_effects_of_the_bench_have_names_of_their_own() {
    let names: std::collections::BTreeSet<&str> = bench().map(|e| e.card().name).collect();
    assert_eq!((names.len(), bench().count()), (14, 14), "{names:?}");
}

#[test]
fn strength_zero_is_absence_to_the_last_bit() {
    let plain = play(&[], true);
    let z = network(&base(), &[]).impedance(123.0) + storage_ohm(&base(), &point(123.0, true));
    for e in bench() {
        let p = at_strength(e, 0.0);
        let added = [Added { effect: e, p: &p }];
        assert_eq!(play(&added, true), plain, "{}", e.card().name);
        for is_cell in [true, false] {
            let met = impedance(
                &network(&base(), &added),
                &base(),
                &added,
                &point(123.0, is_cell),
                None,
            );
            assert_eq!(met, z, "{}", e.card().name);
        }
    }
}

#[test]
fn each_is_felt_and_its_effect_is_proportional_to_a_small_strength() {
    for e in bench() {
        let name = e.card().name;
        let strength = &e.parameters(&base())[0];
        assert_eq!(strength.scale, Scale::Linear, "{name}");
        assert!(
            strength.range.lower <= 0.0 && strength.range.upper > 0.0 && strength.typical > 0.0,
            "{name}"
        );
        let moved = |s: f64| -> Vec<f64> {
            let p = at_strength(e, s);
            let added = [Added { effect: e, p: &p }];
            let z: Complex64 = impedance(
                &network(&base(), &added),
                &base(),
                &added,
                &point(300.0, true),
                None,
            );
            play(&added, true).into_iter().chain([z.re, z.im]).collect()
        };
        let (none, once, twice) = (
            moved(0.0),
            moved(1e-3 * strength.typical),
            moved(2e-3 * strength.typical),
        );
        let largest = none
            .iter()
            .zip(&once)
            .fold(0.0, |m: f64, (a, b)| m.max((a - b).abs()));
        assert!(largest > 0.0, "{name} does nothing");
        for ((a, b), c) in none.iter().zip(&once).zip(&twice) {
            assert!(
                (c - a - 2.0 * (b - a)).abs() < 2e-3 * largest + 1e-13,
                "{name}: {a}, {b}, {c}"
            );
        }
    }
}

#[test]
fn effects_that_the_data_cannot_show_have_no_parameters() {
    let spectra = {
        let mut b = base();
        (b.facts.longest_s, b.facts.shortest_s, b.facts.greatest_a) = (0.0, f64::INFINITY, 0.0);
        b
    };
    let records = {
        let mut b = base();
        (b.facts.lowest_hz, b.facts.highest_hz) = (None, None);
        b
    };
    let with = |base: &Base| -> Vec<&str> {
        bench()
            .filter(|e| !e.parameters(base).is_empty())
            .map(|e| e.card().name)
            .collect()
    };
    assert_eq!(
        with(&spectra),
        [
            "inductance",
            "inductance_lossy",
            "time_skew",
            "channel_bandwidth"
        ]
    );
    assert_eq!(
        with(&records),
        [
            "channel_bandwidth",
            "current_smoothing",
            "common_gain",
            "current_offset",
            "shunt_heating",
            "thermal_emf",
            "insufficient_rest",
            "clock_error"
        ]
    );
}

#[test]
fn impedances_follow_their_formulas() {
    let f = 200.0;
    let (z, jw) = (Complex64::new(9e-3, -1e-3), Complex64::new(0.0, TAU * f));
    let w0 = TAU * 1000.0;
    let common_mode = COMMON_MODE.r_ohm + jw * COMMON_MODE.l_h;
    let late =
        |z: Complex64, common_mode: Complex64| (z + common_mode) * (jw * 3e-6).exp() - common_mode;
    let cases: [(&str, Vec<f64>, Complex64, Complex64); 7] = [
        ("inductance", vec![2e-7], z + jw * 2e-7, z),
        (
            "inductance_lossy",
            vec![2e-7, 0.6],
            z + w0 * 2e-7 * (0.6 * (jw / w0).ln()).exp(),
            z,
        ),
        (
            "time_skew",
            vec![-3e-6, 0.0],
            z * (jw * 3e-6).exp(),
            z * (jw * 3e-6).exp(),
        ),
        // One channel of two, and what lies below the cell: on a control alike.
        (
            "time_skew",
            vec![-3e-6, 1.0],
            late(z, common_mode),
            late(z, common_mode),
        ),
        (
            "time_skew",
            vec![-3e-6, 2.0],
            z - late(Complex64::ZERO, common_mode),
            z - late(Complex64::ZERO, common_mode),
        ),
        (
            "channel_bandwidth",
            vec![1e-4],
            z / (1.0 + jw * 1e-4),
            z / (1.0 + jw * 1e-4),
        ),
        ("contact_resistance", vec![4e-4], z + 4e-4, z),
    ];
    for (name, p, cell, control) in cases {
        for (is_cell, expected) in [(true, cell), (false, control)] {
            let met = effect(name).impedance(&p, &base(), &point(f, is_cell), z);
            assert!(
                (met - expected).norm() < 1e-15,
                "{name}, cell {is_cell}: {met} against {expected}"
            );
        }
    }
    // A lossy coil raises the real part as well, and without losses it is the plain one.
    let lossy =
        effect("inductance_lossy").impedance(&[2e-7, 0.999_999], &base(), &point(f, true), z);
    assert!((lossy - z - jw * 2e-7).norm() < 1e-9, "{lossy}");
}

#[test]
fn smoothing_that_was_put_in_is_taken_out() {
    let (time_s, held_a) = samples();
    let tau_s = 1.7;
    // Mean over each interval of a first-order filter's response to a held current, in small steps.
    let mut state_a = held_a[0];
    let logged_a: Vec<f64> = (0..time_s.len())
        .map(|k| {
            let step_s = time_s.get(k + 1).map_or(1.0, |next| next - time_s[k]);
            let count = 20_000;
            let decay = (-step_s / (tau_s * f64::from(count))).exp();
            let mut sum_a = 0.0;
            for _ in 0..count {
                let before_a = state_a;
                state_a = held_a[k] + (state_a - held_a[k]) * decay;
                sum_a += 0.5 * (before_a + state_a);
            }
            sum_a / f64::from(count)
        })
        .collect();
    let mut met_a = logged_a.clone();
    effect("current_smoothing").current(&[tau_s], &record((&time_s, &logged_a), true), &mut met_a);
    // The last sample has no interval.
    for k in 0..time_s.len() - 1 {
        assert!(
            (met_a[k] - held_a[k]).abs() < 1e-3,
            "{} s: {} A against {} A",
            time_s[k],
            met_a[k],
            held_a[k]
        );
    }
}

#[test]
fn a_warm_shunt_reads_wrong_by_the_averaged_square() {
    let time_s: Vec<f64> = (0..400).map(|k| 0.1 * f64::from(k)).collect();
    let logged_a: Vec<f64> = time_s
        .iter()
        .map(|t| 30.0 * (1.0 + 2e-5 * 900.0 * (1.0 - (-t / 5.0).exp())))
        .collect();
    let mut met_a = logged_a.clone();
    effect("shunt_heating").current(
        &[2e-5, 5.0],
        &record((&time_s, &logged_a), true),
        &mut met_a,
    );
    for (t, i) in time_s.iter().zip(&met_a) {
        assert!((i - 30.0).abs() < 1e-12, "{t} s: {i} A against 30 A");
    }
}

#[test]
fn currents_and_voltages_follow_their_formulas() {
    let (time_s, current_a) = samples();
    let r = record((&time_s, &current_a), true);
    let mut met_a = current_a.clone();
    effect("current_gain").current(&[0.02], &r, &mut met_a);
    assert!(
        met_a
            .iter()
            .zip(&current_a)
            .all(|(met, i)| (met - 1.02 * i).abs() < 1e-12)
    );
    let flat = vec![3.7; time_s.len()];
    let through = |name: &str, p: &[f64], is_cell: bool| {
        let mut v = flat.clone();
        effect(name).voltage(p, &record((&time_s, &current_a), is_cell), &mut v);
        v
    };
    for (k, t) in time_s.iter().enumerate() {
        assert!((through("thermal_emf", &[1e-5], false)[k] - 3.7 - 1e-5 * t).abs() < 1e-14);
        assert!(
            (through("insufficient_rest", &[5e-3, 9.0], true)[k] - 3.7 - 5e-3 * (-t / 9.0).exp())
                .abs()
                < 1e-14
        );
    }
    assert_eq!(through("insufficient_rest", &[5e-3, 9.0], false), flat);
    let mut v = vec![3.7, 3.5, 3.9];
    effect("voltage_gain").voltage(&[0.1], &r, &mut v);
    assert!(
        (v[0] - 3.7).abs() < 1e-14 && (v[1] - 3.48).abs() < 1e-14 && (v[2] - 3.92).abs() < 1e-14,
        "{v:?}"
    );
}

#[test]
fn a_slow_voltage_channel_lags_a_ramp_by_its_time_constant() {
    let (time_s, current_a) = samples();
    let mut v: Vec<f64> = time_s.iter().map(|t| 3.0 + 0.01 * t).collect();
    effect("channel_bandwidth").voltage(&[0.25], &record((&time_s, &current_a), false), &mut v);
    for (t, met) in time_s.iter().zip(&v) {
        let expected = 3.0 + 0.01 * (t - 0.25 * (1.0 - (-t / 0.25).exp()));
        assert!(
            (met - expected).abs() < 1e-13,
            "{t} s: {met} V against {expected} V"
        );
    }
}

#[test]
fn a_fast_clock_is_a_record_with_longer_seconds() {
    let (time_s, current_a) = samples();
    let p = [0.05];
    let met = play(
        &[Added {
            effect: effect("clock_error"),
            p: &p,
        }],
        true,
    );
    let true_s: Vec<f64> = time_s.iter().map(|t| 1.05 * t).collect();
    let mut expected = Vec::new();
    Player::default().play(
        &base(),
        &[],
        &record((&true_s, &current_a), true),
        &Grid::new(&true_s, Between::Hold),
        1,
        &mut expected,
    );
    for (a, b) in met.iter().zip(&expected) {
        assert!((a - b).abs() < 1e-12, "{a} V against {b} V");
    }
}
