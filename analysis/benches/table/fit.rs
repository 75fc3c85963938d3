//! Time of global fits of the ERM, and the share of them that end at the optimum. "At the optimum"
//! counts seeds whose objective is within 1e-6 of the best of all seeds. The data of the simulated
//! sweeps differ from seed to seed; there the best comes from eight further seeds of the search.

use analysis::{
    fit::{FitOptions, Objective, fit_erm},
    formats::read_unbiased_cells,
    numeric::{Covariance2, Rng},
    spectrum::{ImpedancePoint, Spectrum},
};
use num_complex::Complex64;
use std::path::Path;
use std::time::Instant;

use crate::{Row, Unit};

/// Appendix A's four branches, by rising time constant: R, then (R, C).
const CELL: (f64, [(f64, f64); 4]) = (
    0.006_428_63,
    [
        (0.001_509_24, 0.552_812),
        (0.000_662_797, 6.979_85),
        (0.000_404_066, 663.817),
        (0.004_774_06, 1_084.24),
    ],
);

const SEEDS: u64 = 1000;
const POOLED_SEEDS: u64 = 60;

/// Returns the figures.
pub(crate) fn rows() -> Vec<Row> {
    let table =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/data/spectra/p45b_thesis.csv");
    let sweeps = read_unbiased_cells(&table).unwrap();
    let one_core = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    let objectives = [Objective::SumAbs, Objective::Complex, Objective::Modulus];
    let simulated = objectives.map(|objective| one_core.install(|| simulated(objective, SEEDS)));
    let pooled = [1, 2, 3, 4]
        .map(|rc| one_core.install(|| pooled(&sweeps, rc, Objective::SumAbs, POOLED_SEEDS)));
    simulated.into_iter().chain(pooled).collect()
}

/// One sweep of 20 points with 0.5 % noise per seed, 4 RC.
fn simulated(objective: Objective, seeds: u64) -> Row {
    let mut seconds = Vec::new();
    let mut met = 0;
    for seed in 0..seeds {
        let data = [noisy(seed)];
        let options = |seed| FitOptions {
            rc: 4,
            objective,
            seed,
            ..FitOptions::default()
        };
        let start = Instant::now();
        let value = fit_erm(&data, &options(seed)).unwrap().objective;
        seconds.push(start.elapsed().as_secs_f64());
        let best = (0..8)
            .map(|k| fit_erm(&data, &options(seeds + k)).unwrap().objective)
            .fold(value, f64::min);
        met += usize::from(value <= best * (1.0 + 1e-6));
    }
    let work = if objective == Objective::Modulus {
        ""
    } else {
        "fit-global-4rc"
    };
    Row::new(
        work,
        &format!("global fit, 4 RC, 20 points, {objective}"),
        median(seconds),
        Unit::Seconds,
    )
    .noted(format!("{met} of {seeds} at the optimum"))
}

/// All real sweeps, another seed of the search each time.
fn pooled(sweeps: &[Spectrum], rc: usize, objective: Objective, seeds: u64) -> Row {
    let mut seconds = Vec::new();
    let mut values = Vec::new();
    for seed in 0..seeds {
        let start = Instant::now();
        values.push(
            fit_erm(
                sweeps,
                &FitOptions {
                    rc,
                    objective,
                    seed,
                    ..FitOptions::default()
                },
            )
            .unwrap()
            .objective,
        );
        seconds.push(start.elapsed().as_secs_f64());
    }
    let best = values.iter().copied().fold(f64::INFINITY, f64::min);
    let met = values.iter().filter(|v| **v <= best * (1.0 + 1e-6)).count();
    Row::new(
        "",
        &format!("global fit, {rc} RC, 25 real sweeps pooled, {objective}"),
        median(seconds),
        Unit::Seconds,
    )
    .noted(format!("{met} of {seeds} at the optimum"))
}

/// Of the fits' times: a machine that does other work now and then does not count.
fn median(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds.get(seconds.len() / 2).copied().unwrap_or(f64::NAN)
}

fn noisy(seed: u64) -> Spectrum {
    let mut rng = Rng::new(seed + 1_000_000);
    let point = |k: i32| {
        let freq_hz = 0.1 * 3000f64.powf(f64::from(k) / 19.0);
        let one =
            |(r, c): &(f64, f64)| *r / Complex64::new(1.0, std::f64::consts::TAU * freq_hz * r * c);
        let z: Complex64 = CELL.1.iter().map(one).sum::<Complex64>() + CELL.0;
        let sigma = 0.005 * z.norm();
        let z_ohm = z + sigma * Complex64::new(rng.normal(), rng.normal());
        ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance: Covariance2::UNKNOWN,
            amplitude_a: 1.0,
        }
    };
    Spectrum {
        name: "simulated".into(),
        points: (0..20).map(point).collect(),
        ..Spectrum::default()
    }
}
