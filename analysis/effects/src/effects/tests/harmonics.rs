//! Harmonics of the voltage against integrals over a period.

use std::f64::consts::TAU;

use super::*;
use crate::augmented::harmonics;

const AMPLITUDE_A: f64 = 8.0;

fn at(freq_hz: f64, bias_a: f64) -> Point {
    Point {
        amplitude_a: Some(AMPLITUDE_A),
        bias_a,
        ..point(freq_hz)
    }
}

fn simulated(added: &[Added<'_>], at: &Point) -> [Complex64; 2] {
    harmonics(&base(), added, at)
}

/// Harmonics of the drop that a current makes at once, Ω.
fn integrated(drop_v: impl Fn(f64) -> f64, bias_a: f64) -> [Complex64; 2] {
    let count = 20_000;
    [2, 3].map(|order| {
        let sum: Complex64 = (0..count)
            .map(|k| {
                let turn = TAU * f64::from(k) / f64::from(count);
                // Charging counts positive: the phase is that of the charge current.
                let charge_a = -bias_a + AMPLITUDE_A * turn.cos();
                drop_v(charge_a) * Complex64::cis(-f64::from(order) * turn)
            })
            .sum();
        2.0 / f64::from(count) * sum / AMPLITUDE_A
    })
}

#[test]
fn a_slow_sine_shows_the_harmonics_of_the_law_of_charge_transfer() {
    let r_ohm = base().erm.branches[0].r_ohm;
    for (name, p, alpha) in [
        ("butler_volmer", vec![0.04, 0.0], 0.5),
        ("butler_volmer_asymmetric", vec![0.2, 0.0, 0.35], 0.35),
    ] {
        let added = [Added {
            effect: super::super::find(name).unwrap(),
            p: &p,
        }];
        for bias_a in [0.0, 6.0, -6.0] {
            let beta: f64 = 0.2;
            // The voltage at which a branch conducts a discharge current, by bisection.
            let overpotential_v = |discharge_a: f64| {
                let conducted = |v: f64| {
                    let x = 2.0 * beta * v / r_ohm;
                    ((alpha * x).exp() - (-(1.0 - alpha) * x).exp()) / (2.0 * beta)
                };
                let (mut low, mut high) = (-0.2, 0.2);
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    if conducted(middle) < discharge_a {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                low
            };
            let expected = integrated(|charge_a| -overpotential_v(-charge_a), bias_a);
            // 5 ms against 10 s; the curve of the open-circuit voltage has harmonics of its own.
            let curve = simulated(&[], &at(0.1, bias_a));
            let found = simulated(&added, &at(0.1, bias_a));
            for order in [0, 1] {
                let found = found[order] - curve[order];
                assert!(
                    (found - expected[order]).norm() < 2e-6 + 0.03 * expected[order].norm(),
                    "{name} at {bias_a} A, order {}: {found} against {} Ω",
                    order + 2,
                    expected[order]
                );
            }
            let strong = expected[usize::from(bias_a == 0.0)].norm();
            assert!(strong > 1e-5, "{name} at {bias_a} A: {strong} Ω");
        }
    }
}

#[test]
fn a_linear_cell_has_the_harmonics_of_its_curve_alone() {
    let [second, third] = simulated(&[], &at(100.0, 0.0));
    assert!(
        second.norm() < 1e-9 && third.norm() < 1e-9,
        "{second} {third}"
    );
    let freq_hz = 2e-3;
    let base = base();
    let count = 20_000;
    let swing = AMPLITUDE_A / (TAU * freq_hz) / (3600.0 * base.ocv.capacity_ah);
    let expected: Complex64 = (0..count)
        .map(|k| {
            let turn = TAU * f64::from(k) / f64::from(count);
            base.ocv.voltage_v(base.facts.soc + swing * turn.sin()) * Complex64::cis(-2.0 * turn)
        })
        .sum();
    let expected = 2.0 / f64::from(count) * expected / AMPLITUDE_A;
    let [second, _] = simulated(&[], &at(freq_hz, 0.0));
    assert!(expected.norm() > 1e-5, "{expected}");
    assert!(
        (second - expected).norm() < 0.05 * expected.norm(),
        "{second} against {expected} Ω"
    );
}

/// A branch that is far slower than the periods sees the direct current alone, at which the law was
/// left for 60 s.
#[test]
fn a_slow_branch_bends_at_the_direct_current_alone() {
    let effect = super::super::find("butler_volmer").unwrap();
    let (bias_a, freq_hz) = (10.0, 40.0);
    let added = [Added {
        effect,
        p: &[0.04, 2.0],
    }];
    let branch = &base().erm.branches[2];
    // About the direct current: v'' of C·dv/dt = i − sinh(βv/R)/β, twice integrated at ω.
    let (beta, r_ohm) = (0.2, branch.r_ohm);
    let omega = TAU * freq_hz;
    let tau_s = branch.time_constant_s();
    let first = AMPLITUDE_A * r_ohm / (omega * tau_s);
    let exponent = f64::asinh(beta * bias_a);
    let curve = beta / r_ohm * exponent.sinh() / r_ohm;
    let second = 0.25 * curve * first * first * r_ohm / (2.0 * omega * tau_s) / AMPLITUDE_A;
    let [found, _] = simulated(&added, &at(freq_hz, bias_a));
    assert!(
        (found.norm() / second - 1.0).abs() < 0.1,
        "{found} against {second} Ω"
    );
}

#[test]
fn effects_of_the_bench_have_no_part() {
    let own = ("butler_volmer", vec![0.04, 0.0]);
    let added = |name: &str, p: &[f64]| {
        let all = [
            Added {
                effect: super::super::find(own.0).unwrap(),
                p: &own.1,
            },
            Added {
                effect: super::super::find(name).unwrap(),
                p,
            },
        ];
        simulated(&all, &at(30.0, 5.0))
    };
    let alone = simulated(
        &[Added {
            effect: super::super::find(own.0).unwrap(),
            p: &own.1,
        }],
        &at(30.0, 5.0),
    );
    assert_eq!(added("current_smoothing", &[0.01]), alone);
    assert_eq!(added("current_offset", &[1.0]), alone);
}
