//! Charge storage that is not known beforehand.

use num_complex::Complex64;
use std::f64::consts::TAU;

use super::noisy;
use crate::fit::{FitOptions, Objective, fit_erm};
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::OcvSlope;

/// A slope far beyond its prior, and noise that is not stated: the prior must neither hold it nor
/// make the misfit that it causes pass for noise.
#[test]
fn a_slope_beyond_its_prior_is_found_and_reported() {
    let mut rng = Rng::new(21);
    for (points, v_per_coulomb) in [
        (25, 200e-6),
        (25, 500e-6),
        (25, 1000e-6),
        (12, 300e-6),
        (12, 500e-6),
    ] {
        let mut spectrum = noisy(
            (0.007, &[(0.002, 5.0), (0.003, 300.0)]),
            points,
            0.001,
            &mut rng,
        );
        for point in &mut spectrum.points {
            point.z_ohm += Complex64::new(0.0, -v_per_coulomb / (TAU * point.freq_hz));
            point.covariance = Covariance2::UNKNOWN;
        }
        let prior = OcvSlope::prior(&spectrum).unwrap();
        let less = spectrum.less_charge_storage(prior);
        let options = FitOptions {
            rc: 2,
            objective: Objective::Complex,
            ..FitOptions::default()
        };
        let fit = fit_erm(std::slice::from_ref(&less), &options).unwrap();
        let (storage, sigma) = (
            fit.charge_storage.unwrap(),
            fit.sigma.dc_resistance_ohm.unwrap(),
        );
        let off = (storage.v_per_coulomb - v_per_coulomb) / storage.sigma_v_per_coulomb.unwrap();
        let dc = (fit.erm.dc_resistance_ohm() - 0.012) / sigma;
        assert!(
            off.abs() < 3.5 && dc.abs() < 3.5 && sigma < 1e-4,
            "{points} points, {v_per_coulomb}: {storage:?}, {off}; DC {dc} of {sigma}"
        );
        let warned = fit
            .warnings
            .words()
            .iter()
            .filter(|w| w.starts_with("these data want"))
            .count();
        let beyond = (v_per_coulomb - prior.v_per_coulomb) / prior.sigma_v_per_coulomb;
        assert_eq!(
            warned,
            usize::from(beyond > 3.0),
            "{beyond}: {:?}",
            fit.warnings
        );
    }
}
