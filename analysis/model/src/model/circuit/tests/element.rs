//! Impedances and derivatives of elements and circuits.

use crate::model::{Circuit, ElementKind, Erm, RcBranch, Role};
use num_complex::Complex64;
use proptest::prelude::*;
use std::f64::consts::{PI, TAU};

fn z(circuit: &str, parameters: &[f64], freq_hz: f64) -> Complex64 {
    circuit
        .parse::<Circuit>()
        .unwrap()
        .impedance(parameters, freq_hz)
}

fn close(met: Complex64, expected: Complex64, relative: f64, what: &str) {
    assert!(
        (met - expected).norm() <= relative * expected.norm(),
        "{what}: expected {expected}, met {met}"
    );
}

/// impedance.py's own test values: parameters 0.1, 0.2, 0.3 at 0.001, 1 and 1000 Hz, printed with 6
/// to 15 digits.
#[test]
fn elements_have_the_published_values_of_impedance_py() {
    let c = Complex64::new;
    let published: [(&str, [Complex64; 3]); 10] = [
        ("R0", [c(0.1, 0.0); 3]),
        (
            "C0",
            [
                c(0.0, -1_591.549_430_918_953_2),
                c(0.0, -1.591_549_430_918_953_5),
                c(0.0, -0.001_591_549_430_918_953_3),
            ],
        ),
        (
            "L0",
            [c(0.0, 0.000_628_319), c(0.0, 0.628_319), c(0.0, 628.319)],
        ),
        (
            "W0",
            [
                c(1.261_566_26, -1.261_566_26),
                c(0.039_894_23, -0.039_894_23),
                c(0.001_261_57, -0.001_261_57),
            ],
        ),
        (
            "Wo0",
            [
                c(0.033_333_332_999_112_786, -79.577_474_338_474_42),
                c(0.033_004_370_466_736_35, -0.082_328_667_858_703_96),
                c(0.001_994_711_402_007_163_4, -0.001_994_711_402_007_163_4),
            ],
        ),
        (
            "Ws0",
            [
                c(0.099_999_98, -4.188_789_13e-05),
                c(0.083_275_19, -3.338_381_67e-02),
                c(0.001_994_71, -1.994_711_40e-03),
            ],
        ),
        (
            "CPE0",
            [
                c(26.216_236_841_407_248, -8.518_171_710_879_97),
                c(6.585_220_960_717_244, -2.139_667_994_182_814),
                c(1.654_132_717_971_812_6, -0.537_460_300_252_313),
            ],
        ),
        (
            "G0",
            [
                c(0.099_999_940_782_441_79, -0.000_062_831_791_059_319_61),
                c(0.071_077_550_219_413_57, -0.034_274_652_117_880_68),
                c(0.001_995_504_598_455_28, -0.001_993_917_258_185_170_7),
            ],
        ),
        (
            "Gs0",
            [
                c(0.343_273_316_653_313_4, -0.000_418_952_481_935_327_04),
                c(0.139_181_931_452_773_2, -0.162_484_667_876_379_72),
                c(0.001_995_502_959_888_788, -0.001_993_917_075_845_743_7),
            ],
        ),
        (
            "K0",
            [
                c(0.099_999_842_086_579, -0.000_125_663_507_704),
                c(0.038_772_663_673_915, -0.048_723_166_143_232),
                c(6.332_569_967_499_333e-08, -7.957_742_115_295_703e-05),
            ],
        ),
    ];
    for (element, values) in published {
        let count = element.parse::<Circuit>().unwrap().parameter_names().len();
        for (freq_hz, value) in [0.001, 1.0, 1000.0].into_iter().zip(values) {
            close(
                z(element, &[0.1, 0.2, 0.3][..count], freq_hz),
                value,
                3e-6,
                &format!("{element} at {freq_hz} Hz"),
            );
        }
    }
}

/// tanh(√x)/√x by Lambert's continued fraction, without any exponential or root.
fn tanh_fraction(x: Complex64) -> Complex64 {
    let tail = (1..400)
        .rev()
        .fold(Complex64::ZERO, |tail, k| x / (f64::from(2 * k + 1) + tail));
    (1.0 + tail).inv()
}

#[test]
fn elements_agree_with_other_formulas() {
    for k in 0..60 {
        let freq_hz = 1e-5 * 10f64.powf(f64::from(k) * 0.15);
        let (w, s) = (TAU * freq_hz, Complex64::new(0.0, TAU * freq_hz));
        let real = |re: f64, im: f64| Complex64::new(re, im);
        let v = (w * 0.3f64).powf(0.8);
        let (vr, vi) = (1.0 + v * (0.4 * PI).cos(), v * (0.4 * PI).sin());
        let x = s * 0.7;
        let y = 0.5 * 0.5 * (1.0 + s * 0.7);
        let cases = [
            (
                "CPE1",
                vec![2.0, 0.7],
                real((0.35 * PI).cos(), -(0.35 * PI).sin()) / (2.0 * w.powf(0.7)),
            ),
            (
                "La1",
                vec![2.0, 0.7],
                real((0.35 * PI).cos(), (0.35 * PI).sin()) * (2.0 * w.powf(0.7)),
            ),
            (
                "Zarc1",
                vec![5.0, 0.3, 0.8],
                real(vr, -vi) * (5.0 / (vr * vr + vi * vi)),
            ),
            ("Ws1", vec![5.0, 0.7], 5.0 * tanh_fraction(x)),
            ("Wo1", vec![5.0, 0.7], 5.0 / (x * tanh_fraction(x))),
            (
                "Gs1",
                vec![5.0, 0.7, 0.5],
                5.0 * 0.5 / (y * tanh_fraction(y)),
            ),
        ];
        for (element, p, expected) in cases {
            close(
                z(element, &p, freq_hz),
                expected,
                1e-12,
                &format!("{element} at {freq_hz} Hz"),
            );
        }
        let g = z("G1", &[5.0, 0.7], freq_hz);
        close(
            g * g * (1.0 + s * 0.7),
            Complex64::new(25.0, 0.0),
            1e-12,
            "G squared",
        );
        assert!(g.re > 0.0);
    }
}

#[test]
fn elements_become_simpler_ones_in_their_limits() {
    close(
        z("Wo1", &[3.0, 2.0], 1e-9),
        z("C1-R1", &[2.0 / 3.0, 1.0], 1e-9),
        1e-15,
        "Wo → C = τ/Z₀ and R = Z₀/3 at low frequency",
    );
    close(
        z("Ws1", &[3.0, 2.0], 1e-9),
        Complex64::new(3.0, 0.0),
        1e-7,
        "Ws → R at low frequency",
    );
    for freq_hz in [1e-3, 0.7, 1e4] {
        let w = Complex64::new(1.0, -1.0) * (3.0 / (2.0 * TAU * freq_hz * 1e9f64).sqrt());
        for diffusion in ["Wo1", "Ws1"] {
            close(
                z(diffusion, &[3.0, 1e9], freq_hz),
                w,
                1e-12,
                "a long way is a semi-infinite one",
            );
        }
        close(
            z("W1", &[3.0 / (2.0 * 1e9f64).sqrt()], freq_hz),
            w,
            1e-12,
            "A = Z₀/√(2τ)",
        );
        close(
            z("CPE1", &[2.0, 1.0], freq_hz),
            z("C1", &[2.0], freq_hz),
            1e-13,
            "CPE with α = 1 is C",
        );
        close(
            z("La1", &[2.0, 1.0], freq_hz),
            z("L1", &[2.0], freq_hz),
            1e-13,
            "La with α = 1 is L",
        );
        close(
            z("CPE1", &[2.0, 0.5], freq_hz),
            z("W1", &[0.5 / 2f64.sqrt()], freq_hz),
            1e-13,
            "CPE with α = ½ is W",
        );
        close(
            z("Zarc1", &[5.0, 0.3, 1.0], freq_hz),
            z("K1", &[5.0, 0.3], freq_hz),
            1e-13,
            "Zarc with γ = 1 is K",
        );
        close(
            z("K1", &[5.0, 0.3], freq_hz),
            z("p(R1,C1)", &[5.0, 0.06], freq_hz),
            1e-13,
            "K is R ∥ τ/R",
        );
        let q = 0.3f64.powf(0.8) / 5.0;
        close(
            z("Zarc1", &[5.0, 0.3, 0.8], freq_hz),
            z("p(R1,CPE1)", &[5.0, q, 0.8], freq_hz),
            1e-13,
            "Zarc is R ∥ CPE",
        );
        close(
            z("Gs1", &[5.0, 0.3, 1e4], freq_hz),
            z("G1", &[5.0, 0.3], freq_hz),
            1e-13,
            "a long Gs is G",
        );
    }
}

#[test]
fn nothing_overflows_far_out() {
    for kind in ElementKind::ALL {
        let circuit: Circuit = format!("{}1", kind.name()).parse().unwrap();
        let p: Vec<f64> = kind
            .parameters()
            .iter()
            .map(|k| if k.role == Role::Exponent { 0.9 } else { 1.0 })
            .collect();
        for freq_hz in [1e-12, 1e-6, 1e6, 1e12] {
            let mut slopes = vec![Complex64::ZERO; p.len()];
            let z = circuit.jacobian(&p, freq_hz, &mut slopes);
            assert!(
                z.is_finite() && slopes.iter().all(|s| s.is_finite()),
                "{} at {freq_hz} Hz: {z}, {slopes:?}",
                kind.name()
            );
        }
    }
}

#[test]
fn series_adds_impedances_and_parallel_admittances() {
    let p = [0.1, 0.2, 0.3, 0.4, 0.5];
    let f = 0.9;
    let (r0, r1, c1) = (
        z("R0", &p[..1], f),
        z("R1", &p[1..2], f),
        z("C1", &p[2..3], f),
    );
    let (r2, l1) = (z("R2", &p[3..4], f), z("L1", &p[4..], f));
    let inner = r1 * c1 / (r1 + c1) + r2;
    close(
        z("R0-p(p(R1,C1)-R2,L1)", &p, f),
        r0 + inner * l1 / (inner + l1),
        1e-14,
        "nested",
    );
    let three = z("p(R1,C1,L1)", &[0.2, 0.3, 0.5], f);
    close(
        three.inv(),
        r1.inv() + c1.inv() + l1.inv(),
        1e-14,
        "three branches",
    );
    let circuit: Circuit = "R0".parse().unwrap();
    assert!(
        circuit.impedance(&[1.0, 2.0], f).is_nan() && circuit.jacobian(&[1.0], f, &mut []).is_nan()
    );
}

#[test]
fn the_erm_is_one_of_them() {
    let rc = |r_ohm, c_f| RcBranch { r_ohm, c_f };
    let mut erm = Erm {
        r_ohm: 0.0064,
        branches: vec![rc(0.0015, 0.55), rc(0.0004, 664.0), rc(0.0048, 1084.0)],
    };
    let (circuit, parameters) = Circuit::from_erm(&erm);
    assert_eq!(circuit.to_string(), "R0-p(R1,C1)-p(R2,C2)-p(R3,C3)");
    assert_eq!(circuit, circuit.to_string().parse().unwrap());
    for k in 0..80 {
        let freq_hz = 1e-3 * 10f64.powf(f64::from(k) * 0.1);
        close(
            circuit.impedance(&parameters, freq_hz),
            erm.impedance(freq_hz),
            1e-14,
            &format!("{freq_hz} Hz"),
        );
    }
    erm.branches.clear();
    assert_eq!(Circuit::from_erm(&erm).0.to_string(), "R0");
}

/// Far below the slowest process an impedance is the resistance for direct current, or grows.
#[test]
fn the_dc_resistance_is_the_impedance_at_low_frequency() {
    for kind in ElementKind::ALL {
        let p: Vec<f64> = kind
            .parameters()
            .iter()
            .enumerate()
            .map(|(k, kind)| match kind.role {
                Role::Exponent => 0.9,
                _ => 0.7 + 0.1 * k as f64,
            })
            .collect();
        let circuit: Circuit = format!("{}1", kind.name()).parse().unwrap();
        let low_ohm = circuit.impedance(&p, 1e-13).norm();
        let dc_ohm = kind.dc_resistance_ohm(&p);
        if dc_ohm.is_finite() {
            assert!((low_ohm - dc_ohm).abs() < 1e-9, "{kind:?}: {low_ohm}");
        } else {
            assert!(low_ohm > 1e6, "{kind:?}: {low_ohm}");
        }
    }
}

/// A circuit with every element, nested, and parameters near one.
const EVERYTHING: &str = "L0-R0-p(R1-Wo1,CPE1)-p(R2-p(R3-W1,C1),Zarc1-La1)-K1-Ws1-p(G1,C2)-Gs1";

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn the_jacobian_is_the_difference_quotient(
        logs in prop::collection::vec(-3.0..3.0f64, 27),
        log_f in -4.0..5.0f64,
    ) {
        let circuit: Circuit = EVERYTHING.parse().unwrap();
        let n = circuit.parameter_names().len();
        prop_assert!(n <= logs.len(), "{} parameters", n);
        let from = |(k, x): (usize, &f64)| {
            if circuit.parameter_kinds()[k].role == Role::Exponent {
                0.6 + x / 10.0
            } else {
                x.exp()
            }
        };
        let p: Vec<f64> = logs[..n].iter().enumerate().map(from).collect();
        let freq_hz = 10f64.powf(log_f);
        let mut slopes = vec![Complex64::ZERO; n];
        let z = circuit.jacobian(&p, freq_hz, &mut slopes);
        prop_assert!((z - circuit.impedance(&p, freq_hz)).norm() <= 1e-14 * z.norm());
        for i in 0..n {
            let h = 1e-5 * p[i];
            let at = |step: f64| {
                let mut q = p.clone();
                q[i] += step;
                circuit.impedance(&q, freq_hz)
            };
            // Five points: the error is of fourth order.
            let quotient = (8.0 * (at(h) - at(-h)) - at(2.0 * h) + at(-2.0 * h)) / (12.0 * h);
            let error = (quotient - slopes[i]).norm() * p[i];
            prop_assert!(
                error <= 3e-9 * z.norm() + 1e-9 * slopes[i].norm() * p[i],
                "{}: {} against {}",
                circuit.parameter_names()[i],
                slopes[i],
                quotient
            );
        }
    }
}

#[test]
fn derivatives_are_exact_where_formulas_lose_their_digits() {
    // ∂/∂τ of Ws at low frequency is −s·Z₀/3 and of Wo is that of Z₀/3: nothing at all beyond
    // −Z₀/(sτ²).
    let circuit: Circuit = "Ws1".parse().unwrap();
    let mut slopes = [Complex64::ZERO; 2];
    for freq_hz in [1e-9, 1e-6, 1e-4] {
        circuit.jacobian(&[3.0, 2.0], freq_hz, &mut slopes);
        let s = Complex64::new(0.0, TAU * freq_hz);
        close(
            slopes[1],
            -s * 3.0 / 3.0 + s * s * 2.0 * 3.0 * 4.0 / 15.0,
            1e-5,
            "Ws by τ",
        );
    }
    // Both sides of the change from series to closed form.
    let omega_tau = 0.02;
    let at = |factor: f64| {
        let mut slopes = [Complex64::ZERO; 2];
        "Ws1".parse::<Circuit>().unwrap().jacobian(
            &[1.0, 1.0],
            omega_tau * factor / TAU,
            &mut slopes,
        );
        slopes[1]
    };
    close(
        at(1.0 - 1e-9),
        at(1.0 + 1e-9),
        1e-8,
        "no step at the change of formula",
    );
}
