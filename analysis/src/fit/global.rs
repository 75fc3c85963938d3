//! Differential evolution (Storn and Price, 1997) in a box: needs only values, deterministic from its seed. It finds basins; the polish to the
//! last digits is [`super::local`]'s.

use super::rng::Rng;

/// Which member of the population a mutant grows from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Strategy {
    /// rand/1/bin: explores.
    Rand1,
    /// best/1/bin: the thesis' choice (scipy's default); quick, and prone to the first basin it sees.
    Best1,
}

/// How long and how widely to search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeOptions {
    /// Number of members, at least 5 are used.
    pub population: usize,
    /// Most generations.
    pub generations: usize,
    /// Mutation strategy.
    pub strategy: Strategy,
    /// Probability that a coordinate comes from the mutant, 0…1.
    pub crossover: f64,
    /// Ends when (worst − best) falls below this fraction of |best|.
    pub spread: f64,
    /// Seed of all chance.
    pub seed: u64,
}

/// One member of a population.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// Coordinates inside the box.
    pub x: Vec<f64>,
    /// Value there.
    pub value: f64,
}

/// Minimises `f` over the box `bounds` (lower, upper); the last population, best first. A value that is not a number counts as infinite.
pub fn differential_evolution(mut f: impl FnMut(&[f64]) -> f64, bounds: &[(f64, f64)], options: &DeOptions) -> Vec<Member> {
    let mut breeder = Breeder { bounds, options, rng: Rng::new(options.seed) };
    let mut value = |x: &[f64]| Some(f(x)).filter(|v| !v.is_nan()).unwrap_or(f64::INFINITY);
    let mut population = breeder.stratified(options.population.max(5));
    for member in &mut population {
        member.value = value(&member.x);
    }
    let mut trial = vec![0.0; bounds.len()];
    for _ in 0..options.generations {
        for i in 0..population.len() {
            breeder.mutate(&population, i, &mut trial);
            let v = value(&trial);
            if v <= population[i].value {
                population[i].value = v;
                population[i].x.copy_from_slice(&trial);
            }
        }
        let extremes = |(lo, hi): (f64, f64), m: &Member| (lo.min(m.value), hi.max(m.value));
        let (best, worst) = population.iter().fold((f64::INFINITY, f64::NEG_INFINITY), extremes);
        if worst - best <= options.spread * best.abs() {
            break;
        }
    }
    population.sort_by(|a, b| a.value.total_cmp(&b.value));
    population
}

/// Makes members: the box, the rates and the chance.
struct Breeder<'a> {
    bounds: &'a [(f64, f64)],
    options: &'a DeOptions,
    rng: Rng,
}

impl Breeder<'_> {
    /// A Latin hypercube: every coordinate's range is covered evenly, whatever the seed.
    fn stratified(&mut self, size: usize) -> Vec<Member> {
        let mut population = vec![Member { x: vec![0.0; self.bounds.len()], value: f64::INFINITY }; size];
        let mut strata: Vec<usize> = (0..size).collect();
        for (d, &(lo, hi)) in self.bounds.iter().enumerate() {
            for i in (1..size).rev() {
                strata.swap(i, self.rng.below(i + 1));
            }
            for (member, stratum) in population.iter_mut().zip(&strata) {
                member.x[d] = lo + (hi - lo) * (*stratum as f64 + self.rng.uniform()) / size as f64;
            }
        }
        population
    }

    /// Writes the mutant of member `i`, crossed with it, to `trial`.
    fn mutate(&mut self, population: &[Member], i: usize, trial: &mut [f64]) {
        let n = population.len();
        let base = match self.options.strategy {
            Strategy::Rand1 => self.other_than(&[i], n),
            Strategy::Best1 => best_of(population),
        };
        let b = self.other_than(&[i, base], n);
        let c = self.other_than(&[i, base, b], n);
        // A factor drawn anew for each mutant (dither) keeps small populations from stalling.
        let factor = 0.5 + 0.5 * self.rng.uniform();
        let forced = self.rng.below(self.bounds.len());
        for (d, &(lo, hi)) in self.bounds.iter().enumerate() {
            let parent = population[i].x[d];
            if d != forced && self.rng.uniform() >= self.options.crossover {
                trial[d] = parent;
                continue;
            }
            let mutant = population[base].x[d] + factor * (population[b].x[d] - population[c].x[d]);
            trial[d] = if mutant < lo {
                lo + self.rng.uniform() * (parent - lo)
            } else if mutant > hi {
                hi - self.rng.uniform() * (hi - parent)
            } else {
                mutant
            };
        }
    }

    fn other_than(&mut self, taken: &[usize], n: usize) -> usize {
        loop {
            let candidate = self.rng.below(n);
            if !taken.contains(&candidate) {
                return candidate;
            }
        }
    }
}

fn best_of(population: &[Member]) -> usize {
    population.iter().enumerate().min_by(|a, b| a.1.value.total_cmp(&b.1.value)).map_or(0, |(i, _)| i)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(strategy: Strategy) -> DeOptions {
        DeOptions { population: 40, generations: 400, strategy, crossover: 0.9, spread: 1e-12, seed: 3 }
    }

    fn rosenbrock(x: &[f64]) -> f64 {
        (1.0 - x[0]).powi(2) + 100.0 * (x[1] - x[0] * x[0]).powi(2)
    }

    #[test]
    fn finds_the_bottom_of_a_curved_valley() {
        for strategy in [Strategy::Rand1, Strategy::Best1] {
            let best = &differential_evolution(rosenbrock, &[(-2.0, 2.0), (-1.0, 3.0)], &options(strategy))[0];
            assert!((best.x[0] - 1.0).abs() < 1e-4 && (best.x[1] - 1.0).abs() < 1e-4, "{strategy:?}: {best:?}");
        }
    }

    #[test]
    fn finds_the_deep_one_of_many_pits() {
        let rastrigin = |x: &[f64]| x.iter().map(|x| x * x + 10.0 * (1.0 - (std::f64::consts::TAU * x).cos())).sum::<f64>();
        let best = &differential_evolution(rastrigin, &[(-5.0, 4.0); 3], &options(Strategy::Rand1))[0];
        assert!(best.value < 1e-6, "{best:?}");
    }

    #[test]
    fn same_seed_same_population_and_never_outside() {
        let bounds = [(0.5, 2.0), (-1.0, 0.25)];
        let inside = |x: &[f64]| {
            assert!(x.iter().zip(&bounds).all(|(x, (lo, hi))| (lo..=hi).contains(&x)), "{x:?}");
            rosenbrock(x)
        };
        let first = differential_evolution(inside, &bounds, &options(Strategy::Best1));
        assert_eq!(first, differential_evolution(inside, &bounds, &options(Strategy::Best1)));
        assert_ne!(first, differential_evolution(inside, &bounds, &DeOptions { seed: 4, ..options(Strategy::Best1) }));
    }

    #[test]
    fn a_hole_in_the_function_is_avoided() {
        let f = |x: &[f64]| if x[0] < 0.0 { f64::NAN } else { x[0] };
        let best = &differential_evolution(f, &[(-1.0, 1.0)], &options(Strategy::Rand1))[0];
        assert!(best.value.is_finite() && best.value < 1e-3, "{best:?}");
    }
}
