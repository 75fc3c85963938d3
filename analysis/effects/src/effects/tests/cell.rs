//! Formulas of the cell's effects.

use super::super::charge_transfer::{Kinetics, greatest_beta, thermal_v};
use super::*;
use crate::contract::{Base, Branch, Moved, Network};
use std::f64::consts::{PI, TAU};

const PULSE_A: f64 = 50.0;

/// Returns a pulse of discharge that lasts long enough for every branch of the base, then a rest of
/// equal length.
fn long() -> Trace {
    Trace::segments(&[(PULSE_A, 60.0), (0.0, 60.0)])
}

/// Returns the voltage with an effect less voltage without, at the last sample before a time.
fn change_at(name: &str, p: &[f64], trace: &Trace, time_s: f64) -> f64 {
    let k = trace
        .time_s
        .iter()
        .rposition(|t| *t <= time_s + 1e-6)
        .unwrap();
    with(name, p, trace, 0.5)[k] - play(&[], &trace.record(0.5, 0.0), Between::Hold, 1)[k]
}

fn near(met: f64, expected: f64, tolerance: f64, what: &str) {
    assert!(
        (met - expected).abs() <= tolerance,
        "{what}: {met} against {expected}"
    );
}

/// Frequencies of the band, Hz.
fn band() -> impl Iterator<Item = f64> {
    (0..=70)
        .map(|k| 0.1 * 10f64.powf(0.05 * f64::from(k)))
        .filter(|f| *f <= 300.0)
}

#[test]
fn diffusion_is_a_hyperbolic_tangent() {
    let r_ohm = 5e-3;
    for tau_s in [0.01, 0.5, 20.0, 1000.0] {
        for freq_hz in band() {
            let root = Complex64::new(0.0, TAU * freq_hz * tau_s).sqrt();
            let tanh = if root.re > 20.0 {
                Complex64::ONE
            } else {
                root.tanh()
            };
            let error = seen("diffusion", &[r_ohm, tau_s], &point(freq_hz))
                - plain(&point(freq_hz))
                - r_ohm * tanh / root;
            assert!(
                error.norm() < 2e-3 * r_ohm,
                "{} of R at {freq_hz} Hz, τ = {tau_s} s",
                error.norm() / r_ohm
            );
        }
    }
    near(
        change_at("diffusion", &[r_ohm, 10.0], &long(), 60.0),
        -r_ohm * PULSE_A,
        1e-4,
        "diffusion's whole resistance",
    );
}

#[test]
fn semi_infinite_diffusion_follows_the_root() {
    let a = 1e-3;
    for freq_hz in band() {
        let expected = a / Complex64::new(0.0, TAU * freq_hz).sqrt();
        let met = seen("warburg", &[a], &point(freq_hz)) - plain(&point(freq_hz));
        assert!(
            (met - expected).norm() < 5e-3 * expected.norm(),
            "{met} against {expected} at {freq_hz} Hz"
        );
    }
    let trace = Trace::segments(&[(PULSE_A, 300.0)]);
    let (with, without) = (
        with("warburg", &[a], &trace, 0.9),
        play(&[], &trace.record(0.9, 0.0), Between::Hold, 1),
    );
    for (k, time_s) in trace.time_s.iter().enumerate().skip(1) {
        let expected = 2.0 * a * (time_s / PI).sqrt() * PULSE_A;
        near(
            without[k] - with[k],
            expected,
            5e-3 * expected,
            "warburg's step",
        );
    }
}

#[test]
fn a_depressed_arc_follows_cole_and_cole() {
    let erm = base().erm;
    for (k, branch) in erm.branches.iter().enumerate() {
        for strength in [1e-6, 1e-3, 0.03, 0.1, 0.2, 0.35, 0.5] {
            let p = [strength, k as f64];
            let network = augmented::network(
                &base(),
                &[Added {
                    effect: super::super::find("cpe").unwrap(),
                    p: &p,
                }],
            );
            assert!(
                network.branches.iter().all(|b| b.r_ohm >= 0.0),
                "a negative resistance at {strength}"
            );
            near(
                network.dc_resistance_ohm(),
                erm.dc_resistance_ohm(),
                1e-15,
                "the resistance at zero frequency",
            );
            for freq_hz in band() {
                let x = Complex64::new(0.0, TAU * freq_hz * branch.time_constant_s());
                let arc = branch.r_ohm / (1.0 + x.powf(1.0 - strength)) - branch.impedance(freq_hz);
                let error = (network.impedance(freq_hz) - erm.impedance(freq_hz) - arc).norm()
                    / branch.r_ohm;
                assert!(
                    error < 1.2e-3 && error < 0.05 * strength,
                    "{error} of R at {freq_hz} Hz, 1 − α = {strength}"
                );
            }
        }
    }
}

#[test]
fn kinetics_end_in_the_steady_state_of_their_law() {
    let (r_ohm, beta) = (base().erm.branches[1].r_ohm, 0.03_f64);
    let steady = r_ohm * ((beta * PULSE_A).asinh() / beta - PULSE_A);
    near(
        change_at("butler_volmer", &[beta * beta, 1.0], &long(), 60.0),
        -steady,
        1e-9,
        "sinh",
    );
    for (alpha, current_a) in [(0.3, PULSE_A), (0.3, -PULSE_A), (0.7, PULSE_A)] {
        let trace = Trace::segments(&[(current_a, 60.0)]);
        let v = r_ohm * current_a
            - change_at(
                "butler_volmer_asymmetric",
                &[beta, 1.0, alpha],
                &trace,
                60.0,
            );
        let y = 2.0 * beta * v / r_ohm;
        near(
            ((alpha * y).exp() - (-(1.0 - alpha) * y).exp()) / (2.0 * beta),
            current_a,
            1e-6,
            "two exponentials",
        );
    }
    near(
        greatest_beta(&base()),
        3.0 * 3e-3 / (2.0 * thermal_v(25.0)),
        1e-15,
        "three times R/2V_T of the largest branch",
    );
    near(thermal_v(25.0), 25.69e-3, 5e-6, "kT/e");
}

/// A sine of 20 A about 15 A through the law in time, by the branch's own steps.
#[test]
fn a_sweep_sees_the_describing_function() {
    let (freq_hz, periods, per_period) = (2.0, 4, 2000);
    let (amplitude_a, bias_a) = (20.0, 15.0);
    let time_s: Vec<f64> = (0..periods * per_period)
        .map(|k| f64::from(k) / f64::from(per_period) / freq_hz)
        .collect();
    let current_a = time_s
        .iter()
        .map(|t| bias_a + amplitude_a * (TAU * freq_hz * t).cos())
        .collect();
    let trace = Trace { time_s, current_a };
    let at = Point {
        amplitude_a: Some(amplitude_a),
        bias_a,
        ..point(freq_hz)
    };
    for (name, p) in [
        ("butler_volmer", vec![9e-4, 1.0]),
        ("butler_volmer_asymmetric", vec![0.03, 1.0, 0.35]),
    ] {
        let record = trace.record(0.5, 0.0);
        let added = [Added {
            effect: super::super::find(name).unwrap(),
            p: &p,
        }];
        let (with, without) = (
            play(&added, &record, Between::Linear, 1),
            play(&[], &record, Between::Linear, 1),
        );
        let sum: Complex64 = (trace.time_s.len() - per_period as usize..trace.time_s.len())
            .map(|k| (without[k] - with[k]) * Complex64::cis(-TAU * freq_hz * trace.time_s[k]))
            .sum();
        let met = sum * 2.0 / f64::from(per_period) / amplitude_a;
        let expected = seen(name, &p, &at) - plain(&at);
        assert!(expected.norm() > 1e-4, "{name}: an effect of {expected} Ω");
        assert!(
            (met - expected).norm() < 0.05 * expected.norm(),
            "{name}: {met} against {expected} Ω"
        );
    }
    let small = Point {
        amplitude_a: None,
        ..point(1.0)
    };
    let change = Kinetics {
        beta: 0.03,
        alpha: 0.35,
    }
    .change_ohm(&base(), 1, &small);
    assert!(
        change.norm() < 1e-15,
        "without amplitude and bias nothing is seen: {change}"
    );
}

#[test]
fn the_open_circuit_voltage_moves_as_stated() {
    let (ocv, moved) = (base().ocv, PULSE_A * 60.0 / (3600.0 * 4.5));
    let (start, end) = (0.5, 0.5 - moved);
    let trace = long();
    let rest = |name: &str, p: &[f64]| change_at(name, p, &trace, 120.0);
    near(
        rest("ocv_slope", &[0.1]),
        ocv.voltage_v(start - 1.1 * moved) - ocv.voltage_v(end),
        1e-9,
        "capacity",
    );
    near(
        rest("ocv_curvature", &[2.0]),
        moved * moved,
        1e-9,
        "curvature",
    );
    near(
        rest("hysteresis", &[0.02, 500.0, 0.0, 0.0]),
        -0.02,
        1e-6,
        "hysteresis in full",
    );
    near(
        rest("hysteresis", &[0.02, 10.0, 0.0, 0.0]),
        -0.02 * -(-10.0 * moved).exp_m1(),
        1e-9,
        "hysteresis on the way",
    );
    near(
        change_at("hysteresis", &[0.02, 10.0, 0.0, 0.0], &trace, 60.0),
        rest("hysteresis", &[0.02, 10.0, 0.0, 0.0]),
        1e-12,
        "rest does not remove it",
    );
    let leak_a = 0.5;
    let leaked = leak_a * 120.0 / (3600.0 * 4.5);
    near(
        rest("self_discharge", &[leak_a]),
        ocv.voltage_v(end - leaked) - ocv.voltage_v(end),
        1e-9,
        "leak",
    );
    let back = Trace::segments(&[(PULSE_A, 30.0), (-PULSE_A, 30.0)]);
    let half = -(-5.0 * moved).exp_m1();
    near(
        change_at("hysteresis", &[0.02, 10.0, 0.0, 0.0], &back, 60.0),
        0.02 * half * half,
        1e-9,
        "reversal",
    );
}

#[test]
fn the_surface_is_emptied_before_the_middle() {
    let (d, tau_s, ocv) = (1e-3, 30.0, base().ocv);
    let end = 0.5 - PULSE_A * 60.0 / (3600.0 * 4.5);
    let expected = ocv.voltage_v(end - d * PULSE_A) - ocv.voltage_v(end);
    near(
        change_at("surface_soc", &[d, tau_s], &long(), 60.0),
        expected,
        1e-7,
        "steady gradient",
    );
    for freq_hz in band() {
        let s = Complex64::new(0.0, TAU * freq_hz * tau_s);
        let expected = 3.0 * d * ocv.slope_v(0.7) * (1.0 / (s.sqrt().tanh() * s.sqrt()) - 1.0 / s);
        let at = Point {
            soc: 0.7,
            ..point(freq_hz)
        };
        let met = seen("surface_soc", &[d, tau_s], &at) - plain(&at);
        assert!(
            (met - expected).norm() < 1e-3 * d * ocv.slope_v(0.7),
            "{met} against {expected} at {freq_hz} Hz"
        );
    }
}

#[test]
fn resistances_are_multiplied_where_they_should_be() {
    let Base { erm, facts, .. } = base();
    let edge = |name: &str, p: &[f64], current_a: f64, soc: f64| {
        let trace = Trace::segments(&[(current_a, 1.0)]);
        (play(&[], &trace.record(soc, 0.0), Between::Hold, 1)[0] - with(name, p, &trace, soc)[0])
            / current_a
            / erm.r_ohm
    };
    near(
        edge("soc_resistance", &[0.4], 10.0, 0.8),
        0.4 * (0.8 - facts.soc),
        1e-12,
        "at another state of charge",
    );
    near(
        edge("current_asymmetry", &[0.1], -10.0, 0.5),
        0.1,
        1e-12,
        "under charge",
    );
    near(
        edge("current_asymmetry", &[0.1], 10.0, 0.5),
        0.0,
        1e-12,
        "under discharge",
    );
    let trace = long();
    let end = change_at(
        "current_asymmetry",
        &[0.1],
        &Trace::segments(&[(-PULSE_A, 60.0)]),
        60.0,
    );
    near(
        end,
        0.1 * PULSE_A * erm.dc_resistance_ohm(),
        1e-9,
        "all of the resistances",
    );
    let effect = super::super::find("ageing").unwrap();
    let late = trace.record(0.5, facts.orders);
    let k = trace
        .time_s
        .iter()
        .rposition(|t| *t <= 60.0 - 1e-9)
        .unwrap();
    let aged = play(
        &[Added {
            effect,
            p: &[0.2, 0.0],
        }],
        &late,
        Between::Hold,
        1,
    )[k] - play(&[], &late, Between::Hold, 1)[k];
    near(
        aged,
        -0.2 * PULSE_A * erm.dc_resistance_ohm(),
        1e-9,
        "at the campaign's end",
    );
    let slow = |name: &str, p: &[f64], at: Point| {
        seen(
            name,
            p,
            &Point {
                freq_hz: 1e-6,
                ..at
            },
        )
        .re / erm.dc_resistance_ohm()
            - 1.0
    };
    near(
        slow(
            "ageing",
            &[0.2, 0.0],
            Point {
                order: 10.0,
                ..point(1.0)
            },
        ),
        0.1,
        1e-6,
        "a sweep in the middle of the campaign",
    );
    near(
        slow(
            "ageing",
            &[0.2, 1.0],
            Point {
                start_s: 5000.0,
                ..point(1.0)
            },
        ),
        0.05,
        1e-6,
        "a point a quarter of the time later",
    );
    let by_time = Record {
        start_s: 5000.0,
        ..trace.record(0.5, 0.0)
    };
    let aged = play(
        &[Added {
            effect,
            p: &[0.2, 1.0],
        }],
        &by_time,
        Between::Hold,
        1,
    )[k] - play(&[], &by_time, Between::Hold, 1)[k];
    let expected = -0.2 * 5000.0 / facts.span_s * PULSE_A * erm.dc_resistance_ohm();
    near(
        aged,
        expected,
        0.02 * expected.abs(),
        "and on within a record",
    );
    assert!((aged / expected - 1.0).abs() > 1e-3, "60 s more are more");
    near(
        slow(
            "soc_resistance",
            &[0.4],
            Point {
                soc: 0.8,
                ..point(1.0)
            },
        ),
        0.12,
        1e-6,
        "a sweep at another state of charge",
    );
    for (bias_a, part) in [(-2.0, 1.0), (-1.0, 1.0), (0.0, 0.5), (1.0, 0.0), (2.0, 0.0)] {
        let at = Point {
            bias_a,
            amplitude_a: Some(1.0),
            ..point(1.0)
        };
        near(
            slow("current_asymmetry", &[0.1], at),
            0.1 * part,
            1e-6,
            "a sweep under direct current",
        );
    }
}

#[test]
fn salt_runs_out_faster_than_in_proportion() {
    let (g, tau_s) = (0.01, 8.0);
    let volt = 2.0 * thermal_v(25.0) * (1.0 - 0.38);
    let trace = long();
    for time_s in [0.5, 4.9, 50.1_f64] {
        let missing = g * PULSE_A * -(-time_s / tau_s).exp_m1();
        near(
            change_at("electrolyte_depletion", &[g, tau_s], &trace, time_s),
            volt * (1.0 - missing).ln(),
            1e-9,
            "ln(1 − c)",
        );
    }
}

/// Heat of the base's own resistance, and of the reaction, into a cell that cools.
#[test]
fn the_cell_warms_and_cools_by_its_balance() {
    let (du_dt, heat_capacity) = (1e-4, 66.5);
    let trace = Trace::segments(&[(PULSE_A, 600.0)]);
    let k = trace.time_s.len() - 1;
    let effect = super::super::find("entropic_heat").unwrap();
    let p = [du_dt, heat_capacity, 600.0];
    let (mut rise_k, mut heat) = (0.0, 0.0);
    let erm = base().erm;
    let step_s = 1e-3;
    for n in 0..600_000 {
        let time_s = (f64::from(n) + 0.5) * step_s;
        if n % 100 == 0 {
            // In a branch only what its resistor conducts is heat; the rest charges its
            // capacitance.
            let conducted_a = |b: &analysis_model::model::RcBranch| {
                -PULSE_A * (-time_s / b.time_constant_s()).exp_m1()
            };
            heat = PULSE_A * PULSE_A * erm.r_ohm
                + erm
                    .branches
                    .iter()
                    .map(|b| b.r_ohm * conducted_a(b).powi(2))
                    .sum::<f64>();
        }
        rise_k += step_s
            * ((heat - PULSE_A * (298.15 + rise_k) * du_dt) / heat_capacity - rise_k / 600.0);
    }
    let record = trace.record(0.9, 0.0);
    let met = play(&[Added { effect, p: &p }], &record, Between::Hold, 1)[k]
        - play(&[], &record, Between::Hold, 1)[k];
    near(
        met,
        du_dt * rise_k,
        2e-3 * du_dt * rise_k,
        &format!("{rise_k} K under {heat} W"),
    );
}

/// The state at the start follows from that of the first record and the charge since then. The
/// state of charge there, read from a voltage that contained it, is corrected.
#[test]
fn a_hysteresis_is_carried_from_record_to_record() {
    let (m_v, gamma, first) = (0.02, 10.0, 0.6);
    let (capacity_coulomb, soc) = (3600.0 * 4.5, 0.5);
    let before = [
        Moved::one_way(800.0),
        Moved {
            charge_coulomb: 0.0,
            through_coulomb: 500.0,
        },
        Moved::one_way(-300.0),
    ];
    // Up by 800 C towards 1, worn by 500 C of swings, down by 300 C towards −1, and the record's
    // own charge, all out.
    let towards = |h: f64, end: f64, charge_coulomb: f64| {
        end + (h - end) * (-gamma * charge_coulomb / capacity_coulomb).exp()
    };
    let start = towards(towards(towards(first, 1.0, 800.0), 0.0, 500.0), -1.0, 300.0);
    let moved_coulomb = PULSE_A * 60.0;
    let end = towards(start, -1.0, moved_coulomb);
    let (trace, ocv) = (long(), base().ocv);
    let record = Record {
        before: &before,
        ..trace.record(soc, 0.0)
    };
    let p = [m_v, gamma, 1.0, first];
    let added = [Added {
        effect: super::super::find("hysteresis").unwrap(),
        p: &p,
    }];
    let (with, without) = (
        play(&added, &record, Between::Hold, 1),
        play(&[], &record, Between::Hold, 1),
    );
    let off = m_v * start / ocv.slope_v(soc);
    let expected = m_v * (end - start)
        + (ocv.slope_v(soc) - ocv.slope_v(soc - moved_coulomb / capacity_coulomb)) * off;
    let last = with.len() - 1;
    near(with[last] - without[last], expected, 1e-9, "carried");
    assert!(
        (with[0] - without[0]).abs() < 1e-12 && expected.abs() > 1e-3 && off.abs() > 1e-4,
        "{expected} {off}"
    );
    // Each record starts from the middle: the charge before it has no effect.
    let p = [m_v, gamma, 0.0, first];
    let added = [Added {
        effect: super::super::find("hysteresis").unwrap(),
        p: &p,
    }];
    let by_itself = play(&added, &record, Between::Hold, 1);
    near(
        by_itself[last] - without[last],
        m_v * towards(0.0, -1.0, moved_coulomb),
        1e-9,
        "by itself",
    );
}

/// Part of a step response of diffusion into spheres that the finite-length formula leaves, at its
/// best strength and time constant: root mean square over the logarithm of the time.
fn left_of_spheres(decades: i32) -> f64 {
    let diffusion = super::super::find("diffusion").unwrap();
    let base = super::base();
    // Crank, The Mathematics of Diffusion, 6.3: tan λ = λ has one root in each (kπ, (k + ½)π).
    let roots: Vec<f64> = (1..300)
        .map(|k| {
            let (mut low, mut high) = (f64::from(k) * PI, (f64::from(k) + 0.5) * PI);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                let (sin, cos) = middle.sin_cos();
                // sin − λ·cos has the sign of tan − λ, without its pole.
                if (sin - middle * cos) * cos.signum() < 0.0 {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            low
        })
        .collect();
    let times: Vec<f64> = (0..=200)
        .map(|k| 10f64.powf(1.0 - f64::from(decades) * (1.0 - f64::from(k) / 200.0)))
        .collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let sphere: Vec<f64> = times
        .iter()
        .map(|t| {
            let term = |l: &f64| 2.0 / (l * l) * (1.0 - (-l * l * t).exp());
            roots.iter().map(term).sum()
        })
        .collect();
    let size = dot(&sphere, &sphere);
    (-30..=0)
        .map(|k| {
            let tau_s = 10f64.powf(f64::from(k) / 20.0);
            let mut network = Network::of(&base.erm);
            let own = network.branches.len();
            diffusion.network(&[1.0, tau_s], &base, &mut network);
            let branches = &network.branches[own..];
            let formula: Vec<f64> = times
                .iter()
                .map(|t| {
                    let term = |b: &Branch| b.r_ohm * (1.0 - (-t / b.tau_s).exp());
                    branches.iter().map(term).sum()
                })
                .collect();
            let along = dot(&sphere, &formula);
            (1.0 - along * along / (size * dot(&formula, &formula))).sqrt()
        })
        .fold(f64::INFINITY, f64::min)
}

/// The source of the diagnosis' `FORMULA_SHARE`: the residual of a cell with spherical particles
/// under the formula for a layer.
#[test]
fn a_layer_leaves_three_percent_of_spheres() {
    let [three, four] = [3, 4].map(left_of_spheres);
    assert!(
        (0.020..0.026).contains(&three) && (0.032..0.038).contains(&four),
        "{three} {four}"
    );
}

/// Six periods of a sine on a direct current that has warmed the cell for ten minutes.
#[test]
fn a_direct_current_warms_the_cell_of_a_sweep() {
    let (freq_hz, amplitude_a, bias_a, held_s) = (0.5, 1.0, 20.0, 600.0);
    let p = [0.01, 900.0];
    let mut time_s: Vec<f64> = (0..600).map(f64::from).collect();
    let mut current_a = vec![bias_a; time_s.len()];
    let per_period = 400;
    for k in 0..6 * per_period {
        let since_s = f64::from(k) / f64::from(per_period) / freq_hz;
        time_s.push(held_s + since_s);
        current_a.push(bias_a + amplitude_a * (TAU * freq_hz * since_s).cos());
    }
    let trace = Trace { time_s, current_a };
    let record = trace.record(0.9, 0.0);
    let added = [Added {
        effect: super::super::find("self_heating").unwrap(),
        p: &p,
    }];
    let (with, without) = (
        play(&added, &record, Between::Linear, 1),
        play(&[], &record, Between::Linear, 1),
    );
    // Whole periods at the end, without the slow course.
    let first = trace.time_s.len() - 4 * per_period as usize;
    let count = trace.time_s.len() - first;
    let bent: Vec<f64> = (first..trace.time_s.len())
        .map(|k| without[k] - with[k])
        .collect();
    let slope = (bent[count - 1] - bent[count - 1 - 2 * per_period as usize])
        / (2.0 * f64::from(per_period));
    let sum: Complex64 = bent
        .iter()
        .enumerate()
        .map(|(k, v)| {
            (v - slope * k as f64)
                * Complex64::cis(-TAU * freq_hz * (trace.time_s[first + k] - held_s))
        })
        .sum();
    let met = 2.0 / count as f64 * sum / amplitude_a;
    let at = Point {
        amplitude_a: Some(amplitude_a),
        bias_a,
        held_s: held_s + 8.0,
        ..point(freq_hz)
    };
    let expected = seen("self_heating", &p, &at) - plain(&at);
    assert!(expected.norm() > 1e-4, "{expected} Ω");
    assert!(
        (met - expected).norm() < 0.1 * expected.norm(),
        "{met} against {expected} Ω"
    );
}
