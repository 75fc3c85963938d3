//! Searches the optimum and the basins beside it: differential evolution over the time constants,
//! then descents from its result and from other basins of its first population. One minimum is kept
//! of each basin.

use super::batch::Batch;
use super::options::{Bounds, FitOptions, Objective};
use super::problem::{Problem, impedance};
use super::projection::Projection;
use analysis_numeric::{
    DeOptions, Evolution, LocalOptions, Member, Minimum, Rng, Smooth, Strategy,
    differential_evolution, minimise,
};
use std::f64::consts::TAU;

/// Corners of the smoothed norm, in typical impedances, from the first descent to full precision.
const CORNERS: [f64; 4] = [1e-3, 1e-5, 1e-7, 1e-9];

/// Curves closer than this everywhere, in typical impedances, count as one.
const SAME_CURVE: f64 = 1e-5;

/// A basin's bottom and how many descents ended there.
#[derive(Debug, Clone)]
pub(super) struct Basin {
    pub(super) minimum: Minimum,
    pub(super) descents: usize,
}

/// All basins met, deepest first, and the number of descents made. There is always at least one
/// basin.
#[derive(Debug, Clone)]
pub(super) struct Basins {
    pub(super) deepest: Basin,
    pub(super) others: Vec<Basin>,
    pub(super) descents: usize,
}

/// Bounds of the logarithmic parameters.
pub(super) fn log_bounds(options: &FitOptions) -> Vec<(f64, f64)> {
    let ln = |(lo, hi): (f64, f64)| (lo.ln(), hi.ln());
    let (r, c) = (ln(options.bounds.r_ohm), ln(options.bounds.c_f));
    std::iter::once(r)
        .chain((0..options.rc).flat_map(|_| [r, c]))
        .collect()
}

/// Searches; `starts` more descents begin at random time constants.
///
/// `coarse` is the same problem without common errors, over which basins are looked for; the
/// descents are made over `problem` itself.
pub(super) fn search(
    problem: &Problem,
    coarse: &Problem,
    options: &FitOptions,
    starts: usize,
) -> Basins {
    let bounds = log_bounds(options);
    let mut projection = Projection::new(coarse, &options.bounds);
    let begun = starting_points(coarse, options, starts);
    let descents = begun.len();
    let mut rough: Vec<Basin> = Vec::new();
    for log_tau in begun {
        let minimum = first_descent(problem, &projection.parameters(&log_tau), &bounds);
        collect(
            problem,
            &mut rough,
            Basin {
                minimum,
                descents: 1,
            },
            same_curve,
        );
    }
    let mut basins: Vec<Basin> = Vec::new();
    for Basin { minimum, descents } in rough {
        let minimum = to_the_bottom(problem, minimum, &bounds);
        collect(
            problem,
            &mut basins,
            Basin { minimum, descents },
            same_minimum,
        );
    }
    basins.sort_by(|a, b| a.minimum.value.total_cmp(&b.minimum.value));
    let mut basins = basins.into_iter();
    let only = || Basin {
        minimum: polish(
            problem,
            &Projection::new(coarse, &options.bounds).parameters(&[]),
            &bounds,
        ),
        descents: 1,
    };
    let deepest = basins.next().unwrap_or_else(only);
    Basins {
        deepest,
        others: basins.collect(),
        descents: descents.max(1),
    }
}

/// Adds a basin, or counts it with the one it is; the deeper of the two stays.
fn collect(
    problem: &Problem,
    basins: &mut Vec<Basin>,
    new: Basin,
    same: impl Fn(&Problem, &Minimum, &Minimum) -> bool,
) {
    match basins
        .iter_mut()
        .find(|b| same(problem, &b.minimum, &new.minimum))
    {
        Some(known) => {
            known.descents += new.descents;
            if new.minimum.value < known.minimum.value {
                known.minimum = new.minimum;
            }
        }
        None => basins.push(new),
    }
}

/// Sets of time constants (logarithms, s, rising) worth a descent, best first.
fn starting_points(problem: &Problem, options: &FitOptions, starts: usize) -> Vec<Vec<f64>> {
    if options.rc == 0 {
        return vec![Vec::new()];
    }
    let range = log_tau_range(problem, &options.bounds);
    let search = DeOptions {
        population: 8 + 8 * options.rc,
        generations: 20 + 20 * options.rc,
        strategy: Strategy::Rand1,
        crossover: 0.9,
        spread: 1e-5,
        interchangeable: true,
        seed: options.seed,
    };
    let mut batch = Batch::new(problem, &options.bounds, options.rc);
    let evolution = differential_evolution(
        |x, values| batch.values(x, values),
        &vec![range; options.rc],
        &search,
    );
    let mut points = survivors(&evolution);
    points.extend(other_valleys(&evolution, range.1 - range.0));
    let mut rng = Rng::new(options.seed ^ 0x5EED_0F57_A275);
    for _ in 0..starts {
        let mut x: Vec<f64> = (0..options.rc)
            .map(|_| range.0 + (range.1 - range.0) * rng.uniform())
            .collect();
        x.sort_by(f64::total_cmp);
        points.push(x);
    }
    points
}

/// The last population, one member of each crowd.
fn survivors(evolution: &Evolution) -> Vec<Vec<f64>> {
    const MOST: usize = 16;
    let mut found: Vec<Vec<f64>> = Vec::new();
    for Member { x, .. } in &evolution.last {
        if found.len() < MOST && !found.iter().any(|f| distance(f, x) < 0.3) {
            found.push(x.clone());
        }
    }
    found
}

/// Members of the first population without a better one near by: each may lie in a valley of its
/// own (single linkage, Rinnooy Kan and Timmer, 1987). The evolution forgets these; a user should
/// know of them. `width` is that of the range of ln τ.
fn other_valleys(evolution: &Evolution, width: f64) -> Vec<Vec<f64>> {
    const MOST: usize = 6;
    let rc = evolution.first.first().map_or(1, |m| m.x.len());
    // Typical distance of neighbours: the ordered members fill a rc!-th of the box.
    let orders: f64 = (1..=rc).map(|k| k as f64).product();
    let near = 1.5 * width / (orders * evolution.first.len() as f64).powf(1.0 / rc as f64);
    let lonely = |i: &usize| {
        evolution.first[..*i]
            .iter()
            .all(|better| distance(&better.x, &evolution.first[*i].x) > near)
    };
    (0..evolution.first.len())
        .filter(lonely)
        .take(MOST)
        .map(|i| evolution.first[i].x.clone())
        .collect()
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter()
        .zip(b)
        .fold(0.0, |m, (a, b)| f64::max(m, (a - b).abs()))
}

/// Returns the range of time constants that the data can distinguish from zero and from infinity:
/// the band widened by two decades each way, within the bounds.
fn log_tau_range(problem: &Problem, bounds: &Bounds) -> (f64, f64) {
    let allowed = (
        (bounds.r_ohm.0 * bounds.c_f.0).ln(),
        (bounds.r_ohm.1 * bounds.c_f.1).ln(),
    );
    let (Some(slowest), Some(fastest)) = (problem.groups.first(), problem.groups.last()) else {
        return allowed;
    };
    let lo = (0.01 / (TAU * fastest.freq_hz)).ln().max(allowed.0);
    let hi = (100.0 / (TAU * slowest.freq_hz)).ln().min(allowed.1);
    if lo < hi { (lo, hi) } else { allowed }
}

/// Polish: descends from `start` to the bottom of its basin, to full precision.
pub(super) fn polish(problem: &Problem, start: &[f64], bounds: &[(f64, f64)]) -> Minimum {
    to_the_bottom(problem, first_descent(problem, start, bounds), bounds)
}

fn first_descent(problem: &Problem, start: &[f64], bounds: &[(f64, f64)]) -> Minimum {
    let options = LocalOptions::default();
    match problem.kind {
        Objective::SumAbs => minimise(
            &problem.smoothed(CORNERS[0] * problem.scale_ohm),
            start,
            bounds,
            &options,
        ),
        Objective::Complex | Objective::Modulus => minimise(problem, start, bounds, &options),
    }
}

/// The corner of the norm is sharpened step by step: a sum of norms alone would stall at points it
/// meets exactly.
fn to_the_bottom(problem: &Problem, mut minimum: Minimum, bounds: &[(f64, f64)]) -> Minimum {
    if problem.kind != Objective::SumAbs {
        return minimum;
    }
    for corner in &CORNERS[1..] {
        minimum = minimise(
            &problem.smoothed(corner * problem.scale_ohm),
            &minimum.x,
            bounds,
            &LocalOptions::default(),
        );
    }
    minimum.value = problem.value(&minimum.x);
    minimum
}

/// The problem at the sharpest corner that is still differentiable.
pub(super) fn sharp(problem: &Problem) -> Problem {
    problem.smoothed(CORNERS[CORNERS.len() - 1] * problem.scale_ohm)
}

/// The curves through the measured frequencies agree.
fn same_curve(problem: &Problem, a: &Minimum, b: &Minimum) -> bool {
    curves_within(problem, a, b, SAME_CURVE)
}

/// Returns whether two minima are the same: equal values, and curves that agree or differ only
/// where the objective is flat.
pub(super) fn same_minimum(problem: &Problem, a: &Minimum, b: &Minimum) -> bool {
    let equal = (a.value - b.value).abs() <= 1e-8 * a.value.abs().max(b.value.abs());
    curves_within(problem, a, b, if equal { 1e-3 } else { SAME_CURVE })
}

fn curves_within(problem: &Problem, a: &Minimum, b: &Minimum, tolerance: f64) -> bool {
    problem.groups.iter().all(|g| {
        (impedance(&a.x, g.freq_hz) - impedance(&b.x, g.freq_hz)).norm()
            < tolerance * problem.scale_ohm
    })
}
