//! Activation energies and exchange current: the unknowns in which the voltage is not linear.

use super::design::Design;
use super::lag;
use super::options::MapFitError;
use super::solve::{Kinetics, START, Solved};
use super::train::Train;

/// Standard deviation of both about their prior, J/mol.
const ENERGY_SIGMA: f64 = 12e3;
/// Step of the search of an energy, J/mol; one move is at most twice as long.
const ENERGY_STEP: f64 = 5e3;
/// Rounds of the search over both energies.
const ENERGY_ROUNDS: usize = 2;
/// Exchange currents that are tried, as multiples of the capacity per hour.
const EXCHANGE_C_RATES: [f64; 5] = [0.25, 0.75, 2.0, 6.0, 18.0];
/// Ratio of two exchange currents that are tried, and of those beside the lowest.
const EXCHANGE_RATIO: f64 = 3.0;
const FINE_RATIO: f64 = 1.4;

/// A point of the search, with its cost and its solution.
#[derive(Clone)]
struct Found {
    kinetics: Kinetics,
    cost: f64,
    solved: Solved,
}

/// Finds the lag of the logs, the activation energies and, if the data show one, the exchange current.
pub(super) fn search(
    design: &Design,
    train: &mut Train,
) -> Result<(Kinetics, Solved), MapFitError> {
    let mut found = look(design, train, START)?;
    if let Some(lag_s) = lag::find(design, train, START, &found.solved)? {
        train.lag_s = lag_s;
        found = look(design, train, START)?;
    }
    for _ in 0..ENERGY_ROUNDS {
        found = improve_energies(design, train, found)?;
    }
    if let Some(bent) = find_exchange(design, train, &found)? {
        let bent = improve_energies(design, train, bent)?;
        // Both have had the same rounds.
        found = improve_energies(design, train, found)?;
        if train.shows_more(bent.cost, found.cost) {
            found = bent;
        }
    }
    Ok((found.kinetics, found.solved))
}

fn look(design: &Design, train: &Train, kinetics: Kinetics) -> Result<Found, MapFitError> {
    let solved = design.solve(train, kinetics)?;
    let prior = |energy: f64, expected: f64| ((energy - expected) / ENERGY_SIGMA).powi(2);
    let beside = prior(kinetics.series, START.series) + prior(kinetics.branches, START.branches);
    Ok(Found {
        kinetics,
        cost: solved.cost + beside,
        solved,
    })
}

/// Moves each energy to the lowest point of a parabola through the cost.
fn improve_energies(design: &Design, train: &Train, mut best: Found) -> Result<Found, MapFitError> {
    for of_series in [true, false] {
        let moved = |by: f64| {
            let mut kinetics = best.kinetics;
            let energy = if of_series {
                &mut kinetics.series
            } else {
                &mut kinetics.branches
            };
            *energy = (*energy + by).max(0.0);
            kinetics
        };
        let below = look(design, train, moved(-ENERGY_STEP))?.cost;
        let above = look(design, train, moved(ENERGY_STEP))?.cost;
        let share = lowest(below, best.cost, above).clamp(-2.0, 2.0);
        let tried = look(design, train, moved(share * ENERGY_STEP))?;
        if tried.cost < best.cost {
            best = tried;
        }
    }
    Ok(best)
}

/// Finds the exchange current with the lowest cost; `None` if no log has a current, because spectra at
/// rest do not show it.
fn find_exchange(
    design: &Design,
    train: &Train,
    without: &Found,
) -> Result<Option<Found>, MapFitError> {
    if train.logs.is_empty() || design.transfers() == 0 {
        return Ok(None);
    }
    let at = |exchange_a: f64| {
        let exchange_a = Some(exchange_a);
        look(
            design,
            train,
            Kinetics {
                exchange_a,
                ..without.kinetics
            },
        )
    };
    let rates_a = EXCHANGE_C_RATES.map(|c_rate| c_rate * train.ocv.capacity_ah);
    let tried = rates_a.map(at);
    let tried = tried.into_iter().collect::<Result<Vec<_>, _>>()?;
    let lowest_of = |a: &usize, b: &usize| tried[*a].cost.total_cmp(&tried[*b].cost);
    let Some(k) = (0..tried.len()).min_by(lowest_of) else {
        return Ok(None);
    };
    // The largest one bends nothing: the data show none.
    if k == tried.len() - 1 {
        return Ok(None);
    }
    let k = k.max(1);
    let share = lowest(tried[k - 1].cost, tried[k].cost, tried[k + 1].cost).clamp(-1.0, 1.0);
    // The rates are nearly equal steps of their logarithm.
    let coarse_a = rates_a[k] * EXCHANGE_RATIO.powf(share);
    let coarse = at(coarse_a)?;
    let near = |factor: f64| at(coarse_a * factor);
    let (below, above) = (near(1.0 / FINE_RATIO)?, near(FINE_RATIO)?);
    let share = lowest(below.cost, coarse.cost, above.cost).clamp(-2.0, 2.0);
    let fine = near(FINE_RATIO.powf(share))?;
    let all = tried.into_iter().chain([coarse, below, above, fine]);
    Ok(all.min_by(|a, b| a.cost.total_cmp(&b.cost)))
}

/// Returns the lowest point of the parabola through three equidistant costs, in steps from the middle.
fn lowest(below: f64, middle: f64, above: f64) -> f64 {
    let bend = below + above - 2.0 * middle;
    if bend > 0.0 {
        0.5 * (below - above) / bend
    } else {
        (below - above).signum()
    }
}
