//! Ladders against the impedances of their circuits, evaluated here by other formulas, and against
//! their answers in time.

use super::*;
use crate::given::MOST_BRANCHES;
use analysis_forward::forward::{
    Demand, Interpolation, OcvSource, Profile, SimModel, SimOptions, simulate,
};

const DATA_HZ: (f64, f64) = (0.01, 1e4);

fn bands() -> Bands {
    Bands {
        data_hz: Some(DATA_HZ),
        asked_hz: None,
    }
}

fn made(circuit: &str, values: &[f64]) -> Followed {
    follow(&circuit.parse().unwrap(), values, bands()).unwrap()
}

fn refused(circuit: &str, values: &[f64]) -> String {
    follow(&circuit.parse().unwrap(), values, bands())
        .unwrap_err()
        .to_string()
}

/// (jω)^α by polar form.
fn power(omega: f64, alpha: f64) -> Complex64 {
    let angle = alpha * std::f64::consts::FRAC_PI_2;
    Complex64::new(angle.cos(), angle.sin()) * omega.powf(alpha)
}

/// R ∥ CPE.
fn r_cpe(omega: f64, [r, q, alpha]: [f64; 3]) -> Complex64 {
    1.0 / (1.0 / r + q * power(omega, alpha))
}

/// tanh(√s)/√s by exponentials.
fn tanh_over(s: Complex64) -> Complex64 {
    let root = s.sqrt();
    let e = (-2.0 * root).exp();
    (1.0 - e) / ((1.0 + e) * root)
}

/// Largest relative distance over the band that the ladder states, on a grid of its own. `store` is
/// a capacitance that the ladder leaves to the OCV.
fn distance(met: &Followed, store_f: f64, z: impl Fn(f64) -> Complex64) -> f64 {
    let (low, high) = met.ladder.band_hz;
    let error = |k: i32| {
        let freq_hz = low * (high / low).powf(f64::from(k) / 777.0);
        let omega = TAU * freq_hz;
        let wanted = z(omega)
            + if store_f.is_finite() {
                Complex64::new(0.0, 1.0 / (omega * store_f))
            } else {
                Complex64::ZERO
            };
        (met.erm.impedance(freq_hz) - wanted).norm() / wanted.norm()
    };
    (0..=777).map(error).fold(0.0, f64::max)
}

fn check(met: &Followed, store_f: f64, z: impl Fn(f64) -> Complex64) {
    let worst = distance(met, store_f, z);
    let ladder = &met.ladder;
    eprintln!(
        "{}: {} branches, stated {:.2e}, met {worst:.2e}",
        ladder.circuit,
        met.erm.branches.len(),
        ladder.worst_relative_error
    );
    assert!(
        worst < TARGET
            && ladder.worst_relative_error < TARGET
            && met.erm.branches.len() <= MOST_BRANCHES,
        "{worst} {ladder:?}"
    );
    assert!(
        worst < 1.2 * ladder.worst_relative_error,
        "{worst}, stated {}",
        ladder.worst_relative_error
    );
    assert_eq!(ladder.band_hz, (1e-3, 1e5));
}

#[test]
fn a_depressed_arc_is_followed() {
    let arc = [0.005, 3.0, 0.8];
    let met = made("R0-p(R1,CPE1)", &[0.01, 0.005, 3.0, 0.8]);
    check(&met, f64::INFINITY, |omega| 0.01 + r_cpe(omega, arc));
    assert!(
        (met.erm.dc_resistance_ohm() / 0.015 - 1.0).abs() < SAME_DC,
        "{}",
        met.erm.dc_resistance_ohm()
    );
    assert!(
        (met.ladder.dc_resistance_ohm.unwrap() - 0.015).abs() < 1e-15
            && met.ladder.horizon_s.is_none()
    );
    let notes = met.ladder.notes(&met.erm);
    assert!(
        notes.len() == 1 && notes[0].contains("from 1 mHz to 100 kHz (data 10 mHz to 10 kHz)"),
        "{notes:?}"
    );
    // An arc of which the data, down to 1 Hz, show the fast half.
    let bands = Bands {
        data_hz: Some((1.0, 1e3)),
        asked_hz: None,
    };
    let met = follow(
        &"R0-Zarc1".parse().unwrap(),
        &[0.01, 0.005, 0.3, 0.9],
        bands,
    )
    .unwrap();
    let notes = met.ladder.notes(&met.erm).join("\n");
    assert!(
        notes.contains("of the DC resistance of 15 mΩ, ")
            && notes.contains("beyond 0.159 s, the slowest that the data reach"),
        "{notes}"
    );
}

#[test]
fn arcs_in_series_are_followed_together() {
    // A Zarc of R and τ is R ∥ CPE with Q = τ^γ/R; a Gerischer element is R/√(1 + st).
    let met = made(
        "R0-Zarc1-Zarc2-G1",
        &[0.006, 0.002, 1e-3, 0.75, 0.004, 0.5, 0.9, 0.003, 8.0],
    );
    let zarc = |omega, r: f64, tau: f64, gamma: f64| r_cpe(omega, [r, tau.powf(gamma) / r, gamma]);
    check(&met, f64::INFINITY, |omega| {
        0.006
            + zarc(omega, 0.002, 1e-3, 0.75)
            + zarc(omega, 0.004, 0.5, 0.9)
            + 0.003 / Complex64::new(1.0, 8.0 * omega).sqrt()
    });
}

#[test]
fn a_randles_circuit_is_followed_with_every_warburg_element() {
    let (r0, r1, q, alpha) = (0.006, 0.002, 2.0, 0.85);
    let randles =
        |omega, diffusion: Complex64| r0 + 1.0 / (q * power(omega, alpha) + 1.0 / (r1 + diffusion));
    let s = |omega: f64, tau: f64| Complex64::new(0.0, omega * tau);

    let met = made("R0-p(R1-Ws1,CPE1)", &[r0, r1, 0.004, 30.0, q, alpha]);
    check(&met, f64::INFINITY, |omega| {
        randles(omega, 0.004 * tanh_over(s(omega, 30.0)))
    });
    assert!((met.erm.dc_resistance_ohm() / (r0 + r1 + 0.004) - 1.0).abs() < SAME_DC);

    // The finite diffusion with a blocking end stores τ/Z₀; coth(√s)/√s = 1/(s·tanh(√s)/√s).
    let met = made("R0-p(R1-Wo1,CPE1)", &[r0, r1, 0.004, 30.0, q, alpha]);
    let storage_f = met.ladder.storage_f.unwrap();
    assert!((storage_f / 7500.0 - 1.0).abs() < 5e-3, "{storage_f}");
    check(&met, storage_f, |omega| {
        randles(omega, 0.004 / (s(omega, 30.0) * tanh_over(s(omega, 30.0))))
    });
    let dc_ohm = met.ladder.dc_resistance_ohm.unwrap();
    assert!(
        (dc_ohm / (r0 + r1 + 0.004 / 3.0) - 1.0).abs() < 2e-3,
        "{dc_ohm}"
    );
    assert!(
        met.ladder
            .notes(&met.erm)
            .iter()
            .any(|note| note.contains("is charge storage"))
    );

    // Semi-infinite diffusion: no DC resistance, and a horizon of 1/(2π·1 mHz).
    let met = made("R0-p(R1-W1,CPE1)", &[r0, r1, 0.0005, q, alpha]);
    check(&met, f64::INFINITY, |omega| {
        randles(omega, Complex64::new(1.0, -1.0) * (0.0005 / omega.sqrt()))
    });
    assert!(
        met.ladder.dc_resistance_ohm.is_none()
            && (met.ladder.horizon_s.unwrap() / 159.155 - 1.0).abs() < 1e-5,
        "{:?}",
        met.ladder
    );
    assert!(
        met.ladder
            .notes(&met.erm)
            .iter()
            .any(|note| note.contains("has no DC resistance") && note.contains("159 s"))
    );
}

#[test]
fn what_is_an_erm_stays_as_it_is_with_its_covariance() {
    let met = made(
        "L0-R0-p(C1,R1)-K2-R3",
        &[20e-9, 0.006, 2.0, 0.001, 0.004, 8.0, 0.0005],
    );
    assert!(
        (met.erm.r_ohm - 0.0065).abs() < 1e-15
            && met.ladder.worst_relative_error == 0.0
            && met.ladder.storage_f.is_none()
    );
    let branches: Vec<(f64, f64)> = met.erm.branches.iter().map(|b| (b.r_ohm, b.c_f)).collect();
    assert_eq!(branches, [(0.001, 2.0), (0.004, 2000.0)]);
    let jacobian = met.log_jacobian.unwrap();
    assert_eq!(
        jacobian[1],
        [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
        "ln R1 is the circuit's R1"
    );
    assert_eq!(
        jacobian[4],
        [0.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0],
        "ln C2 is ln τ less ln R of K2"
    );
    assert!(
        (jacobian[0][1] - 12.0 / 13.0).abs() < 1e-12 && (jacobian[0][6] - 1.0 / 13.0).abs() < 1e-12
    );
    let [lost] = met.ladder.left_out.as_slice() else {
        panic!("{:?}", met.ladder)
    };
    let lost_ohm = TAU * 1e4 * 20e-9;
    assert!(
        lost.block == "L0" && lost.freq_hz == 1e4 && (lost.impedance_ohm - lost_ohm).abs() < 1e-15,
        "{lost:?}"
    );
    let notes = met.ladder.notes(&met.erm).join("\n");
    assert!(
        notes.contains("is an extended Randles model as it is") && notes.contains("L0, 1.26 mΩ"),
        "{notes}"
    );
}

#[test]
fn a_capacitance_in_series_is_left_to_the_open_circuit_voltage() {
    let met = made("R0-C1-p(R1,CPE1)-L1", &[0.01, 2e4, 0.005, 3.0, 0.8, 1e-8]);
    assert!(
        (met.ladder.storage_f.unwrap() / 2e4 - 1.0).abs() < 1e-12 && met.ladder.horizon_s.is_none()
    );
    check(&met, f64::INFINITY, |omega| {
        0.01 + r_cpe(omega, [0.005, 3.0, 0.8])
    });
}

#[test]
fn what_no_ladder_represents_is_refused_with_the_reason() {
    let text = refused("R0-p(R1,C1)", &[0.01, -0.002, 1.0]);
    assert!(
        text.starts_with(
            "R1 of the circuit: expected a finite number above 0, met -0.002 Ω: no ladder"
        ),
        "{text}"
    );
    let text = refused("R0-CPE1", &[0.01, 1.0, 1.2]);
    assert!(
        text.starts_with(
            "CPE1_1 of the circuit: expected an exponent above 0 and up to 1, met 1.2"
        ),
        "{text}"
    );
    assert!(
        refused("R0-p(R1,C1)", &[0.01, 0.002])
            .contains("expected 3 values, one for each parameter, met 2")
    );
    assert!(
        refused("p(R1,C1)", &[0.002, 1.0]).contains("expected a resistance in series, met none")
    );
    // A loop of inductance and capacitance rings.
    let text = refused("R0-p(R1-L1,C1)", &[0.01, 0.002, 1e-3, 10.0]);
    assert!(
        text.starts_with(
            "p(R1-L1,C1): expected what resistances and capacitances above zero \
    follow within 1 %, met"
        ),
        "{text}"
    );
    let circuit: Circuit = "R0-CPE1".parse().unwrap();
    let none = Bands {
        data_hz: None,
        asked_hz: None,
    };
    assert!(
        follow(&circuit, &[0.01, 1.0, 0.8], none)
            .unwrap_err()
            .to_string()
            .contains("expected the field band_hz")
    );
    let wrong = Bands {
        data_hz: None,
        asked_hz: Some((10.0, 1.0)),
    };
    assert!(
        follow(&circuit, &[0.01, 1.0, 0.8], wrong)
            .unwrap_err()
            .to_string()
            .contains("band of the ladder: expected a lower and a higher")
    );
}

/// The function of time of a Laplace transform, on Talbot's contour with the parameters of Abate
/// and Valkó, Int. J. Numer. Meth. Engng 60 (2004) 979.
fn talbot(f: impl Fn(Complex64) -> Complex64, time_s: f64) -> f64 {
    let m = 24;
    let r = 2.0 * f64::from(m) / (5.0 * time_s);
    let term = |k: i32| {
        let theta = f64::from(k) * std::f64::consts::PI / f64::from(m);
        let cot = 1.0 / theta.tan();
        let s = Complex64::new(r * theta * cot, r * theta);
        let sigma = theta + (theta * cot - 1.0) * cot;
        ((s * time_s).exp() * f(s) * Complex64::new(1.0, sigma)).re
    };
    let first = 0.5 * (r * time_s).exp() * f(Complex64::from(r)).re;
    r / f64::from(m) * (first + (1..m).map(term).sum::<f64>())
}

/// 1 − E_γ(−x), the step response of an arc, by the series of Mittag-Leffler's function with Γ by
/// Lanczos.
fn arc_step(gamma: f64, x: f64) -> f64 {
    let term = |k: i32| -(-x).powi(k) / gamma_function(1.0 + gamma * f64::from(k));
    (1..80).map(term).sum()
}

fn gamma_function(x: f64) -> f64 {
    const G: [f64; 9] = [
        0.999_999_999_999_809_9,
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    let (x, t) = (x - 1.0, x + 6.5);
    let sum = G[1..]
        .iter()
        .zip(1..)
        .fold(G[0], |sum, (g, k)| sum + g / (x + f64::from(k)));
    TAU.sqrt() * t.powf(x + 0.5) * (-t).exp() * sum
}

#[test]
fn a_step_of_current_meets_the_answer_of_the_circuit() {
    let [r0, r1, tau, gamma] = [0.01, 0.005, 0.2, 0.7];
    let met = made("R0-Zarc1", &[r0, r1, tau, gamma]);
    let model = SimModel::cell(&met.erm, OcvSource::Constant(3.7)).unwrap();
    let times_s = [1e-4, 1e-3, 0.01, 0.05, 0.2, 1.0, 5.0, 30.0, 150.0];
    let mut rows: Vec<(f64, f64)> = vec![(0.0, 2.0)];
    rows.extend(times_s.iter().map(|time_s| (*time_s, 2.0)));
    let profile = Profile::new("step", Demand::Current, Interpolation::Hold, &rows).unwrap();
    let trace = simulate(
        &model,
        &model.rest(0.5).unwrap(),
        &profile,
        &SimOptions {
            max_step_s: f64::INFINITY,
            ..SimOptions::default()
        },
    )
    .unwrap()
    .trace;
    for time_s in times_s {
        let row = trace
            .time_s
            .iter()
            .position(|met_s| (met_s - time_s).abs() < 1e-12 * time_s)
            .unwrap();
        let answer_ohm = (3.7 - trace.ccv_v[row]) / 2.0;
        let wanted_ohm = talbot(|s| (r0 + r1 / (1.0 + (s * tau).powf(gamma))) / s, time_s);
        assert!(
            (answer_ohm / wanted_ohm - 1.0).abs() < TARGET,
            "{time_s} s: {answer_ohm}, expected {wanted_ohm}"
        );
        let x = (time_s / tau).powf(gamma);
        if x < 5.0 {
            let series_ohm = r0 + r1 * arc_step(gamma, x);
            assert!(
                (series_ohm / wanted_ohm - 1.0).abs() < 1e-7,
                "{time_s} s: {series_ohm} by the series, {wanted_ohm}"
            );
        }
    }
}
