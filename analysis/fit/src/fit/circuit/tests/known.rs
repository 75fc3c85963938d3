//! Circuits whose parameters are known.

use super::{frequencies, noisy, parse, without_covariance};
use crate::fit::{CircuitOptions, Search, State, Weight, fit_circuit};
use analysis_numeric::Rng;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// A true impedance, written down without the model under test.
type Truth = fn(f64) -> Complex64;

/// jω.
fn s(freq_hz: f64) -> Complex64 {
    Complex64::new(0.0, TAU * freq_hz)
}

fn parallel(a: Complex64, b: Complex64) -> Complex64 {
    a * b / (a + b)
}

/// Z₀·coth(√(sτ))/√(sτ) by exponentials; fit for moderate arguments only.
fn open(z0: f64, x: Complex64) -> Complex64 {
    let q = x.sqrt();
    let e = (-2.0 * q).exp();
    z0 * (1.0 + e) / ((1.0 - e) * q)
}

/// Circuit, its parameters, the band in Hz, and the impedance by the formulas of a textbook.
type Known = (&'static str, &'static [f64], (f64, f64), Truth);

const CIRCUITS: [Known; 5] = [
    (
        "R0-p(R1,C1)-p(R2,C2)",
        &[0.007, 0.0017, 1.2, 0.0026, 200.0],
        (0.05, 1e3),
        |f| {
            0.007
                + parallel(0.0017.into(), 1.0 / (s(f) * 1.2))
                + parallel(0.0026.into(), 1.0 / (s(f) * 200.0))
        },
    ),
    (
        "L0-R0-p(R1,CPE1)",
        &[2e-7, 0.01, 0.02, 3.0, 0.8],
        (0.01, 1e4),
        |f| s(f) * 2e-7 + 0.01 + parallel(0.02.into(), 1.0 / (3.0 * s(f).powf(0.8))),
    ),
    (
        "R0-p(R1-W1,C1)",
        &[10.0, 100.0, 20.0, 1e-5],
        (0.05, 1e4),
        |f| {
            10.0 + parallel(
                100.0 + 20.0 * Complex64::new(1.0, -1.0) / (TAU * f).sqrt(),
                1.0 / (s(f) * 1e-5),
            )
        },
    ),
    (
        "R0-p(R1,C1)-Wo1",
        &[0.01, 0.004, 0.5, 0.02, 30.0],
        (2e-3, 1e3),
        |f| 0.01 + parallel(0.004.into(), 1.0 / (s(f) * 0.5)) + open(0.02, s(f) * 30.0),
    ),
    (
        "R0-Zarc1-G1",
        &[1.0, 2.0, 0.001, 0.85, 3.0, 0.5],
        (0.01, 1e4),
        |f| 1.0 + 2.0 / (1.0 + (s(f) * 0.001).powf(0.85)) + 3.0 / (1.0 + s(f) * 0.5).sqrt(),
    ),
];

#[test]
fn exact_data_give_the_circuit_back() {
    for (text, truth, band, z) in CIRCUITS {
        let spectrum = noisy(z, &frequencies(band, 40), (0.0, &mut Rng::new(0)));
        for search in [Search::Starts, Search::Evolution] {
            let fit = fit_circuit(
                std::slice::from_ref(&spectrum),
                &parse(text),
                &CircuitOptions {
                    search,
                    ..CircuitOptions::default()
                },
            )
            .unwrap();
            for ((name, met), expected) in fit.names.iter().zip(&fit.values).zip(truth) {
                assert!(
                    (met / expected - 1.0).abs() < 1e-6,
                    "{text}, {search:?}, {name}: expected {expected}, met {met}"
                );
            }
            assert_eq!(
                (fit.weight, fit.points, fit.degrees_of_freedom),
                (Weight::Modulus, 40, 80 - truth.len())
            );
        }
    }
}

/// Counts how often the 95 % interval value ± 1.96 σ contains the true value, over all parameters
/// of five circuits.
fn covered(runs: u64, weight: Option<Weight>) -> (u32, u32) {
    let (mut inside, mut all) = (0, 0);
    for (k, (text, truth, band, z)) in CIRCUITS.into_iter().enumerate() {
        let circuit = parse(text);
        let mut rng = Rng::new(100 + k as u64);
        for seed in 0..runs {
            let spectrum = noisy(z, &frequencies(band, 40), (0.003, &mut rng));
            let fit = fit_circuit(
                &[spectrum],
                &circuit,
                &CircuitOptions {
                    weight,
                    seed,
                    ..CircuitOptions::default()
                },
            )
            .unwrap();
            for ((value, sigma), truth) in fit.values.iter().zip(&fit.sigmas).zip(truth) {
                let sigma = sigma.unwrap_or_else(|| panic!("{text}: {fit:?}"));
                assert!(
                    sigma < 0.2 * value,
                    "{text}: a parameter of {value} ± {sigma} does not test intervals"
                );
                inside += u32::from((value - truth).abs() < 1.96 * sigma);
                all += 1;
            }
        }
    }
    (inside, all)
}

#[test]
fn stated_intervals_hold_the_truth() {
    for weight in [None, Some(Weight::Modulus)] {
        let (inside, all) = covered(80, weight);
        let fraction = f64::from(inside) / f64::from(all);
        println!(
            "{weight:?}: {inside} of {all} intervals hold the truth: {:.2} %",
            100.0 * fraction
        );
        assert!(
            (0.93..0.97).contains(&fraction),
            "{weight:?}: {inside} of {all}"
        );
    }
}

#[test]
fn no_start_values_are_needed_for_a_diffusion_behind_a_resistance() {
    let circuit = parse("R0-p(R1,C1)-p(R2-Wo1,CPE1)");
    let truth = |f: f64| {
        let branch = parallel(
            0.0054 + open(0.063, s(f) * 233.0),
            1.0 / (0.22 * s(f).powf(0.9)),
        );
        0.0165 + parallel(0.0087.into(), 1.0 / (s(f) * 3.3)) + branch
    };
    let known = [0.0165, 0.0087, 3.3, 0.0054, 0.063, 233.0, 0.22, 0.9];
    let (mut found, seeds) = (0, 120);
    let mut rng = Rng::new(5);
    for seed in 0..seeds {
        let spectrum = noisy(truth, &frequencies((3e-3, 1e3), 40), (0.003, &mut rng));
        // Half of the spectra have no stated noise, from which the search could conclude that it is
        // done.
        let spectra = [if seed % 2 == 0 {
            spectrum
        } else {
            without_covariance(spectrum)
        }];
        let guess = known.into_iter().enumerate().collect();
        let from_truth = fit_circuit(
            &spectra,
            &circuit,
            &CircuitOptions {
                guess,
                ..CircuitOptions::default()
            },
        )
        .unwrap();
        assert_eq!(from_truth.starts, 1);
        let fit = fit_circuit(
            &spectra,
            &circuit,
            &CircuitOptions {
                seed,
                ..CircuitOptions::default()
            },
        )
        .unwrap();
        found += u32::from(fit.objective <= from_truth.objective * (1.0 + 1e-6));
    }
    println!("{found} of {seeds} seeds found the optimum without start values");
    assert!(
        f64::from(found) >= 0.95 * seeds as f64,
        "{found} of {seeds}"
    );
}

#[test]
fn equal_blocks_stand_by_rising_time_constant() {
    let (text, _, band, z) = CIRCUITS[0];
    let spectrum = without_covariance(noisy(z, &frequencies(band, 40), (0.001, &mut Rng::new(1))));
    for seed in 0..10 {
        let fit = fit_circuit(
            std::slice::from_ref(&spectrum),
            &parse(text),
            &CircuitOptions {
                seed,
                ..CircuitOptions::default()
            },
        )
        .unwrap();
        assert!(
            fit.values[1] * fit.values[2] < fit.values[3] * fit.values[4],
            "{:?}",
            fit.values
        );
        assert!((fit.values[2] / 1.2 - 1.0).abs() < 0.05, "{:?}", fit.values);
    }
    // A constant pins its block: the slow branch stays where it was put.
    let options = CircuitOptions {
        constants: vec![(2, 200.0)],
        ..CircuitOptions::default()
    };
    let fit = fit_circuit(&[spectrum], &parse(text), &options).unwrap();
    assert_eq!(
        (fit.values[2], fit.states[2], fit.sigmas[2]),
        (200.0, State::Constant, None)
    );
    assert!((fit.values[4] / 1.2 - 1.0).abs() < 0.05, "{:?}", fit.values);
    assert!(fit.sigmas[1].is_some() && fit.covariance[2].iter().all(Option::is_none));
}

#[test]
fn what_the_data_do_not_fix_is_said() {
    let (_, _, band, z) = CIRCUITS[0];
    let mut rng = Rng::new(2);
    let spectrum = noisy(z, &frequencies(band, 40), (0.003, &mut rng));
    let fit = |text: &str| {
        fit_circuit(
            std::slice::from_ref(&spectrum),
            &parse(text),
            &CircuitOptions::default(),
        )
        .unwrap()
    };
    // Two resistors in series: only their sum is fixed. The other parameters keep their sigma.
    let twice = fit("R0-R3-p(R1,C1)-p(R2,C2)");
    assert_eq!(
        (twice.sigmas[0], twice.sigmas[1]),
        (None, None),
        "{:?}",
        twice.sigmas
    );
    assert!(
        twice.sigmas[2..].iter().all(Option::is_some),
        "{:?}",
        twice.sigmas
    );
    assert!(
        twice.warnings.words().iter().any(|w| w.starts_with(
            "the data fix only combinations of R0, R3: \
        these have no sigma"
        )),
        "{:?}",
        twice.warnings
    );
    // The same sigma as without the needless resistor.
    let once = fit("R0-p(R1,C1)-p(R2,C2)");
    assert!((twice.sigmas[2].unwrap() / once.sigmas[1].unwrap() - 1.0).abs() < 0.02);
    assert!(
        once.warnings.is_empty() && once.condition.unwrap() < 1e6,
        "{:?}",
        once.warnings
    );
    assert!(once.aicc.unwrap() < twice.aicc.unwrap());
    // A diffusion whose end lies far below the band: its τ is not known.
    let spectra = [noisy(
        |f| 0.01 + open(1.0, s(f) * 1e4),
        &frequencies((1.0, 1e3), 30),
        (0.003, &mut rng),
    )];
    let far = fit_circuit(&spectra, &parse("R0-Wo1"), &CircuitOptions::default()).unwrap();
    assert!(
        far.warnings.words().iter().any(|w| w.contains("Wo1")),
        "{far:?}"
    );
}

#[test]
fn a_bound_that_holds_a_parameter_is_named() {
    // Truth without any inductance; the fit wants a negative one.
    let z = |f: f64| 0.01 + parallel(0.02.into(), 1.0 / (s(f) * 3.0)) - s(f) * 1e-7;
    let spectra = [noisy(
        z,
        &frequencies((0.1, 1e4), 40),
        (0.001, &mut Rng::new(3)),
    )];
    let fit = fit_circuit(
        &spectra,
        &parse("L0-R0-p(R1,CPE1)"),
        &CircuitOptions::default(),
    )
    .unwrap();
    assert_eq!(
        (fit.states[0], fit.sigmas[0]),
        (State::AtLowerBound, None),
        "{fit:?}"
    );
    assert!(
        fit.warnings.words()[0].starts_with("L0 is at its lower bound of ")
            && fit.warnings.words()[0].contains(" H: it has no sigma"),
        "{:?}",
        fit.warnings
    );
    assert!(fit.sigmas[1].is_some());
}

#[test]
fn the_same_seed_gives_the_same_bits_and_threads_do_not_matter() {
    let (text, _, band, z) = CIRCUITS[3];
    let spectra = [noisy(z, &frequencies(band, 30), (0.003, &mut Rng::new(4)))];
    let fit = || fit_circuit(&spectra, &parse(text), &CircuitOptions::default()).unwrap();
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap()
        .install(fit);
    let four = rayon::ThreadPoolBuilder::new()
        .num_threads(4)
        .build()
        .unwrap()
        .install(fit);
    assert_eq!(one, four);
}
