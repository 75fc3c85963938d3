//! The three objectives against the ERM's fit, which reaches the same sums by another way, and
//! pooling.

use super::{frequencies, noisy, parse, without_covariance};
use crate::fit::{Bounds, CircuitOptions, FitOptions, Objective, Weight, fit_circuit, fit_erm};
use analysis_files::formats::read_unbiased_cells;
use analysis_model::model::Circuit;
use analysis_numeric::Rng;
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;
use std::path::Path;

fn two_rc(f: f64) -> Complex64 {
    let branch = |r: f64, c: f64| r / Complex64::new(1.0, std::f64::consts::TAU * f * r * c);
    0.007 + branch(0.0017, 1.2) + branch(0.0026, 200.0)
}

fn sweeps(count: u64) -> Vec<Spectrum> {
    let mut rng = Rng::new(8);
    (0..count)
        .map(|_| noisy(two_rc, &frequencies((0.1, 300.0), 20), (0.003, &mut rng)))
        .collect()
}

#[test]
fn the_erm_as_a_circuit_has_the_ermss_optimum() {
    let circuit: Circuit = parse("R0-p(R1,C1)-p(R2,C2)");
    for objective in [Objective::SumAbs, Objective::Modulus, Objective::Complex] {
        for spectra in [sweeps(1), sweeps(7)] {
            let erm = fit_erm(
                &spectra,
                &FitOptions {
                    rc: 2,
                    objective,
                    bounds: Bounds::default(),
                    seed: 0,
                },
            )
            .unwrap();
            let fit = fit_circuit(
                &spectra,
                &circuit,
                &CircuitOptions {
                    objective,
                    ..CircuitOptions::default()
                },
            )
            .unwrap();
            assert!(
                (fit.objective / erm.objective - 1.0).abs() < 1e-7,
                "{objective}: {} against {}",
                fit.objective,
                erm.objective
            );
            for (value, log) in fit.values.iter().zip(erm.erm.log_parameters()) {
                assert!(
                    (value.ln() - log).abs() < 1e-3,
                    "{objective}: {:?} against {:?}",
                    fit.values,
                    erm.erm
                );
            }
            assert_eq!(
                (fit.points, fit.spectra.len()),
                (20 * spectra.len(), spectra.len())
            );
            // Both are at the precision of their own optimum. A sum of norms has corners near which
            // the scatter of gradients jumps.
            let (met, expected) = (fit.sigmas[0].unwrap(), erm.sigma.r_ohm.unwrap());
            assert!(
                (met / expected - 1.0).abs() < 0.01,
                "{objective}, {}: {met} against {expected}",
                spectra.len()
            );
        }
    }
}

#[test]
fn the_thesis_own_sums_come_out_as_circuits() {
    let table =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/data/spectra/p45b_thesis.csv");
    let spectra = read_unbiased_cells(&table).unwrap();
    let options = CircuitOptions {
        objective: Objective::SumAbs,
        ..CircuitOptions::default()
    };
    for (text, expected) in [
        ("R0-p(R1,C1)", 0.193_24),
        ("R0-p(R1,C1)-p(R2,C2)", 0.072_555),
        ("R0-p(R1,C1)-p(R2,C2)-p(R3,C3)", 0.046_394),
    ] {
        let fit = fit_circuit(&spectra, &parse(text), &options).unwrap();
        assert!(
            (fit.objective - expected).abs() < 5e-6,
            "{text}: expected {expected} Ω, met {} Ω",
            fit.objective
        );
    }
}

#[test]
fn objectives_are_the_sums_they_are_called() {
    let spectra = sweeps(3);
    let circuit = parse("R0-p(R1,CPE1)");
    for objective in [Objective::SumAbs, Objective::Modulus, Objective::Complex] {
        for weight in [Weight::Unit, Weight::Modulus, Weight::Covariance] {
            let options = CircuitOptions {
                objective,
                weight: Some(weight),
                ..CircuitOptions::default()
            };
            let fit = fit_circuit(&spectra, &circuit, &options).unwrap();
            let share = |p: &analysis_signal::spectrum::ImpedancePoint| {
                let z = circuit.impedance(&fit.values, p.freq_hz);
                // The covariance is circular here, and known to be that of 0.3 %, up to the noise
                // in |Z|.
                let size = match weight {
                    Weight::Unit => 1.0,
                    Weight::Modulus => p.z_ohm.norm(),
                    Weight::Covariance => p.covariance.re_re.sqrt(),
                };
                match objective {
                    Objective::SumAbs => (z - p.z_ohm).norm() / size,
                    Objective::Modulus => ((z.norm() - p.z_ohm.norm()) / size).powi(2),
                    Objective::Complex => ((z - p.z_ohm) / size).norm_sqr(),
                }
            };
            let sum: f64 = spectra.iter().flat_map(|s| &s.points).map(share).sum();
            assert!(
                (fit.objective / sum - 1.0).abs() < 1e-9,
                "{objective}, {weight}: {} against {sum}",
                fit.objective
            );
            assert_eq!(
                fit.reduced_chi2.is_some(),
                weight == Weight::Covariance && objective != Objective::SumAbs
            );
        }
    }
}

#[test]
fn the_minimum_is_one_in_every_direction() {
    let spectra = sweeps(2);
    let circuit = parse("R0-p(R1,C1)-p(R2,C2)");
    for objective in [Objective::SumAbs, Objective::Modulus, Objective::Complex] {
        let options = CircuitOptions {
            objective,
            weight: Some(Weight::Modulus),
            ..CircuitOptions::default()
        };
        let fit = fit_circuit(&spectra, &circuit, &options).unwrap();
        for i in 0..fit.values.len() {
            for step in [-1e-3, 1e-3] {
                let constants = vec![(i, fit.values[i] * (1.0 + step))];
                let moved = fit_circuit(
                    &spectra,
                    &circuit,
                    &CircuitOptions {
                        constants,
                        ..options.clone()
                    },
                )
                .unwrap();
                assert!(
                    moved.objective >= fit.objective * (1.0 - 1e-8),
                    "{objective}, {}: {} below {}",
                    fit.names[i],
                    moved.objective,
                    fit.objective
                );
            }
        }
    }
}

#[test]
fn a_full_covariance_is_used_with_its_correlation() {
    // Noise along one direction only (almost): the fit must pass where the noise is small. One
    // resistor, closed form: R = Σw(x − ρ…)/Σw.
    let mut spectrum = without_covariance(noisy(
        |_| Complex64::new(2.0, 0.0),
        &frequencies((1.0, 10.0), 3),
        (0.0, &mut Rng::new(0)),
    ));
    for (p, (re, im)) in spectrum
        .points
        .iter_mut()
        .zip([(2.5, 0.5), (1.8, -0.2), (2.1, 0.1)])
    {
        p.z_ohm = Complex64::new(re, im);
        p.covariance = analysis_numeric::Covariance2 {
            re_re: 1.0,
            re_im: 0.9,
            im_im: 1.0,
        };
    }
    let fit = fit_circuit(&[spectrum], &parse("R0"), &CircuitOptions::default()).unwrap();
    // Minimising Σ(xx(R − re)² − 2xy(R − re)im) gives R = mean(re) − 0.9·mean(im).
    let expected = (2.5 + 1.8 + 2.1) / 3.0 - 0.9 * (0.5 - 0.2 + 0.1) / 3.0;
    assert!(
        (fit.values[0] - expected).abs() < 1e-9,
        "{} against {expected}",
        fit.values[0]
    );
    // Information per point 1/(1 − 0.9²).
    assert!(
        (fit.sigmas[0].unwrap() - (0.19f64 / 3.0).sqrt()).abs() < 1e-9,
        "{:?}",
        fit.sigmas
    );
}
