//! Circuits whose parameters are known: recovery without noise, honest uncertainty with it, and
//! laws.

use super::{Circuit, exact, noisy};
use crate::fit::{ErmFit, FitOptions, Objective, fit_erm, problem::Problem};
use analysis_numeric::{Rng, Smooth};
use analysis_signal::spectrum::Spectrum;
use proptest::prelude::*;

const ALL: [Objective; 3] = [Objective::SumAbs, Objective::Modulus, Objective::Complex];
const TWO: Circuit<'static> = (0.007, &[(0.0017, 1.2), (0.0026, 200.0)]);

fn fit(spectra: &[Spectrum], rc: usize, objective: Objective) -> ErmFit {
    fit_erm(
        spectra,
        &FitOptions {
            rc,
            objective,
            ..FitOptions::default()
        },
    )
    .unwrap()
}

fn flat((r, branches): Circuit<'_>) -> Vec<f64> {
    std::iter::once(r)
        .chain(branches.iter().flat_map(|(r, c)| [*r, *c]))
        .collect()
}

fn worst_relative_error(fit: &ErmFit, circuit: Circuit<'_>) -> f64 {
    let met = fit.erm.log_parameters();
    met.iter()
        .zip(flat(circuit))
        .map(|(x, p)| (x.exp() / p - 1.0).abs())
        .fold(0.0, f64::max)
}

#[test]
fn exact_data_give_the_circuit_back() {
    let circuits: [(Circuit<'_>, f64); 3] = [
        ((0.0085, &[(0.0024, 700.0)]), 1e-6),
        (TWO, 1e-6),
        (
            (
                0.0064,
                &[
                    (0.0015, 0.55),
                    (0.0007, 12.0),
                    (0.0005, 300.0),
                    (0.004, 250.0),
                ],
            ),
            1e-3,
        ),
    ];
    for (circuit, tolerance) in circuits {
        for objective in ALL {
            let fit = fit(&[exact(circuit, 40)], circuit.1.len(), objective);
            let error = worst_relative_error(&fit, circuit);
            assert!(error < tolerance, "{objective}: {error:e} in {:?}", fit.erm);
        }
    }
}

#[test]
fn a_resistor_needs_no_branch() {
    let resistor: Circuit<'_> = (0.00996, &[]);
    for objective in ALL {
        let plain = fit(&[exact(resistor, 20)], 0, objective);
        assert!(
            (plain.erm.r_ohm - 0.00996).abs() < 1e-12 && plain.erm.branches.is_empty(),
            "{objective}: {plain:?}"
        );
        let adorned = fit(&[exact(resistor, 20)], 1, objective);
        assert!(
            (adorned.erm.impedance(3.0) - 0.00996).norm() < 3e-6,
            "{objective}: {adorned:?}"
        );
        assert!(
            !adorned.warnings.is_empty(),
            "{objective}: a branch without evidence must be called so"
        );
    }
}

#[test]
fn stated_uncertainty_covers_the_error() {
    // 300 sweeps of known noise: the squared error over the stated variance averages 1 per
    // parameter, within 4 sigma of such a mean.
    let runs = 300;
    let mut rng = Rng::new(11);
    let mut sum = [0.0; 5];
    let mut chi2 = 0.0;
    for _ in 0..runs {
        let fit = fit(&[noisy(TWO, 20, 0.003, &mut rng)], 2, Objective::Complex);
        let covariance = fit.log_covariance.unwrap();
        chi2 += fit.reduced_chi2.unwrap();
        // Undo the widening of the unlucky half, which would hide an understated sigma.
        let widening = fit.reduced_chi2.unwrap().max(1.0);
        for (i, (x, p)) in fit.erm.log_parameters().iter().zip(flat(TWO)).enumerate() {
            sum[i] += (x - p.ln()).powi(2) / (covariance[i][i] / widening);
        }
    }
    for (i, s) in sum.iter().enumerate() {
        assert!(
            (s / f64::from(runs) - 1.0).abs() < 4.0 * (2.0 / f64::from(runs)).sqrt(),
            "parameter {i}: {}",
            s / f64::from(runs)
        );
    }
    assert!(
        (chi2 / f64::from(runs) - 1.0).abs() < 0.05,
        "{}",
        chi2 / f64::from(runs)
    );
}

#[test]
fn uncertainty_without_stated_noise_is_of_the_right_size() {
    // Only the residuals are known; over points of one sweep, and over sweeps when there are many.
    for (sweeps, objective, low, high) in [
        (1, Objective::SumAbs, 0.75, 1.25),
        (1, Objective::Complex, 0.75, 1.25),
        // A variance of eleven degrees of freedom: the mean of its inverse is 11/9.
        (12, Objective::SumAbs, 0.95, 1.5),
        (12, Objective::Complex, 0.95, 1.5),
    ] {
        let mut rng = Rng::new(5);
        let runs = 80;
        let mut ratio = 0.0;
        for _ in 0..runs {
            let mut spectra: Vec<Spectrum> = (0..sweeps)
                .map(|_| noisy(TWO, 60, 0.003, &mut rng))
                .collect();
            spectra
                .iter_mut()
                .flat_map(|s| &mut s.points)
                .for_each(|p| p.covariance = analysis_numeric::Covariance2::UNKNOWN);
            let fit = fit(&spectra, 2, objective);
            let covariance = fit.log_covariance.as_ref().unwrap();
            let errors = fit
                .erm
                .log_parameters()
                .into_iter()
                .zip(flat(TWO))
                .enumerate();
            ratio += errors
                .map(|(i, (x, p))| (x - p.ln()).powi(2) / covariance[i][i])
                .sum::<f64>()
                / 5.0;
        }
        let ratio = ratio / f64::from(runs);
        assert!(
            (low..high).contains(&ratio),
            "{sweeps} sweeps, {objective}: {ratio}"
        );
    }
}

#[test]
fn warnings_say_what_is_wrong() {
    let lone_fast: Circuit<'_> = (0.007, &[(0.002, 0.02)]);
    let fit_fast = fit(&[exact(lone_fast, 20)], 1, Objective::Complex);
    assert!(
        fit_fast.warnings.words().iter().any(|w| w.starts_with(
            "branch 1: its time constant of 0.040 ms is \
        below the 0.531 ms"
        )),
        "{:?}",
        fit_fast.warnings
    );
    let huge: Circuit<'_> = (0.2, &[(0.05, 10.0)]);
    let at_bound = fit(&[exact(huge, 20)], 1, Objective::SumAbs);
    assert!(
        at_bound
            .warnings
            .words()
            .contains(&"R is at its upper bound of 0.1 Ω".to_owned()),
        "{:?}",
        at_bound.warnings
    );
    let mut understated = noisy(TWO, 30, 0.01, &mut Rng::new(2));
    understated.points.iter_mut().for_each(|p| {
        p.covariance.re_re /= 100.0;
        p.covariance.im_im /= 100.0;
    });
    let missed = fit(&[understated.clone()], 2, Objective::Complex);
    assert!(
        missed
            .warnings
            .words()
            .iter()
            .any(|w| w.starts_with("reduced χ² is ")),
        "{:?}",
        missed.warnings
    );
    understated.points[3].covariance = analysis_numeric::Covariance2::UNKNOWN;
    let mixed = fit(&[understated], 2, Objective::Complex);
    let expected = "only 29 of 30 points have a usable covariance: all residuals were weighted \
    relative to |Z| instead";
    assert!(
        mixed.warnings.words().contains(&expected.to_owned()) && mixed.reduced_chi2.is_none(),
        "{:?}",
        mixed.warnings
    );
    let greedy = fit(
        &[noisy(TWO, 20, 0.005, &mut Rng::new(3))],
        4,
        Objective::Complex,
    );
    assert!(
        greedy
            .warnings
            .words()
            .iter()
            .any(|w| w.contains("not identified") || w.contains("no uncertainty")),
        "{:?}",
        greedy.warnings
    );
}

#[test]
fn order_of_spectra_and_points_does_not_matter() {
    let mut rng = Rng::new(9);
    let mut spectra: Vec<Spectrum> = (0..4).map(|_| noisy(TWO, 20, 0.003, &mut rng)).collect();
    let first: Vec<f64> = ALL.iter().map(|o| fit(&spectra, 2, *o).objective).collect();
    spectra.reverse();
    spectra[1].points.reverse();
    for (objective, first) in ALL.into_iter().zip(first) {
        assert!(
            (fit(&spectra, 2, objective).objective / first - 1.0).abs() < 1e-10,
            "{objective}"
        );
    }
    assert_eq!(
        fit(&spectra, 2, Objective::SumAbs),
        fit(&spectra, 2, Objective::SumAbs),
        "equal seeds give equal fits"
    );
}

#[test]
fn derivatives_are_difference_quotients() {
    let x: Vec<f64> = flat((0.0065, &[(0.002, 1.5), (0.003, 150.0)]))
        .iter()
        .map(|p: &f64| p.ln())
        .collect();
    let mut data = noisy(TWO, 15, 0.01, &mut Rng::new(1));
    data.points
        .iter_mut()
        .for_each(|p| p.covariance.re_im = 0.4 * p.covariance.re_re);
    for objective in ALL {
        let problem = Problem::new(&[data.clone(), exact(TWO, 15), data.clone()], objective);
        let n = x.len();
        let (mut g, mut h) = (vec![0.0; n], vec![0.0; n * n]);
        let value = problem.expand(&x, &mut g, &mut h);
        assert!((problem.value(&x) / value - 1.0).abs() < 1e-12);
        for i in 0..n {
            let step = 1e-5;
            let at = |s: f64| {
                let mut y = x.clone();
                y[i] += s;
                let (mut gy, mut hy) = (vec![0.0; n], vec![0.0; n * n]);
                (problem.expand(&y, &mut gy, &mut hy), gy)
            };
            let ((up, g_up), (down, g_down)) = (at(step), at(-step));
            let scale = g.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            assert!(
                ((up - down) / (2.0 * step) - g[i]).abs() < 1e-6 * scale,
                "{objective}: gradient {i}"
            );
            for j in 0..n {
                let quotient = (g_up[j] - g_down[j]) / (2.0 * step);
                let scale = (h[i * n + i] * h[j * n + j]).abs().sqrt().max(scale);
                assert!(
                    (quotient - h[i * n + j]).abs() < 1e-6 * scale,
                    "{objective}: Hessian {i} {j}: {quotient} against {}",
                    h[i * n + j]
                );
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Impedances times k: resistances times k, capacitances over k, the objectives with their
    /// units.
    #[test]
    fn scaling_the_data_scales_the_model(k in 0.3..3.0f64, seed in 0..1000u64) {
        let data = noisy(TWO, 20, 0.004, &mut Rng::new(seed));
        let mut scaled = data.clone();
        scaled.points.iter_mut().for_each(|p| p.z_ohm *= k);
        for (objective, power) in [(Objective::SumAbs, 1), (Objective::Modulus, 2)] {
            let (a, b) = (
                fit(std::slice::from_ref(&data), 2, objective),
                fit(std::slice::from_ref(&scaled), 2, objective),
            );
            prop_assert!((b.objective / a.objective / k.powi(power) - 1.0).abs() < 1e-9);
            prop_assert!((b.erm.r_ohm / a.erm.r_ohm / k - 1.0).abs() < 1e-6);
            prop_assert!((b.erm.branches[1].c_f / a.erm.branches[1].c_f * k - 1.0).abs() < 1e-6);
        }
    }

    /// Circuits with branches at least a factor 6 apart inside the band come back whole from exact
    /// data.
    #[test]
    fn random_circuits_come_back(
        r in 0.001..0.03f64,
        resistances in prop::collection::vec(0.0003..0.01f64, 1..4),
        first in 0.6e-3..2e-3f64,
        gap in 6.0..15.0f64,
    ) {
        let branches: Vec<(f64, f64)> = resistances
            .iter()
            .zip(0..)
            .map(|(r, k)| (*r, first * gap.powi(k) / r))
            .collect();
        prop_assume!(branches.iter().all(|(_, c)| (0.011..9e4).contains(c)));
        for objective in [Objective::SumAbs, Objective::Complex] {
            let fit = fit(&[exact((r, &branches), 30)], branches.len(), objective);
            let error = worst_relative_error(&fit, (r, &branches));
            prop_assert!(error < 1e-4, "{}: {:e} in {:?}", objective, error, fit);
        }
    }
}

/// Twenty points of one sweep do not fix four branches: the bottom is flat and has many corners. It
/// is found from every seed all the same.
#[test]
fn one_noisy_sweep_has_one_optimum_whatever_the_seed() {
    let four: Circuit<'_> = (
        0.006_43,
        &[
            (0.0015, 0.553),
            (0.000_663, 6.98),
            (0.000_404, 664.0),
            (0.004_77, 1_084.0),
        ],
    );
    for objective in [Objective::SumAbs, Objective::Complex] {
        let mut rng = Rng::new(1);
        for run in 0..6 {
            let data = [noisy(four, 20, 0.005, &mut rng)];
            let at = |seed| {
                fit_erm(
                    &data,
                    &FitOptions {
                        rc: 4,
                        objective,
                        seed,
                        ..FitOptions::default()
                    },
                )
                .unwrap()
                .objective
            };
            let first = at(0);
            for seed in 1..4 {
                assert!(
                    (at(seed) / first - 1.0).abs() < 1e-8,
                    "{objective}, sweep {run}, seed {seed}: {} against {first}",
                    at(seed)
                );
            }
        }
    }
}
