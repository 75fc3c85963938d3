//! Activation energies and the voltage of charge transfer: the unknowns in which the voltage is not linear.

use super::design::{Design, SLOWEST_TRANSFER_S};
use super::lag;
use super::options::MapFitError;
use super::solve::{Kinetics, START, Solved};
use super::train::Train;
use analysis_model::map::{CellMap, ChargeTransfer};
use std::sync::Arc;

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
/// Factor between two voltages of the first search, and its largest power in both directions.
const VOLTAGE_FACTOR: f64 = 2.0;
const LEAST_POWER: i32 = -2;
const MOST_POWER: i32 = 4;
/// Step of the logarithm of the voltage in the second search.
const VOLTAGE_STEP: f64 = 0.3;
/// Solutions with one voltage at most, and the relative change of the cost at which they end.
const MOST_SOLUTIONS: usize = 5;
const SETTLED: f64 = 1e-3;
/// Largest factor on the whole resistance of charge transfer from one solution to the next.
const MOST_FACTOR: f64 = 3.0;

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
    let mut found = solve_with(design, train, START)?;
    if let Some(lag_s) = lag::find(design, train, &START, &found.solved)? {
        train.lag_s = lag_s;
        found = solve_with(design, train, START)?;
    }
    for _ in 0..ENERGY_ROUNDS {
        found = improve_energies(design, train, found)?;
    }
    // Spectra at rest do not show a fall under current.
    if !train.logs.is_empty() && design.transfer_count() > 0 {
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

fn solve_with(design: &Design, train: &Train, kinetics: Kinetics) -> Result<Found, MapFitError> {
    let solved = design.solve(train, &kinetics)?;
    let energy = |energy: f64, expected: f64| ((energy - expected) / ENERGY_SIGMA).powi(2);
    let law = kinetics.around.as_ref().and_then(|map| map.charge_transfer);
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
        let below = solve_with(design, train, moved(-ENERGY_STEP))?.cost;
        let above = solve_with(design, train, moved(ENERGY_STEP))?.cost;
        let share = lowest(below, best.cost, above).clamp(-2.0, 2.0);
        let tried = solve_with(design, train, moved(share * ENERGY_STEP))?;
        if tried.cost < best.cost {
            best = tried;
        }
    }
    Ok(best)
}

/// Finds the voltage of charge transfer with the lowest cost: walks from the expected one while the cost
/// falls, then looks beside it.
fn find_voltage(design: &Design, train: &Train, without: &Found) -> Result<Found, MapFitError> {
    let settled = |from: &Found, voltage_v: f64| {
        let map = design.map(&from.kinetics, &from.solved);
        solve_bent(design, train, &from.kinetics, map, voltage_v)
    };
    let (mut power, mut best) = (0, settled(without, VOLTAGE_V)?);
    for direction in [1, -1] {
        // Away from the expected voltage only: a cost that has fallen on one side rises on the other.
        while power * direction >= 0 && (LEAST_POWER..=MOST_POWER).contains(&(power + direction)) {
            let tried_v = VOLTAGE_V * VOLTAGE_FACTOR.powi(power + direction);
            let tried = settled(&best, tried_v)?;
            if tried.cost.total_cmp(&best.cost).is_ge() {
                break;
            }
            (power, best) = (power + direction, tried);
        }
    }
    let middle_v = VOLTAGE_V * VOLTAGE_FACTOR.powi(power);
    let beside = |steps: f64| settled(&best, middle_v * (steps * VOLTAGE_STEP).exp());
    let (below, above) = (beside(-1.0)?, beside(1.0)?);
    let share = lowest(below.cost, best.cost, above.cost).clamp(-1.0, 1.0);
    let tried = beside(share)?;
    let all = [below, above, tried].into_iter();
    Ok(all.fold(best, |best, tried| {
        match tried.cost.total_cmp(&best.cost).is_lt() {
            true => tried,
            false => best,
        }
    }))
}

/// Solves with a voltage of charge transfer by Newton's method: each solution is that of the equations
/// around the map of the one before.
fn solve_bent(
    design: &Design,
    train: &Train,
    kinetics: &Kinetics,
    mut map: CellMap,
    voltage_v: f64,
) -> Result<Found, MapFitError> {
    map.charge_transfer = Some(ChargeTransfer {
        voltage_v,
        slowest_s: SLOWEST_TRANSFER_S,
    });
    let kinetics = Kinetics {
        around: Some(Arc::new(map)),
        ..*kinetics
    };
    let mut found = solve_with(design, train, kinetics)?;
    for _ in 1..MOST_SOLUTIONS {
        let kinetics = kinetics_at_solution(design, &found.kinetics, &found.solved);
        let next = solve_with(design, train, kinetics)?;
        let is_settled = (next.cost - found.cost).abs() < SETTLED * next.cost;
        found = next;
        if is_settled {
            break;
        }
    }
    Ok(found)
}

/// Returns the kinetics around the map of their own solution.
pub(super) fn kinetics_at_solution(
    design: &Design,
    kinetics: &Kinetics,
    solved: &Solved,
) -> Kinetics {
    let around = kinetics.around.as_ref().map(|before| {
        let map = design.map(kinetics, solved);
        Arc::new(limit_change(before, map))
    });
    Kinetics {
        around,
        ..*kinetics
    }
}

/// Returns a map with branches of charge transfer whose whole resistance is near that of the map before
/// it: far from it, its equations say little.
fn limit_change(before: &CellMap, mut map: CellMap) -> CellMap {
    let whole_ohm = |map: &CellMap, soc: f64, degc: f64| {
        let mut ohm = vec![0.0; map.branches.len()];
        map.values(soc, degc, &mut ohm);
        map.transfer_ohm(&ohm)
    };
    let transfers = map.transfer_count();
    for node in 0..map.temperature_degc.len() {
        for knot in 0..map.soc.len() {
            let (soc, degc) = (map.soc[knot], map.temperature_degc[node]);
            let (old_ohm, new_ohm) = (whole_ohm(before, soc, degc), whole_ohm(&map, soc, degc));
            if old_ohm <= 0.0 || new_ohm <= 0.0 {
                continue;
            }
            let ratio = new_ohm / old_ohm;
            let factor = ratio.clamp(MOST_FACTOR.recip(), MOST_FACTOR) / ratio;
            for branch in &mut map.branches[..transfers] {
                branch.resistance.r_ohm[node][knot] *= factor;
            }
        }
    }
    map
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
