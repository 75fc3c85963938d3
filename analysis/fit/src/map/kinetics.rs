//! Activation energies and the voltage of charge transfer: the unknowns in which the voltage is not linear.

use super::design::{Design, SLOWEST_TRANSFER_S};
use super::lag;
use super::options::MapFitError;
use super::solve::{Kinetics, START, Solved};
use super::train::Train;
use analysis_model::map::{CellMap, ChargeTransfer};
use std::{ops::RangeInclusive, sync::Arc};

/// Standard deviation of both energies about their prior, J/mol.
const ENERGY_SIGMA: f64 = 12e3;
/// Step of the search of an energy, J/mol; one move is at most twice as long.
const ENERGY_STEP: f64 = 5e3;
/// Rounds of the search over both energies.
const ENERGY_ROUNDS: usize = 2;
/// Expected voltage of charge transfer, V, and the standard deviation of its logarithm: 2·R·T/F, and more
/// in a porous electrode.
const VOLTAGE_V: f64 = 0.06;
const VOLTAGE_SIGMA: f64 = 0.3;
/// First factor between two voltages of the search, number of its rounds, each with half the logarithm,
/// and the range of the search, V.
const VOLTAGE_FACTOR: f64 = 2.0;
const VOLTAGE_ROUNDS: usize = 2;
const VOLTAGES_V: RangeInclusive<f64> = 0.01..=2.0;
/// Solutions until the exchange current belongs to the resistances, at most, and the relative change of the
/// cost at which it does.
const MOST_SOLUTIONS: usize = 4;
const SETTLED: f64 = 3e-3;
/// Exponent of the change of a resistance from one of these solutions to the next: the more a branch is
/// bent, the less of an error one solution removes, at a third of the resistance a third.
const AHEAD: f64 = 1.5;

/// A point of the search, with its cost and its solution.
#[derive(Clone)]
struct Found {
    kinetics: Kinetics,
    cost: f64,
    solved: Solved,
}

/// Finds the lag of the logs, the activation energies and, if the data show one, the voltage of charge
/// transfer.
pub(super) fn search(
    design: &Design,
    train: &mut Train,
) -> Result<(Kinetics, Solved), MapFitError> {
    let mut found = evaluate(design, train, START)?;
    if let Some(lag_s) = lag::find(design, train, &START, &found.solved)? {
        train.lag_s = lag_s;
        found = evaluate(design, train, START)?;
    }
    for _ in 0..ENERGY_ROUNDS {
        found = improve_energies(design, train, found)?;
    }
    // Spectra at rest do not show a fall under current.
    if !train.logs.is_empty() && design.transfers() > 0 {
        let bent = find_voltage(design, train, &found)?;
        let bent = improve_energies(design, train, bent)?;
        // Both have had the same rounds.
        found = improve_energies(design, train, found)?;
        if train.shows_more(bent.cost, found.cost) {
            found = bent;
        }
    }
    Ok((found.kinetics, found.solved))
}

fn evaluate(design: &Design, train: &Train, kinetics: Kinetics) -> Result<Found, MapFitError> {
    let solved = design.solve(train, &kinetics)?;
    let energy = |energy: f64, expected: f64| ((energy - expected) / ENERGY_SIGMA).powi(2);
    let law = kinetics.bent.as_ref().and_then(|map| map.charge_transfer);
    let voltage = law.map_or(0.0, |law| {
        ((law.voltage_v / VOLTAGE_V).ln() / VOLTAGE_SIGMA).powi(2)
    });
    let energies =
        energy(kinetics.series, START.series) + energy(kinetics.branches, START.branches);
    Ok(Found {
        kinetics,
        cost: solved.cost + energies + voltage,
        solved,
    })
}

/// Moves each energy to the lowest point of a parabola through the cost.
fn improve_energies(design: &Design, train: &Train, mut best: Found) -> Result<Found, MapFitError> {
    for of_series in [true, false] {
        let moved = |by: f64| {
            let mut kinetics = best.kinetics.clone();
            let energy = if of_series {
                &mut kinetics.series
            } else {
                &mut kinetics.branches
            };
            *energy = (*energy + by).max(0.0);
            kinetics
        };
        let below = evaluate(design, train, moved(-ENERGY_STEP))?.cost;
        let above = evaluate(design, train, moved(ENERGY_STEP))?.cost;
        let share = lowest(below, best.cost, above).clamp(-2.0, 2.0);
        let tried = evaluate(design, train, moved(share * ENERGY_STEP))?;
        if tried.cost < best.cost {
            best = tried;
        }
    }
    Ok(best)
}

/// Finds the voltage of charge transfer with the lowest cost: walks from the expected one while the cost
/// falls, then halves the step.
fn find_voltage(design: &Design, train: &Train, without: &Found) -> Result<Found, MapFitError> {
    let start = design.map(&without.kinetics, &without.solved);
    let from = |found: &Found, voltage_v: f64| {
        let map = design.map(&found.kinetics, &found.solved);
        settle(design, train, &found.kinetics, map, voltage_v)
    };
    let mut best_v = VOLTAGE_V;
    let mut best = settle(design, train, &without.kinetics, start, best_v)?;
    let mut factor = VOLTAGE_FACTOR;
    for _ in 0..VOLTAGE_ROUNDS {
        let mut costs = [f64::INFINITY; 2];
        for (side, factor) in [(1, factor), (0, factor.recip())] {
            loop {
                let tried_v = best_v * factor;
                let tried = from(&best, tried_v)?;
                if tried.cost >= best.cost || !VOLTAGES_V.contains(&tried_v) {
                    costs[side] = tried.cost;
                    break;
                }
                costs[1 - side] = best.cost;
                (best_v, best) = (tried_v, tried);
            }
            if costs[0].is_finite() && costs[1].is_finite() {
                break;
            }
        }
        let tried_v = best_v * factor.powf(lowest(costs[0], best.cost, costs[1]));
        let tried = from(&best, tried_v)?;
        if tried.cost < best.cost {
            (best_v, best) = (tried_v, tried);
        }
        factor = factor.sqrt();
    }
    Ok(best)
}

/// Solves with a voltage of charge transfer until the exchange current is that of the resistances.
fn settle(
    design: &Design,
    train: &Train,
    kinetics: &Kinetics,
    mut map: CellMap,
    voltage_v: f64,
) -> Result<Found, MapFitError> {
    let law = ChargeTransfer {
        voltage_v,
        slowest_s: SLOWEST_TRANSFER_S,
    };
    map.charge_transfer = Some(law);
    let at = |map: &CellMap| {
        let kinetics = Kinetics {
            bent: Some(Arc::new(map.clone())),
            ..kinetics.clone()
        };
        evaluate(design, train, kinetics)
    };
    let mut found = at(&map)?;
    for _ in 1..MOST_SOLUTIONS {
        let solved = design.map(&found.kinetics, &found.solved);
        map = ahead(&map, solved, design.transfers());
        let next = at(&map)?;
        let is_settled = (next.cost - found.cost).abs() < SETTLED * next.cost;
        found = next;
        if is_settled {
            break;
        }
    }
    Ok(found)
}

/// Returns a solved map with its branches of charge transfer further away from those of the map before it.
fn ahead(before: &CellMap, mut solved: CellMap, transfers: usize) -> CellMap {
    let whole = |map: &CellMap, node: usize, knot: usize| -> f64 {
        let fast = map.branches[..transfers].iter();
        fast.map(|branch| branch.resistance.r_ohm[node][knot]).sum()
    };
    for node in 0..solved.temperature_degc.len() {
        for knot in 0..solved.soc.len() {
            let (old, new) = (whole(before, node, knot), whole(&solved, node, knot));
            if old <= 0.0 || new <= 0.0 {
                continue;
            }
            let factor = (new / old).powf(AHEAD - 1.0);
            for branch in &mut solved.branches[..transfers] {
                branch.resistance.r_ohm[node][knot] *= factor;
            }
        }
    }
    solved
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
