//! Refusals of the circuit fit, and their messages.

use super::{frequencies, noisy, parse, without_covariance};
use crate::fit::{
    CircuitFit, CircuitFitError, CircuitOptions, Objective, Search, Weight, fit_circuit,
};
use analysis_numeric::Rng;
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;
use proptest::prelude::*;

fn resistor(points: u32) -> Spectrum {
    without_covariance(noisy(
        |_| Complex64::new(0.01, 0.0),
        &frequencies((1.0, 100.0), points),
        (0.001, &mut Rng::new(0)),
    ))
}

fn refused(spectra: &[Spectrum], text: &str, options: &CircuitOptions) -> String {
    fit_circuit(spectra, &parse(text), options)
        .unwrap_err()
        .to_string()
}

#[test]
fn refusals_say_what_was_expected_and_met() {
    let plain = CircuitOptions::default();
    let s = [resistor(3)];
    assert_eq!(
        refused(&[], "R0", &plain),
        "fit: expected at least one point, met none in 0 spectra"
    );
    assert_eq!(
        refused(&s, "R0-p(R1,C1)-p(R2,CPE2)-W1", &plain),
        "fit of R0-p(R1,C1)-p(R2,CPE2)-W1: expected at least 7 numbers for as many free \
        parameters, met 6 (3 distinct frequencies, objective complex)"
    );
    let modulus = CircuitOptions {
        objective: Objective::Modulus,
        ..plain.clone()
    };
    assert!(
        refused(&s, "R0-p(R1,C1)-C2", &modulus)
            .contains("expected at least 4 numbers for as many free parameters, met 3")
    );
    let covariance = CircuitOptions {
        weight: Some(Weight::Covariance),
        ..plain.clone()
    };
    assert_eq!(
        refused(&s, "R0", &covariance),
        "weight covariance: expected a covariance at every point, met 0 of 3 points with one; use \
        unit or modulus"
    );
    let beyond = CircuitOptions {
        constants: vec![(1, 1.0)],
        ..plain.clone()
    };
    assert_eq!(
        refused(&s, "R0", &beyond),
        "fit of R0: expected constants within the physical range of the circuit's parameters, met \
        number 1 with value 1"
    );
    let negative = CircuitOptions {
        guess: vec![(0, -1.0)],
        ..plain.clone()
    };
    assert!(
        refused(&s, "R0", &negative).contains("expected start values within the physical range")
    );
    let none = CircuitOptions {
        starts: Some(0),
        ..plain.clone()
    };
    assert_eq!(
        refused(&s, "R0", &none),
        "starts: expected 1 to 100000, met 0"
    );
    let mut huge = resistor(3);
    huge.points
        .iter_mut()
        .for_each(|p| p.z_ohm = Complex64::new(1e200, 0.0));
    assert!(
        refused(
            &[huge],
            "R0",
            &CircuitOptions {
                weight: Some(Weight::Unit),
                ..plain
            }
        )
        .contains("no start gives a finite objective")
    );
    assert_eq!(
        "heavy".parse::<Weight>().unwrap_err().to_string(),
        "weight: expected unit, modulus or covariance, met \"heavy\""
    );
    assert_eq!(
        "luck".parse::<Search>().unwrap_err().to_string(),
        "search: expected starts or evolution, met \"luck\""
    );
}

#[test]
fn few_numbers_fit_without_uncertainty_and_constants_alone_are_no_fit() {
    let mut one = resistor(1);
    one.points[0].z_ohm = Complex64::new(0.01, -0.02);
    let fit = fit_circuit(&[one], &parse("R0-C0"), &CircuitOptions::default()).unwrap();
    assert_eq!(
        (fit.degrees_of_freedom, fit.sigmas[0], fit.aicc),
        (0, None, None)
    );
    assert!(
        fit.warnings
            .words()
            .iter()
            .any(|w| w.contains("as many parameters as numbers")),
        "{:?}",
        fit.warnings
    );
    let constants = CircuitOptions {
        constants: vec![(0, 0.01)],
        ..CircuitOptions::default()
    };
    let held = fit_circuit(&[resistor(5)], &parse("R0"), &constants).unwrap();
    assert_eq!(
        (held.values[0], held.sigmas[0], held.degrees_of_freedom),
        (0.01, None, 10)
    );
}

#[test]
fn a_result_is_the_same_after_json() {
    let fit = fit_circuit(
        &[resistor(8)],
        &parse("R0-p(R1,C1)"),
        &CircuitOptions::default(),
    )
    .unwrap();
    let text = serde_json::to_string(&fit).unwrap();
    assert_eq!(serde_json::from_str::<CircuitFit>(&text).unwrap(), fit);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn no_data_make_the_fit_panic(
        points in prop::collection::vec((-6.0..6.0f64, -1e3..1e3f64, -1e3..1e3f64), 1..8),
        text in prop::sample::select(vec![
            "R0",
            "R0-C1",
            "p(R0,CPE1)",
            "L0-Wo1",
            "Gs1-La1",
            "W1-Ws1",
            "p(R0-p(R1,C1),C2)",
        ]),
        objective in prop::sample::select(vec![
            Objective::SumAbs,
            Objective::Modulus,
            Objective::Complex,
        ]),
    ) {
        let mut spectrum = resistor(2);
        let template = spectrum.points[0];
        spectrum.points = points
            .iter()
            .map(|(log_f, re, im)| analysis_signal::spectrum::ImpedancePoint {
                freq_hz: 10f64.powf(*log_f),
                z_ohm: Complex64::new(*re, *im),
                ..template
            })
            .collect();
        let options = CircuitOptions {
            objective,
            starts: Some(4),
            ..CircuitOptions::default()
        };
        match fit_circuit(&[spectrum], &parse(text), &options) {
            Ok(fit) => {
                prop_assert!(fit.objective.is_finite() && fit.values.iter().all(|v| v.is_finite()));
                let inside = fit
                    .values
                    .iter()
                    .zip(&fit.bounds)
                    .all(|(v, (lo, hi))| *v >= lo * (1.0 - 1e-9) && *v <= hi * (1.0 + 1e-9));
                prop_assert!(inside, "{:?}", fit);
            }
            Err(error) => prop_assert!(
                matches!(
                    error,
                    CircuitFitError::TooFewFrequencies { .. } | CircuitFitError::Data(_)
                ),
                "{}",
                error
            ),
        }
    }
}

#[test]
fn one_reading_said_often_is_one_reading() {
    let mut spectrum = resistor(5);
    let first = spectrum.points[0];
    spectrum.points.iter_mut().for_each(|p| {
        *p = analysis_signal::spectrum::ImpedancePoint {
            z_ohm: num_complex::Complex64::new(0.01, -0.002),
            ..first
        }
    });
    let expected = "fit of R0-C0: expected more numbers than 2 free parameters, met 5 points that \
    repeat 1 distinct frequencies to the last digit: \
                    2 numbers";
    assert_eq!(
        refused(
            std::slice::from_ref(&spectrum),
            "R0-C0",
            &CircuitOptions::default()
        ),
        expected
    );
    // Readings that scatter do give an uncertainty.
    spectrum.points[1].z_ohm += 1e-5;
    assert!(
        fit_circuit(&[spectrum], &parse("R0-C0"), &CircuitOptions::default())
            .unwrap()
            .sigmas[0]
            .unwrap()
            > 1e-7
    );
}
