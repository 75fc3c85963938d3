//! The global optimum of a circuit's fit: local fits from many starts, or differential evolution; then the polish to the last digits.

use super::options::{CircuitOptions, Search};
use super::problem::Problem;
use super::starts::{Ranges, Starter};
use crate::fit::global::{DeOptions, Strategy, differential_evolution};
use crate::fit::local::{LocalOptions, Minimum, Smooth, minimise};
use crate::fit::options::Objective;
use crate::fit::rng::Rng;
use rayon::prelude::*;

/// Starts when none are asked for.
const STARTS: usize = 64;
/// Starts of one round; after each the search may end.
const ROUND: usize = 8;
/// Random parameters looked at for each start, of which the best is taken.
const CANDIDATES: usize = 12;
/// So many starts at the same optimum are believed.
const AGREEING: usize = 3;
/// Values that differ by less than this fraction are the same optimum.
const SAME: f64 = 1e-6;
/// Distinct optima that are polished.
const FINALISTS: usize = 10;

/// The best optimum and how it was found.
pub(super) struct Found {
    pub(super) minimum: Minimum,
    /// Starts tried.
    pub(super) starts: usize,
    /// How many of them ended at this optimum.
    pub(super) agreeing: usize,
}

/// Looks for the global optimum; none when no start gives a finite value.
pub(super) fn search(problem: &Problem, starter: &Starter, options: &CircuitOptions) -> Option<Found> {
    let bounds: Vec<(f64, f64)> = problem.free.iter().map(|i| starter.bounds[*i]).collect();
    let lower = problem.variables(&spread(problem, &bounds, |b| b.0));
    let upper = problem.variables(&spread(problem, &bounds, |b| b.1));
    let bounds: Vec<(f64, f64)> = lower.into_iter().zip(upper).collect();
    let seeker = Seeker { problem, starter, bounds, seed: options.seed };
    let guessed = !options.guess.is_empty() && problem.free.iter().all(|i| options.guess.iter().any(|(g, _)| g == i));
    let mut minima = Vec::new();
    if guessed {
        minima.push(seeker.from(&starter.at(&[]).0));
    }
    match options.search {
        Search::Evolution => minima.extend(seeker.evolution()),
        Search::Starts => {
            let most = options.starts.unwrap_or(if guessed { 0 } else { STARTS });
            let fewest = if problem.data.objective == Objective::SumAbs { 3 * ROUND } else { ROUND };
            let mut done = 0;
            while done < most && (done < fewest || agreeing(&minima) < AGREEING) {
                let count = ROUND.min(most - done);
                let round: Vec<Minimum> = (done..done + count).into_par_iter().map(|k| seeker.drawn(k)).collect();
                minima.extend(round);
                done += count;
            }
        }
    }
    let (starts, agreeing) = (minima.len(), agreeing(&minima));
    seeker.finish(minima).map(|minimum| Found { minimum, starts, agreeing })
}

/// All parameters with the bounds of the free ones in their places.
fn spread(problem: &Problem, bounds: &[(f64, f64)], side: impl Fn(&(f64, f64)) -> f64) -> Vec<f64> {
    let mut p = problem.base.clone();
    for (i, b) in problem.free.iter().zip(bounds) {
        p[*i] = side(b);
    }
    p
}

fn agreeing(minima: &[Minimum]) -> usize {
    let best = minima.iter().map(|m| m.value).fold(f64::INFINITY, f64::min);
    minima.iter().filter(|m| m.value <= best * (1.0 + SAME)).count()
}

struct Seeker<'a> {
    problem: &'a Problem<'a>,
    starter: &'a Starter<'a>,
    bounds: Vec<(f64, f64)>,
    seed: u64,
}

impl Seeker<'_> {
    /// The local fit from start number `k`. Every start has chance of its own, so that the order in which they run does not matter.
    fn drawn(&self, k: usize) -> Minimum {
        let mut rng = Rng::new(self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(k as u64));
        self.from(&self.starter.draw(&mut rng, CANDIDATES).0)
    }

    /// The local least-squares fit from given parameters. The sum of norms is left to the polish: its own landscape has a corner at every point.
    fn from(&self, parameters: &[f64]) -> Minimum {
        let options = LocalOptions { iterations: 80, tolerance: 1e-12, longest_step: 1.5 };
        let start = self.problem.variables(parameters);
        if self.problem.data.objective != Objective::SumAbs {
            return minimise(self.problem, &start, &self.bounds, &options);
        }
        let data = crate::fit::circuit::data::Data { objective: Objective::Complex, ..self.problem.data.clone() };
        minimise(&Problem { data: &data, ..self.problem.clone() }, &start, &self.bounds, &options)
    }

    /// The distinct basins of a population, each at its bottom.
    fn evolution(&self) -> Vec<Minimum> {
        let dimensions = Ranges::dimensions(self.starter.circuit);
        let options = DeOptions {
            population: 8 * dimensions.min(16),
            generations: 25 * dimensions.min(16),
            strategy: Strategy::Rand1,
            crossover: 0.9,
            spread: 1e-5,
            seed: self.seed,
        };
        let population = differential_evolution(|unit| self.starter.at(unit).1, &vec![(0.0, 1.0); dimensions], &options);
        let best: Vec<_> = population.into_iter().take(4 * ROUND).collect();
        best.into_par_iter().map(|member| self.from(&self.starter.at(&member.x).0)).collect()
    }

    /// The deepest of the distinct optima, polished.
    fn finish(&self, mut minima: Vec<Minimum>) -> Option<Minimum> {
        minima.retain(|m| m.value.is_finite());
        minima.sort_by(|a, b| a.value.total_cmp(&b.value));
        minima.dedup_by(|b, a| b.value <= a.value * (1.0 + SAME));
        let least_squares = self.problem.data.objective != Objective::SumAbs;
        minima.truncate(if least_squares { 3 } else { FINALISTS });
        let polished: Vec<Minimum> = minima.into_par_iter().map(|m| self.polish(m)).collect();
        polished.into_iter().min_by(|a, b| a.value.total_cmp(&b.value))
    }

    /// To the last digits, with the model's own curvature. The corner of the norm is sharpened step by step.
    fn polish(&self, minimum: Minimum) -> Minimum {
        let exact = Problem { exact: true, ..self.problem.clone() };
        let options = LocalOptions::default();
        if exact.data.objective != Objective::SumAbs {
            return if minimum.converged { minimum } else { minimise(&exact, &minimum.x, &self.bounds, &options) };
        }
        let mut polished = minimum;
        for corner in [1e-2, 1e-3, 1e-5, 1e-7, 1e-9] {
            let smooth = Problem { corner: corner * exact.data.scale, ..exact.clone() };
            polished = minimise(&smooth, &polished.x, &self.bounds, &options);
        }
        Minimum { value: exact.value(&polished.x), ..polished }
    }
}
