//! Optima of the thesis from many seeds, and the minima beside them.

use std::sync::atomic::{AtomicU64, Ordering};

use super::thesis::{expected, real_sweeps};
use crate::fit::{
    Bounds, CellSweeps, FitOptions, Objective, batch::Batch, fit_cells, fit_erm, problem::Problem,
    projection::Projection, survey_seeds,
};
use analysis_numeric::{Columns, Rng, Smooth};

#[test]
fn sixty_seeds_of_sixty_reach_appendix_a() {
    let sweeps = real_sweeps();
    let done = AtomicU64::new(0);
    for (i, (objective, _)) in expected().into_iter().enumerate() {
        let survey = survey_seeds(
            &sweeps,
            &FitOptions {
                rc: i + 1,
                seed: 100,
                ..FitOptions::default()
            },
            60,
            &|| {
                done.fetch_add(1, Ordering::Relaxed);
            },
        )
        .unwrap();
        assert_eq!((survey.at_best, survey.seeds), (60, 60), "{} RC", i + 1);
        assert_eq!(done.swap(0, Ordering::Relaxed), 60);
        assert!(
            (survey.best.objective - objective).abs() < 5e-6 && survey.best.is_proven(),
            "{:?}",
            survey.best
        );
    }
}

#[test]
fn the_one_branch_of_the_appendix_is_a_local_minimum() {
    let sweeps = real_sweeps();
    let fit = fit_erm(
        &sweeps,
        &FitOptions {
            rc: 1,
            ..FitOptions::default()
        },
    )
    .unwrap();
    let local = fit.other_minima.first().unwrap();
    // Appendix A, one RC circuit.
    assert!(
        (local.objective / 0.241_734 - 1.0).abs() < 1e-5,
        "{local:?}"
    );
    let branch = local.parameters.branches[0];
    for (met, printed) in [
        (local.parameters.r_ohm, 0.008_562_246),
        (branch.r_ohm, 0.002_399_951),
        (branch.c_f, 700.437_7),
    ] {
        assert!((met / printed - 1.0).abs() < 1e-3, "{met} {printed}");
    }
    assert!(
        local.is_proven() && local.held_by_bounds.is_empty(),
        "{local:?}"
    );
    // A minimum by brute force: every step of 0.1 % to 3 % in 26 directions is uphill.
    let problem = Problem::new(&sweeps, Objective::SumAbs);
    let x = local.parameters.log_parameters();
    let here = problem.value(&x);
    for step in [1e-3, 1e-2, 3e-2] {
        for direction in (0..27).filter(|d| *d != 13) {
            let moved: Vec<f64> = (0..3)
                .map(|i| x[i] + step * f64::from(direction / 3i32.pow(i as u32) % 3 - 1))
                .collect();
            assert!(problem.value(&moved) > here, "{step} {direction}");
        }
    }
}

#[test]
fn more_starts_never_make_it_worse() {
    let sweeps = real_sweeps();
    let options = FitOptions {
        rc: 2,
        ..FitOptions::default()
    };
    let cells = [CellSweeps {
        cell: "all".into(),
        named: false,
        sweeps: sweeps.clone(),
    }];
    let (few, many) = (
        fit_erm(&sweeps, &options).unwrap(),
        fit_cells(&cells, &options, 12).unwrap(),
    );
    assert!(
        many.objective <= few.objective * (1.0 + 1e-9)
            && many.other_minima.len() >= few.other_minima.len()
    );
}

/// Eight lanes and one member at a time are two programs of one sum.
#[test]
fn side_by_side_gives_what_one_by_one_gives() {
    let sweeps = real_sweeps();
    let bounds = Bounds::default();
    let (members, rc) = (19, 3);
    for objective in [Objective::Complex, Objective::SumAbs, Objective::Modulus] {
        let problem = Problem::new(&sweeps, objective);
        let mut rng = Rng::new(6);
        let mut columns = Columns::new(rc, members);
        let all: Vec<Vec<f64>> = (0..members)
            .map(|_| (0..rc).map(|_| -9.0 + 14.0 * rng.uniform()).collect())
            .collect();
        all.iter()
            .enumerate()
            .for_each(|(i, x)| columns.write(i, x));
        let mut met = vec![0.0; members];
        Batch::new(&problem, &bounds, rc).values(&columns, &mut met);
        let mut projection = Projection::new(&problem, &bounds);
        for (x, met) in all.iter().zip(met) {
            let expected = problem.value(&projection.parameters(x));
            // Complex is exact; the reweighted ones stop after equal rounds, the corner of the norm
            // apart.
            let tolerance = if objective == Objective::Complex {
                1e-8
            } else {
                1e-4
            };
            assert!(
                (met / expected - 1.0).abs() < tolerance,
                "{objective}: {met} {expected} at {x:?}"
            );
        }
    }
}
