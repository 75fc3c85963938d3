//! The thesis' own 25 sweeps against its appendix A.

use crate::fit::{FitOptions, Objective, fit_erm, problem::Problem};
use analysis_files::formats::read_unbiased_cells;
use analysis_numeric::Smooth;
use analysis_signal::spectrum::Spectrum;
use std::path::Path;

pub(super) fn real_sweeps() -> Vec<Spectrum> {
    let table =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/data/spectra/p45b_thesis.csv");
    let sweeps = read_unbiased_cells(&table).unwrap();
    assert_eq!(
        (
            sweeps.len(),
            sweeps.iter().map(|s| s.points.len()).sum::<usize>()
        ),
        (25, 500)
    );
    sweeps
}

/// Appendix A in the order of rising time constants: objective in Ω, then R, R1, C1, … For one
/// branch the global optimum, which the appendix misses: its 0.2417 Ω is a local one.
pub(super) fn expected() -> [(f64, Vec<f64>); 4] {
    [
        (0.193_24, vec![0.006_935, 0.001_709, 1.196]),
        (
            0.072_555,
            vec![0.006_923_69, 0.001_706_49, 1.171_46, 0.002_574_39, 749.955],
        ),
        (
            0.046_394,
            vec![
                0.006_795_70,
                0.001_734_87,
                0.966_864,
                0.000_353_960,
                371.892,
                0.003_791_92,
                963.364,
            ],
        ),
        (
            0.033_027,
            vec![
                0.006_428_63,
                0.001_509_24,
                0.552_812,
                0.000_662_797,
                6.979_85,
                0.000_404_066,
                663.817,
                0.004_774_06,
                1_084.24,
            ],
        ),
    ]
}

#[test]
fn appendix_a_comes_out_of_the_default_start() {
    let sweeps = real_sweeps();
    for (i, (objective, parameters)) in expected().into_iter().enumerate() {
        let fit = fit_erm(
            &sweeps,
            &FitOptions {
                rc: i + 1,
                ..FitOptions::default()
            },
        )
        .unwrap();
        assert!(
            (fit.objective - objective).abs() < 5e-6,
            "{} RC: expected {objective} Ω, met {} Ω",
            i + 1,
            fit.objective
        );
        // The appendix' search stopped a little above the bottom, where the values with three
        // branches are 0.25 % off: see the value there.
        let tolerance = [1e-3, 1e-3, 2.6e-3, 5e-3][i];
        let logarithms: Vec<f64> = parameters.iter().map(|p| p.ln()).collect();
        assert!(Problem::new(&sweeps, Objective::SumAbs).value(&logarithms) > fit.objective);
        let met: Vec<f64> = fit.erm.log_parameters().iter().map(|x| x.exp()).collect();
        assert_eq!(met.len(), parameters.len());
        for ((name, met), expected) in fit.erm.parameter_names().iter().zip(&met).zip(&parameters) {
            assert!(
                (met / expected - 1.0).abs() < tolerance,
                "{} RC, {name}: expected {expected}, met {met}",
                i + 1
            );
        }
        assert_eq!((fit.points, fit.spectra), (500, 25));
    }
}

#[test]
fn the_other_objectives_are_stable_too() {
    let sweeps = real_sweeps();
    for objective in [Objective::Complex, Objective::Modulus] {
        for rc in 0..=4 {
            let fit = |seed| {
                fit_erm(
                    &sweeps,
                    &FitOptions {
                        rc,
                        objective,
                        seed,
                        ..FitOptions::default()
                    },
                )
                .unwrap()
                .objective
            };
            let first = fit(0);
            for seed in 1..4 {
                assert!(
                    (fit(seed) / first - 1.0).abs() < 1e-9,
                    "{objective}, {rc} RC, seed {seed}"
                );
            }
        }
    }
}

#[test]
fn what_the_band_cannot_show_is_said() {
    let sweeps = real_sweeps();
    let fit = fit_erm(&sweeps, &FitOptions::default()).unwrap();
    let expected = "branch 4: its time constant of 5.172 s is beyond the 1.592 s of the lowest \
    frequency (0.1 Hz): R4 and C4 are extrapolated";
    assert_eq!(fit.warnings.words(), [expected]);
    // One cell repeats within 0.3 %, five cells differ by 0.8 %: the pooled R is known far better
    // than any one cell's.
    let relative = fit.sigma.r_ohm.unwrap() / fit.erm.r_ohm;
    assert!((0.0005..0.01).contains(&relative), "{relative}");
    assert!((fit.rms_ohm - 0.080e-3).abs() < 0.001e-3, "{}", fit.rms_ohm);
}
