//! Errors that the points have in common: a circuit that is an extended Randles model is fitted as
//! that model is.

use super::{frequencies, noisy, parse};
use crate::fit::{CircuitOptions, FitOptions, Objective, fit_circuit, fit_erm};
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::{SharedError, Spectrum};
use num_complex::Complex64;

/// Gains and an inductance, one standard deviation: as large as the noise of ten points together.
fn with_shared_errors(mut spectrum: Spectrum) -> Spectrum {
    let gain: Vec<Complex64> = spectrum.points.iter().map(|p| 3e-3 * p.z_ohm).collect();
    let inductance: Vec<Complex64> = spectrum
        .points
        .iter()
        .map(|p| Complex64::new(0.0, 1.2e-6 * p.freq_hz))
        .collect();
    for (name, at_ohm, times) in [("gain", gain, 0.8), ("inductance", inductance, -1.5)] {
        for (point, error) in spectrum.points.iter_mut().zip(&at_ohm) {
            point.z_ohm += times * error;
            point.covariance = point.covariance + Covariance2::along(*error);
        }
        spectrum.shared.push(SharedError {
            name: name.to_owned(),
            at_ohm,
        });
    }
    spectrum
}

#[test]
fn a_circuit_of_rc_branches_is_fitted_as_the_extended_randles_model() {
    let circuit = parse("R0-p(R1,C1)-p(R2,C2)");
    let truth = [6.4e-3, 1.5e-3, 0.5, 2.5e-3, 90.0];
    let own = noisy(
        |f| circuit.impedance(&truth, f),
        &frequencies((0.1, 1000.0), 30),
        (1e-3, &mut Rng::new(41)),
    );
    let spectrum = with_shared_errors(own.clone());
    let fitted = fit_circuit(
        std::slice::from_ref(&spectrum),
        &circuit,
        &CircuitOptions::default(),
    )
    .unwrap();
    let erm = fit_erm(
        std::slice::from_ref(&spectrum),
        &FitOptions {
            rc: 2,
            objective: Objective::Complex,
            ..FitOptions::default()
        },
    )
    .unwrap();
    let [a, b] = erm.erm.branches.as_slice() else {
        panic!("two branches")
    };
    let [sa, sb] = erm.sigma.branches.as_slice() else {
        panic!("two branches")
    };
    let expected = [erm.erm.r_ohm, a.r_ohm, a.c_f, b.r_ohm, b.c_f];
    let sigmas = [erm.sigma.r_ohm, sa.r_ohm, sa.c_f, sb.r_ohm, sb.c_f].map(Option::unwrap);
    for (k, name) in circuit.parameter_names().iter().enumerate() {
        let sigma = fitted.sigmas[k].unwrap();
        assert!(
            (fitted.values[k] - expected[k]).abs() < 1e-3 * sigmas[k],
            "{name}: {} against {}",
            fitted.values[k],
            expected[k]
        );
        assert!(
            (sigma / sigmas[k] - 1.0).abs() < 1e-3,
            "{name}: ± {sigma} against ± {}",
            sigmas[k]
        );
        assert!(
            (fitted.values[k] - truth[k]).abs() < 4.0 * sigma,
            "{name}: {} ± {sigma}",
            fitted.values[k]
        );
    }
    assert!((fitted.reduced_chi2.unwrap() / erm.reduced_chi2.unwrap() - 1.0).abs() < 1e-6);
    // A gain moves all resistances together: their sum is known no better than the gain is.
    let alone = fit_circuit(&[own], &circuit, &CircuitOptions::default()).unwrap();
    assert!(fitted.sigmas[0].unwrap() > 2.0 * alone.sigmas[0].unwrap());
}
