//! Cells whose resistances follow state of charge and temperature, side by side.
//!
//! All values are those at the terminals: resistances times S/P, voltages times S, exchange current and
//! capacity times P, heat of all cells. Resistances come from `tables`, the branches of charge transfer
//! move in single precision (`bend`), `step` moves the cells.

mod bend;
mod lanes;
mod step;
mod tables;

use super::cell::{BatchCell, BatchOutcome};
use super::plan::Plan;
use analysis_model::map::CellMap;
pub(in crate::forward) use lanes::{MapCell, MapLanes};
pub(in crate::forward) use step::{Steps, run};

/// Branches of one cell side by side. With fewer the compiler makes no vectors of the branches of charge
/// transfer; those of a cell without that law and without heat are faster by eights.
pub(in crate::forward) const ABREAST: usize = 16;
const LINEAR_ABREAST: usize = 8;

/// Runs all steps of a plan through one cell with a map.
pub(super) fn alone(cell: &BatchCell<'_>, plan: &Plan<'_>) -> Vec<BatchOutcome> {
    let cells = std::slice::from_ref(cell);
    let is_linear = |map: &CellMap| map.charge_transfer.is_none() && map.thermal.is_none();
    if cell.model.map().is_some_and(is_linear) {
        outcomes::<1, LINEAR_ABREAST>(cells, plan)
    } else {
        outcomes::<1, ABREAST>(cells, plan)
    }
}

/// Runs all steps of a plan through at most W cells with maps.
pub(super) fn outcomes<const W: usize, const L: usize>(
    cells: &[BatchCell<'_>],
    plan: &Plan<'_>,
) -> Vec<BatchOutcome> {
    let mapped = cells.iter().filter_map(|c| MapCell::of(c.model, c.scale));
    let mapped: Vec<MapCell<'_>> = mapped.collect();
    let lanes = MapLanes::<W, L>::new(&mapped, plan.demand, plan.beyond, &plan.lengths_s);
    let Some(mut lanes) = lanes else {
        return Vec::new();
    };
    for l in 0..W {
        lanes.load(l, cells[l.min(cells.len() - 1)].state);
    }
    run(&mut lanes, Steps::All(plan));
    let each = cells.iter().enumerate();
    each.map(|(l, cell)| lanes.outcome(l, cell, plan)).collect()
}
