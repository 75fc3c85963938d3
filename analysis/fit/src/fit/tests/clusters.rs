//! Sigmas of pooled sweeps that share cells, against the scatter of the cells.

use super::noisy;
use crate::fit::{
    CellSweeps, CircuitOptions, FitOptions, Objective, fit_cells, fit_circuit_cells, fit_erm,
    profiles,
};
use analysis_files::formats::read_sourced;
use analysis_numeric::{Covariance2, Rng};
use analysis_signal::spectrum::{SharedError, SourcedSpectrum, Spectrum};
use std::path::Path;

fn thesis_cells() -> Vec<CellSweeps> {
    let table =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/data/spectra/p45b_thesis.csv");
    let sourced: Vec<SourcedSpectrum> = read_sourced(&table)
        .unwrap()
        .into_iter()
        .filter(|s| s.origin.is_unbiased_cell())
        .collect();
    CellSweeps::sort(&sourced)
}

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64).sqrt()
}

#[test]
fn the_thesis_sigmas_are_the_scatter_of_its_five_cells() {
    let cells = thesis_cells();
    assert_eq!(cells.len(), 5);
    for objective in [Objective::Complex, Objective::SumAbs, Objective::Modulus] {
        let options = FitOptions {
            rc: 2,
            objective,
            ..FitOptions::default()
        };
        let fit = fit_cells(&cells, &options, 0).unwrap();
        let own: Vec<_> = cells
            .iter()
            .map(|c| fit_erm(&c.sweeps, &options).unwrap().erm)
            .collect();
        let of_mean = |value: fn(&analysis_model::model::Erm) -> f64| {
            deviation(&own.iter().map(value).collect::<Vec<_>>()) / 5f64.sqrt()
        };
        for (name, expected, met) in [
            ("R", of_mean(|e| e.r_ohm), fit.sigma.r_ohm.unwrap()),
            (
                "DC resistance",
                of_mean(|e| e.dc_resistance_ohm()),
                fit.sigma.dc_resistance_ohm.unwrap(),
            ),
        ] {
            // Five values scatter by 35 %, and a sum of norms takes another middle of all sweeps
            // than of a cell's.
            let band = if objective == Objective::SumAbs {
                0.55..1.5
            } else {
                0.75..1.35
            };
            assert!(
                band.contains(&(expected / met)),
                "{objective}, {name}: cells {expected}, stated {met}"
            );
        }
        assert_eq!(fit.cells, Some(5));
        let remark = "the sigmas rest on how only 5 cells scatter: they are themselves known to \
        about 35 %, and a 95 % interval takes 2.78 sigma, not 1.96";
        assert_eq!(fit.warnings.words().last().unwrap(), remark);
    }
    let one = fit_cells(
        &cells[..1],
        &FitOptions {
            rc: 1,
            ..FitOptions::default()
        },
        0,
    )
    .unwrap();
    assert_eq!(
        (
            one.cells,
            one.warnings
                .words()
                .last()
                .unwrap()
                .starts_with("all sweeps are of one cell: ")
        ),
        (None, true)
    );
}

/// Cells that differ by a factor of 1 %, five sweeps each with noise of 0.2 %.
fn drawn(count: usize, rng: &mut Rng) -> Vec<CellSweeps> {
    let cell = |k: usize, rng: &mut Rng| {
        let factor = 1.0 + 0.01 * rng.normal();
        let sweep = |rng: &mut Rng| -> Spectrum {
            let mut spectrum = noisy(
                (0.007 * factor, &[(0.003 * factor, 10.0 / factor)]),
                15,
                0.002,
                rng,
            );
            spectrum
                .points
                .iter_mut()
                .for_each(|p| p.covariance = Covariance2::UNKNOWN);
            spectrum
        };
        CellSweeps {
            cell: format!("cell {k}"),
            named: true,
            sweeps: (0..5).map(|_| sweep(rng)).collect(),
        }
    };
    (0..count).map(|k| cell(k, rng)).collect()
}

#[test]
fn stated_sigmas_are_the_scatter_of_repeated_pools() {
    // 80 pools of six cells: the scatter is known to 8 %, and the mean of the stated variances to 7
    // %.
    let mut rng = Rng::new(11);
    let pools: Vec<_> = (0..80).map(|_| drawn(6, &mut rng)).collect();
    for objective in [Objective::Complex, Objective::SumAbs] {
        let options = FitOptions {
            rc: 1,
            objective,
            ..FitOptions::default()
        };
        let fits: Vec<_> = pools
            .iter()
            .map(|cells| fit_cells(cells, &options, 0).unwrap())
            .collect();
        let scatter = deviation(&fits.iter().map(|f| f.erm.r_ohm).collect::<Vec<_>>());
        let stated = (fits
            .iter()
            .map(|f| f.sigma.r_ohm.unwrap().powi(2))
            .sum::<f64>()
            / fits.len() as f64)
            .sqrt();
        assert!(
            (0.8..1.25).contains(&(stated / scatter)),
            "{objective}: stated {stated}, scatter {scatter}"
        );
    }
}

/// With stated covariances and a gain that all cells are measured with.
#[test]
fn cells_differ_by_more_than_the_stated_noise_of_their_sweeps() {
    const GAIN: f64 = 0.005;
    let mut rng = Rng::new(12);
    let pool = |rng: &mut Rng| {
        let mut cells = drawn(6, rng);
        let gain = 1.0 + GAIN * rng.normal();
        for spectrum in cells.iter_mut().flat_map(|cell| &mut cell.sweeps) {
            for point in &mut spectrum.points {
                let sigma = 0.002 * point.z_ohm.norm();
                point.z_ohm *= gain;
                point.covariance =
                    Covariance2::circular(sigma * sigma) + Covariance2::along(GAIN * point.z_ohm);
            }
            spectrum.shared = vec![SharedError {
                name: "gain".to_owned(),
                at_ohm: spectrum
                    .points
                    .iter()
                    .map(|point| GAIN * point.z_ohm)
                    .collect(),
            }];
        }
        fit_cells(
            &cells,
            &FitOptions {
                rc: 1,
                objective: Objective::Complex,
                ..FitOptions::default()
            },
            0,
        )
        .unwrap()
    };
    let fits: Vec<_> = (0..80).map(|_| pool(&mut rng)).collect();
    for (name, value, sigma) in [
        (
            "R",
            fits.iter().map(|f| f.erm.r_ohm).collect::<Vec<f64>>(),
            fits.iter()
                .map(|f| f.sigma.r_ohm.unwrap())
                .collect::<Vec<f64>>(),
        ),
        (
            "DC resistance",
            fits.iter().map(|f| f.erm.dc_resistance_ohm()).collect(),
            fits.iter()
                .map(|f| f.sigma.dc_resistance_ohm.unwrap())
                .collect(),
        ),
    ] {
        let stated = (sigma.iter().map(|s| s * s).sum::<f64>() / sigma.len() as f64).sqrt();
        assert!(
            (0.8..1.25).contains(&(stated / deviation(&value))),
            "{name}: stated {stated}, scatter {}",
            deviation(&value)
        );
    }
    // Within the cells the model fits, however much they differ: 80 fits of 1 800 numbers each.
    let chi2 = fits.iter().map(|f| f.reduced_chi2.unwrap()).sum::<f64>() / 80.0;
    assert!((0.98..1.02).contains(&chi2), "{chi2}");
    for fit in &fits {
        assert!(
            fit.cells == Some(6) && fit.warnings.len() == 1,
            "{:?}",
            fit.warnings
        );
    }
    assert!((fits[0].sigmas_of_95() - 2.5706).abs() < 1e-3);
}

/// The first cell was measured five times and best; the mean of the cells is that of all of them.
#[test]
fn a_cell_counts_once_however_often_it_was_measured() {
    let mut rng = Rng::new(13);
    let cell = |(k, scale): (usize, f64), rng: &mut Rng| {
        let sigma = if k == 0 { 1e-4 } else { 2e-3 };
        let sweep = |rng: &mut Rng| {
            let mut spectrum = noisy(
                (0.006 * scale, &[(0.003 * scale, 10.0 / scale)]),
                15,
                sigma,
                rng,
            );
            spectrum.points.iter_mut().for_each(|p| {
                p.covariance = Covariance2::circular((sigma * p.z_ohm.norm()).powi(2));
            });
            spectrum
        };
        CellSweeps {
            cell: format!("cell {k}"),
            named: true,
            sweeps: (0..if k == 0 { 5 } else { 1 })
                .map(|_| sweep(rng))
                .collect(),
        }
    };
    let cells: Vec<CellSweeps> = [1.10, 0.95, 1.00, 0.97, 0.98]
        .into_iter()
        .enumerate()
        .map(|of| cell(of, &mut rng))
        .collect();
    let fit = fit_cells(
        &cells,
        &FitOptions {
            rc: 1,
            objective: Objective::Complex,
            ..FitOptions::default()
        },
        0,
    )
    .unwrap();
    assert!((fit.erm.r_ohm / 0.006 - 1.0).abs() < 0.003, "{fit:?}");
    // Of the five scales: a scatter of 5.9 %, 2.6 % of their mean.
    assert!(
        (fit.sigma.r_ohm.unwrap() / 0.006 - 0.0259).abs() < 0.003,
        "{fit:?}"
    );
}

#[test]
fn circuits_and_profiles_say_the_same() {
    let cells = drawn(5, &mut Rng::new(3));
    let circuit = "R0-p(R1,C1)".parse().unwrap();
    for objective in [Objective::Complex, Objective::SumAbs, Objective::Modulus] {
        let fit = fit_cells(
            &cells,
            &FitOptions {
                rc: 1,
                objective,
                ..FitOptions::default()
            },
            0,
        )
        .unwrap();
        let other = fit_circuit_cells(
            &cells,
            &circuit,
            &CircuitOptions {
                objective,
                ..CircuitOptions::default()
            },
        )
        .unwrap();
        let (met, expected) = (other.sigmas[0].unwrap(), fit.sigma.r_ohm.unwrap());
        assert!(
            (met / expected - 1.0).abs() < 0.01,
            "{objective}: {met} against {expected}"
        );
        assert_eq!(other.warnings.words().last(), fit.warnings.words().last());
        // Student's t of four degrees of freedom: 2.776 at 95 %.
        let spectra: Vec<Spectrum> = cells.iter().flat_map(|c| c.sweeps.clone()).collect();
        let profile = &profiles(&spectra, &fit).unwrap()[0];
        let (low, high) = (
            profile.interval_95.low.unwrap(),
            profile.interval_95.high.unwrap(),
        );
        let half = 0.5 * (high - low) / expected;
        // Away from the middle a sum of norms rises in steps, one for each cell.
        let tolerance = if objective == Objective::SumAbs {
            0.3
        } else {
            0.1
        };
        assert!(
            (half / 2.776 - 1.0).abs() < tolerance,
            "{objective}: half of the interval is {half} sigma"
        );
    }
}
