//! The global optimum of a circuit's fit: local fits from many starts, or differential evolution,
//! then a polish to full precision.

use super::options::{CircuitOptions, Search, Weight};
use super::problem::{Problem, is_log};
use super::starts::{Ranges, Starter};
use crate::fit::options::Objective;
use analysis_numeric::{
    Columns, DeOptions, LocalOptions, Minimum, Rng, Smooth, Strategy, differential_evolution,
    minimise,
};
use rayon::prelude::*;

/// Default number of starts.
const STARTS: usize = 64;
/// Starts of one round; after each the search may end.
const ROUND: usize = 8;
/// Number of random candidates for each start; the best one is used.
const CANDIDATES: usize = 12;
/// Number of starts at the same optimum that ends the search, after at least `STARTS_PER_PARAMETER`
/// starts per free parameter: the widest basin need not be the deepest.
const AGREEING: usize = 3;
const STARTS_PER_PARAMETER: usize = 3;
/// Below this reduced χ² an optimum explains the data to their stated noise, and a deeper one is
/// not expected.
const EXPLAINED: f64 = 1.3;
/// Rounds of starts around the best optimum, while they find better ones: a diffusion's τ has many
/// optima side by side.
const HOPS: usize = 6;
/// Distance of these starts from the best optimum, in logarithms (a tenth of it for exponents), one
/// standard deviation.
const HOP: f64 = 1.0;
/// Populations of a differential evolution.
const ISLANDS: usize = 4;
/// Values that differ by less than this fraction are the same optimum.
const SAME: f64 = 1e-6;
/// Distinct optima that are polished.
const FINALISTS: usize = 10;

/// The best optimum and how it was found.
pub(super) struct BestOptimum {
    pub(super) minimum: Minimum,
    /// Starts tried.
    pub(super) starts: usize,
    /// Number of starts that ended at this optimum.
    pub(super) agreeing: usize,
}

/// Searches the global optimum; `None` if no start gives a finite value.
pub(super) fn search(
    problem: &Problem,
    starter: &Starter,
    options: &CircuitOptions,
) -> Option<BestOptimum> {
    let bounds: Vec<(f64, f64)> = problem.free.iter().map(|i| starter.bounds[*i]).collect();
    let lower = problem.variables(&spread(problem, &bounds, |b| b.0));
    let upper = problem.variables(&spread(problem, &bounds, |b| b.1));
    let bounds: Vec<(f64, f64)> = lower.into_iter().zip(upper).collect();
    let seeker = Seeker {
        problem,
        starter,
        bounds,
        seed: options.seed,
    };
    let guessed = !options.guess.is_empty()
        && problem
            .free
            .iter()
            .all(|i| options.guess.iter().any(|(g, _)| g == i));
    let mut minima = Vec::new();
    if guessed {
        minima.push(seeker.from(&starter.at(&[]).0));
    }
    match options.search {
        Search::Evolution => {
            minima.extend(seeker.evolution());
            minima = seeker.hops(minima, 1);
        }
        Search::Starts => {
            let most = options.starts.unwrap_or(if guessed { 0 } else { STARTS });
            minima = seeker.starts(minima, most);
            minima = seeker.hops(minima, most);
        }
    }
    let (starts, agreeing) = (minima.len(), agreeing(&minima));
    seeker.finish(minima).map(|minimum| BestOptimum {
        minimum,
        starts,
        agreeing,
    })
}

/// All parameters with the bounds of the free ones in their places.
fn spread(problem: &Problem, bounds: &[(f64, f64)], side: impl Fn(&(f64, f64)) -> f64) -> Vec<f64> {
    let mut p = problem.base.clone();
    for (i, b) in problem.free.iter().zip(bounds) {
        p[*i] = side(b);
    }
    p
}

/// True when the weights are a measured covariance and the best optimum leaves no more than that.
fn explained(problem: &Problem, minima: &[Minimum]) -> bool {
    let freedom = problem.data.numbers().saturating_sub(problem.free.len()) as f64;
    let least_squares =
        problem.data.kind != Objective::SumAbs && problem.data.weight == Weight::Covariance;
    least_squares && minima.iter().any(|m| m.value < EXPLAINED * freedom)
}

fn agreeing(minima: &[Minimum]) -> usize {
    let best = minima.iter().map(|m| m.value).fold(f64::INFINITY, f64::min);
    minima
        .iter()
        .filter(|m| m.value <= best * (1.0 + SAME))
        .count()
}

struct Seeker<'a> {
    problem: &'a Problem<'a>,
    starter: &'a Starter<'a>,
    bounds: Vec<(f64, f64)>,
    seed: u64,
}

impl Seeker<'_> {
    /// The local fit from start number `k`.
    fn drawn(&self, k: usize) -> Minimum {
        self.from(&self.starter.draw(&mut self.chance(k), CANDIDATES).0)
    }

    fn from(&self, parameters: &[f64]) -> Minimum {
        self.descend(&self.problem.variables(parameters))
    }

    /// The local least-squares fit. The sum of norms is left to the polish: its own landscape has a
    /// corner at every point.
    fn descend(&self, start: &[f64]) -> Minimum {
        let options = LocalOptions {
            iterations: 80,
            tolerance: 1e-12,
            longest_step: 1.5,
        };
        if self.problem.data.kind != Objective::SumAbs {
            return minimise(self.problem, start, &self.bounds, &options);
        }
        let mut data = self.problem.data.clone();
        data.pooled.kind = Objective::Complex;
        minimise(
            &Problem {
                data: &data,
                ..self.problem.clone()
            },
            start,
            &self.bounds,
            &options,
        )
    }

    /// Adds local fits from drawn starts until several agree on the best.
    fn starts(&self, mut minima: Vec<Minimum>, most: usize) -> Vec<Minimum> {
        let fewest = STARTS_PER_PARAMETER * self.problem.free.len();
        let mut done = 0;
        while done < most
            && (agreeing(&minima) < AGREEING
                || (done < fewest && !explained(self.problem, &minima)))
        {
            let count = ROUND.min(most - done);
            let round: Vec<Minimum> = (done..done + count)
                .into_par_iter()
                .map(|k| self.drawn(k))
                .collect();
            minima.extend(round);
            done += count;
        }
        minima
    }

    /// Adds local fits from around the best optimum while these find better ones.
    fn hops(&self, mut minima: Vec<Minimum>, most: usize) -> Vec<Minimum> {
        for hop in 0..if most > 0 { HOPS } else { 0 } {
            let Some(best) = minima
                .iter()
                .min_by(|a, b| a.value.total_cmp(&b.value))
                .cloned()
            else {
                break;
            };
            if explained(self.problem, &minima) || !best.value.is_finite() {
                break;
            }
            let round: Vec<Minimum> = (0..ROUND)
                .into_par_iter()
                .map(|k| self.around(&best.x, most + hop * ROUND + k))
                .collect();
            let better = round.iter().any(|m| m.value < best.value * (1.0 - SAME));
            minima.extend(round);
            if !better {
                break;
            }
        }
        minima
    }

    /// The local fit from a place near x.
    fn around(&self, x: &[f64], k: usize) -> Minimum {
        let mut rng = self.chance(k);
        // Near ones and far ones.
        let far = 0.5 * HOP * (1 + k % 4) as f64;
        let step = |i: &usize| {
            if is_log(self.problem.circuit, *i) {
                far
            } else {
                0.1 * far
            }
        };
        let moved: Vec<f64> = x
            .iter()
            .zip(&self.problem.free)
            .map(|(x, i)| x + step(i) * rng.normal())
            .collect();
        self.descend(&moved)
    }

    /// Returns the random numbers of a start. Each start has its own, so that the order in which
    /// they run does not matter.
    fn chance(&self, k: usize) -> Rng {
        Rng::new(
            self.seed
                .wrapping_mul(0x9E37_79B9_7F4A_7C15)
                .wrapping_add(k as u64),
        )
    }

    /// Returns the optima below the best members of several independent populations: a single
    /// population often settles on a wide basin.
    fn evolution(&self) -> Vec<Minimum> {
        let dimensions = Ranges::dimensions(self.starter.circuit);
        let options = |island: usize| DeOptions {
            population: 8 * dimensions.min(16),
            generations: 25 * dimensions.min(16),
            strategy: Strategy::Rand1,
            crossover: 0.9,
            spread: 1e-5,
            interchangeable: false,
            seed: self.chance(island).next_u64(),
        };
        let bounds = vec![(0.0, 1.0); dimensions];
        let value = |units: &Columns, values: &mut [f64]| {
            for (member, value) in values.iter_mut().enumerate() {
                *value = self.starter.at(&units.member(member)).1;
            }
        };
        let island = |k| differential_evolution(value, &bounds, &options(k));
        let best = |k| {
            island(k)
                .last
                .into_iter()
                .take(ROUND)
                .map(|member| self.from(&self.starter.at(&member.x).0))
                .collect::<Vec<_>>()
        };
        (0..ISLANDS).into_par_iter().flat_map_iter(best).collect()
    }

    /// The deepest of the distinct optima, polished.
    fn finish(&self, mut minima: Vec<Minimum>) -> Option<Minimum> {
        minima.retain(|m| m.value.is_finite());
        minima.sort_by(|a, b| a.value.total_cmp(&b.value));
        minima.dedup_by(|b, a| b.value <= a.value * (1.0 + SAME));
        let least_squares = self.problem.data.kind != Objective::SumAbs;
        minima.truncate(if least_squares { 3 } else { FINALISTS });
        let polished: Vec<Minimum> = minima.into_par_iter().map(|m| self.polish(m)).collect();
        polished
            .into_iter()
            .min_by(|a, b| a.value.total_cmp(&b.value))
    }

    /// Polish to full precision, with the model's own curvature. The corner of the norm is
    /// sharpened step by step.
    fn polish(&self, minimum: Minimum) -> Minimum {
        let exact = Problem {
            exact: true,
            ..self.problem.clone()
        };
        let options = LocalOptions::default();
        if exact.data.kind != Objective::SumAbs {
            return if minimum.converged {
                minimum
            } else {
                minimise(&exact, &minimum.x, &self.bounds, &options)
            };
        }
        let mut polished = minimum;
        for corner in [1e-2, 1e-3, 1e-5, 1e-7, 1e-9] {
            let smooth = Problem {
                corner: corner * exact.data.scale,
                ..exact.clone()
            };
            polished = minimise(&smooth, &polished.x, &self.bounds, &options);
        }
        Minimum {
            value: exact.value(&polished.x),
            ..polished
        }
    }
}
