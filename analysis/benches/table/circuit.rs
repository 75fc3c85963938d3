//! Time that fits of circuits take, with covariance, and share of them that end at the best known
//! optimum.

use analysis::{
    fit::{CircuitOptions, fit_circuit},
    model::Circuit,
    numeric::{Covariance2, Rng},
    spectrum::{ImpedancePoint, Spectrum},
};
use num_complex::Complex64;
use std::hint::black_box;

use crate::{Row, Unit};

/// One line of the table.
struct Case {
    name: &'static str,
    circuit: &'static str,
    truth: Vec<f64>,
    /// Start values a third off the truth, or none.
    guessed: bool,
}

const FOUR_RC: &str = "R0-p(R1,C1)-p(R2,C2)-p(R3,C3)-p(R4,C4)";
const DIFFUSION: &str = "R0-p(R1,C1)-p(R2-Wo1,CPE1)";
const SEEDS: u64 = 40;
const POINTS: u32 = 20;
const NOISE: f64 = 0.005;

/// Returns the figures.
pub(crate) fn rows() -> Vec<Row> {
    let four = vec![
        0.00643, 0.00151, 0.553, 0.000_663, 6.98, 0.000_404, 664.0, 0.004_77, 1084.0,
    ];
    let diffusion = vec![0.0165, 0.0087, 3.3, 0.0054, 0.063, 233.0, 0.22, 0.9];
    let cases = [
        Case {
            name: "local fit of 4 RC as a circuit, covariance included, good start",
            circuit: FOUR_RC,
            truth: four.clone(),
            guessed: true,
        },
        Case {
            name: "fit of 4 RC as a circuit, no start",
            circuit: FOUR_RC,
            truth: four,
            guessed: false,
        },
        Case {
            name: "fit of R0-p(R1,C1)-p(R2-Wo1,CPE1), no start",
            circuit: DIFFUSION,
            truth: diffusion,
            guessed: false,
        },
    ];
    let row = |case: &Case| {
        let (seconds, fraction) = run(case);
        let work = if case.guessed { "fit-local-4rc" } else { "" };
        Row::new(work, case.name, seconds, Unit::Seconds).noted(format!(
            "{:.1} % of {SEEDS} at the best known optimum",
            100.0 * fraction
        ))
    };
    cases.iter().map(row).collect()
}

/// Returns the median seconds of a fit, and the fraction of the seeds that end within 1e-6 of the
/// best value that any fit of the same data reaches.
fn run(case: &Case) -> (f64, f64) {
    let Ok(circuit) = case.circuit.parse::<Circuit>() else {
        return (f64::NAN, 0.0);
    };
    let guess = if case.guessed {
        case.truth
            .iter()
            .enumerate()
            .map(|(i, p)| (i, p * if i % 2 == 0 { 1.3 } else { 0.75 }))
            .collect()
    } else {
        Vec::new()
    };
    let (mut seconds, mut at_optimum) = (Vec::new(), 0);
    for seed in 0..SEEDS {
        let spectra = [simulated(&circuit, &case.truth, seed)];
        let options = CircuitOptions {
            guess: guess.clone(),
            seed,
            ..CircuitOptions::default()
        };
        let value = |options: &CircuitOptions| {
            fit_circuit(&spectra, &circuit, options).map_or(f64::INFINITY, |fit| fit.objective)
        };
        let began = std::time::Instant::now();
        let met = black_box(value(black_box(&options)));
        seconds.push(began.elapsed().as_secs_f64());
        let from_truth = CircuitOptions {
            guess: case.truth.iter().copied().enumerate().collect(),
            ..CircuitOptions::default()
        };
        let many = CircuitOptions {
            guess: Vec::new(),
            starts: Some(64),
            seed: seed + 1000,
            ..CircuitOptions::default()
        };
        let best = value(&from_truth).min(value(&many)).min(met);
        at_optimum += u32::from(met <= best * (1.0 + 1e-6));
    }
    seconds.sort_by(f64::total_cmp);
    (
        seconds[seconds.len() / 2],
        f64::from(at_optimum) / SEEDS as f64,
    )
}

/// Returns a spectrum of 20 points from 0.1 to 300 Hz (of a diffusion from 3 mHz to 1 kHz) with
/// independent normal noise of 0.5 % in each part.
fn simulated(circuit: &Circuit, truth: &[f64], seed: u64) -> Spectrum {
    let mut rng = Rng::new(seed);
    let (low, high) = if truth.len() == 9 {
        (0.1, 300.0f64)
    } else {
        (3e-3, 1e3)
    };
    let mut point = |k: u32| {
        let freq_hz = low * (high / low).powf(f64::from(k) / f64::from(POINTS - 1));
        let z = circuit.impedance(truth, freq_hz);
        let sigma = NOISE * z.norm();
        let z_ohm = z + sigma * Complex64::new(rng.normal(), rng.normal());
        ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance: Covariance2::circular(sigma * sigma),
            amplitude_a: 1.0,
        }
    };
    Spectrum {
        name: "simulated".to_owned(),
        points: (0..POINTS).map(&mut point).collect(),
        ..Spectrum::default()
    }
}
