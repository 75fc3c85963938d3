//! Differential evolution (Storn and Price, 1997) in a box, a whole generation at a time. It needs
//! only values and is deterministic from its seed. It finds basins; [`super::local`] polishes them
//! to full precision.
//!
//! All trials of a generation are made from the one before, so that they can be valued together, as
//! columns that vector instructions like.

use crate::Rng;

/// Member of the population that a mutant grows from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Strategy {
    /// rand/1/bin: explores.
    Rand1,
    /// best/1/bin: the thesis' choice (scipy's default); quick, and prone to the first basin it
    /// sees.
    Best1,
}

/// Length and width of the search.
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
    /// The function does not change when coordinates are exchanged: members are stored with rising
    /// coordinates, otherwise differences between members would be differences between orderings.
    /// All coordinates must have the same bounds.
    pub interchangeable: bool,
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

/// The coordinates of all members, coordinate by coordinate.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    members: usize,
    data: Vec<f64>,
}

impl Columns {
    /// Members at the origin.
    pub fn new(coordinates: usize, members: usize) -> Self {
        Self {
            members,
            data: vec![0.0; coordinates * members],
        }
    }

    /// Returns the number of members.
    pub fn members(&self) -> usize {
        self.members
    }

    /// Coordinate `d` of all members.
    pub fn coordinate(&self, d: usize) -> &[f64] {
        &self.data[d * self.members..(d + 1) * self.members]
    }

    fn at(&self, d: usize, member: usize) -> f64 {
        self.data[d * self.members + member]
    }

    /// Sets the coordinates of a member.
    pub fn write(&mut self, member: usize, x: &[f64]) {
        for (d, x) in x.iter().enumerate() {
            self.data[d * self.members + member] = *x;
        }
    }

    /// Coordinates of one member.
    pub fn member(&self, member: usize) -> Vec<f64> {
        (0..self.data.len() / self.members)
            .map(|d| self.at(d, member))
            .collect()
    }
}

/// Result of a search.
#[derive(Debug, Clone, PartialEq)]
pub struct Evolution {
    /// The first population, spread evenly over the box, best first: shows possible further basins.
    pub first: Vec<Member>,
    /// The last population, best first.
    pub last: Vec<Member>,
    /// Generations bred.
    pub generations: usize,
}

/// Minimises a function over the box `bounds` (lower, upper). `f` writes the value of every member;
/// NaN counts as infinite.
pub fn differential_evolution(
    mut f: impl FnMut(&Columns, &mut [f64]),
    bounds: &[(f64, f64)],
    options: &DeOptions,
) -> Evolution {
    let n = options.population.max(5);
    let mut breeder = Breeder {
        bounds,
        options,
        rng: Rng::new(options.seed),
    };
    let mut value = |x: &Columns, values: &mut [f64]| {
        f(x, values);
        values
            .iter_mut()
            .filter(|v| v.is_nan())
            .for_each(|v| *v = f64::INFINITY);
    };
    let mut population = breeder.stratified(n);
    let mut values = vec![f64::INFINITY; n];
    value(&population, &mut values);
    let first = members(&population, &values);
    let mut trials = population.clone();
    let mut met = values.clone();
    let mut generations = 0;
    while generations < options.generations && !settled(&values, options.spread) {
        breeder.breed(&population, &values, &mut trials);
        value(&trials, &mut met);
        for i in (0..n).filter(|i| met[*i] <= values[*i]).collect::<Vec<_>>() {
            values[i] = met[i];
            population.write(i, &trials.member(i));
        }
        generations += 1;
    }
    Evolution {
        first,
        last: members(&population, &values),
        generations,
    }
}

fn settled(values: &[f64], spread: f64) -> bool {
    let extremes = |(lo, hi): (f64, f64), v: &f64| (lo.min(*v), hi.max(*v));
    let (best, worst) = values
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), extremes);
    worst - best <= spread * best.abs()
}

fn members(population: &Columns, values: &[f64]) -> Vec<Member> {
    let mut all: Vec<Member> = values
        .iter()
        .enumerate()
        .map(|(i, v)| Member {
            x: population.member(i),
            value: *v,
        })
        .collect();
    all.sort_by(|a, b| a.value.total_cmp(&b.value));
    all
}

/// Makes members: the box, the rates and the chance.
struct Breeder<'a> {
    bounds: &'a [(f64, f64)],
    options: &'a DeOptions,
    rng: Rng,
}

impl Breeder<'_> {
    /// Returns a Latin hypercube: every coordinate's range is covered evenly, whatever the seed.
    fn stratified(&mut self, size: usize) -> Columns {
        let mut population = Columns::new(self.bounds.len(), size);
        let mut strata: Vec<usize> = (0..size).collect();
        for (d, &(lo, hi)) in self.bounds.iter().enumerate() {
            for i in (1..size).rev() {
                strata.swap(i, self.rng.below(i + 1));
            }
            for (member, stratum) in strata.iter().enumerate() {
                population.data[d * size + member] =
                    lo + (hi - lo) * (*stratum as f64 + self.rng.uniform()) / size as f64;
            }
        }
        if self.options.interchangeable {
            for i in 0..size {
                let mut x = population.member(i);
                x.sort_by(f64::total_cmp);
                population.write(i, &x);
            }
        }
        population
    }

    fn breed(&mut self, population: &Columns, values: &[f64], trials: &mut Columns) {
        let best = values
            .iter()
            .enumerate()
            .min_by(|a, b| a.1.total_cmp(b.1))
            .map_or(0, |(i, _)| i);
        let mut trial = vec![0.0; self.bounds.len()];
        for i in 0..values.len() {
            self.mutate(population, i, best, &mut trial);
            if self.options.interchangeable {
                trial.sort_by(f64::total_cmp);
            }
            trials.write(i, &trial);
        }
    }

    /// Writes the mutant of member `i`, crossed with it, to `trial`.
    fn mutate(&mut self, population: &Columns, i: usize, best: usize, trial: &mut [f64]) {
        let n = population.members();
        let base = match self.options.strategy {
            Strategy::Rand1 => self.other_than(&[i], n),
            Strategy::Best1 => best,
        };
        let b = self.other_than(&[i, base], n);
        let c = self.other_than(&[i, base, b], n);
        // A factor drawn anew for each mutant (dither) keeps small populations from stalling.
        let factor = 0.5 + 0.5 * self.rng.uniform();
        let forced = self.rng.below(self.bounds.len());
        for (d, &(lo, hi)) in self.bounds.iter().enumerate() {
            let parent = population.at(d, i);
            if d != forced && self.rng.uniform() >= self.options.crossover {
                trial[d] = parent;
                continue;
            }
            let mutant =
                population.at(d, base) + factor * (population.at(d, b) - population.at(d, c));
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

#[cfg(test)]
mod tests {
    use super::*;

    fn options(strategy: Strategy) -> DeOptions {
        DeOptions {
            population: 40,
            generations: 400,
            strategy,
            crossover: 0.9,
            spread: 1e-12,
            interchangeable: false,
            seed: 3,
        }
    }

    /// One member after the other.
    fn each(f: impl Fn(&[f64]) -> f64) -> impl Fn(&Columns, &mut [f64]) {
        move |x, values| (0..x.members()).for_each(|i| values[i] = f(&x.member(i)))
    }

    fn rosenbrock(x: &[f64]) -> f64 {
        (1.0 - x[0]).powi(2) + 100.0 * (x[1] - x[0] * x[0]).powi(2)
    }

    #[test]
    fn finds_the_bottom_of_a_curved_valley() {
        for strategy in [Strategy::Rand1, Strategy::Best1] {
            let best = &differential_evolution(
                each(rosenbrock),
                &[(-2.0, 2.0), (-1.0, 3.0)],
                &options(strategy),
            )
            .last[0];
            assert!(
                (best.x[0] - 1.0).abs() < 1e-4 && (best.x[1] - 1.0).abs() < 1e-4,
                "{strategy:?}: {best:?}"
            );
        }
    }

    #[test]
    fn finds_the_deep_one_of_many_pits() {
        let rastrigin = |x: &[f64]| {
            x.iter()
                .map(|x| x * x + 10.0 * (1.0 - (std::f64::consts::TAU * x).cos()))
                .sum::<f64>()
        };
        for interchangeable in [false, true] {
            let options = DeOptions {
                interchangeable,
                ..options(Strategy::Rand1)
            };
            let found = differential_evolution(each(rastrigin), &[(-5.0, 4.0); 3], &options);
            assert!(found.last[0].value < 1e-6, "{:?}", found.last[0]);
            let ordered = |m: &Member| m.x.is_sorted();
            assert_eq!(
                found.first.iter().all(ordered) && found.last.iter().all(ordered),
                interchangeable
            );
        }
    }

    #[test]
    fn same_seed_same_population_and_never_outside() {
        let bounds = [(0.5, 2.0), (-1.0, 0.25)];
        let inside = |x: &[f64]| {
            assert!(
                x.iter()
                    .zip(&bounds)
                    .all(|(x, (lo, hi))| (lo..=hi).contains(&x)),
                "{x:?}"
            );
            rosenbrock(x)
        };
        let first = differential_evolution(each(inside), &bounds, &options(Strategy::Best1));
        assert_eq!(
            first,
            differential_evolution(each(inside), &bounds, &options(Strategy::Best1))
        );
        assert_ne!(
            first,
            differential_evolution(
                each(inside),
                &bounds,
                &DeOptions {
                    seed: 4,
                    ..options(Strategy::Best1)
                }
            )
        );
        // Every tenth of each range holds a tenth of the first population.
        for (d, (lo, hi)) in bounds.iter().enumerate() {
            for tenth in 0..10 {
                let inside = |m: &&Member| (((m.x[d] - lo) / (hi - lo) * 10.0) as i32) == tenth;
                assert_eq!(
                    first.first.iter().filter(inside).count(),
                    4,
                    "coordinate {d}, tenth {tenth}"
                );
            }
        }
    }

    #[test]
    fn a_hole_in_the_function_is_avoided() {
        let f = |x: &[f64]| if x[0] < 0.0 { f64::NAN } else { x[0] };
        let best =
            &differential_evolution(each(f), &[(-1.0, 1.0)], &options(Strategy::Rand1)).last[0];
        assert!(best.value.is_finite() && best.value < 1e-3, "{best:?}");
    }
}
