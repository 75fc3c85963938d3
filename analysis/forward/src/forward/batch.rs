//! Many cells under one profile in lockstep: for Monte Carlo, maps and searches, where speed
//! matters and a trace does not.
//!
//! The step is that of [`super::simulate`] without its error control: second order in the step,
//! exact for a prescribed current. Keep the steps short relative to the fastest time constant, or
//! divide them with [`BatchOptions::max_step_s`]. Lanes of a vector are cells; each core processes
//! separate lanes. Results do not depend on the machine, its vector length or its number of cores.

mod cell;
mod kernel;
mod lanes;
mod law;
pub(super) mod mapped;
mod ocv_piece;
mod plan;
mod tally;

use super::error::ForwardError;
use super::law::{Beyond, Demand};
use super::model::OcvSource;
use super::options::SimOptions;
use super::profile::Profile;
pub use cell::{BatchCell, BatchOptions, BatchOutcome};
use lanes::Lanes;
use plan::Plan;
use rayon::prelude::*;

/// RC branches of a model without a map at most.
pub const MAX_BATCH_RC: usize = 8;
/// Cells in lockstep on one core: enough to hide how long a root takes.
const WIDE: usize = 16;

/// Runs one profile through many cells, in the order of the cells.
///
/// # Errors
/// [`ForwardError`] for a state of another model, more than [`MAX_BATCH_RC`] branches, or options
/// that cannot be.
pub fn simulate_batch(
    cells: &[BatchCell<'_>],
    profile: &Profile,
    options: &BatchOptions,
) -> Result<Vec<BatchOutcome>, ForwardError> {
    let checked = SimOptions {
        beyond: options.beyond,
        max_step_s: options.max_step_s,
        ..SimOptions::default()
    };
    checked.check(profile)?;
    if let Beyond::Bend { fraction } = options.beyond {
        return Err(ForwardError::Value {
            what: "batch, power beyond P₀",
            expected: "the tangent (Extrapolate), not the bend",
            met: fraction,
        });
    }
    let mapped = cells.iter().filter(|c| c.model.mapped.is_some()).count();
    if mapped > 0 && mapped < cells.len() {
        return Err(ForwardError::Value {
            what: "batch, cells with a map",
            expected: "all or none",
            met: mapped as f64,
        });
    }
    for cell in cells {
        cell.model.check(cell.state)?;
        if mapped == 0 {
            cell.model.linear_only("batch")?;
        }
        let met = cell.model.erm.branches.len();
        if mapped == 0 && met > MAX_BATCH_RC {
            return Err(ForwardError::TooManyBranches {
                most: MAX_BATCH_RC,
                met,
            });
        }
        if !cell.scale.is_finite() || (profile.demand == Demand::Resistance && cell.scale <= 0.0) {
            let expected = "a finite factor, above 0 for a load resistance";
            return Err(ForwardError::Value {
                what: "scale of a demand",
                expected,
                met: cell.scale,
            });
        }
    }
    let plan = Plan::new(profile, options);
    let run = |chunk: &[BatchCell<'_>]| match (mapped, chunk.len()) {
        (0, 1) => by_branches::<1>(chunk, &plan),
        (0, _) => by_branches::<WIDE>(chunk, &plan),
        // A cell alone has its branches side by side, more cells each other.
        (1, _) => mapped::alone(&chunk[0], &plan),
        _ => mapped::outcomes::<WIDE, WIDE>(chunk, &plan),
    };
    let parts: Vec<Vec<BatchOutcome>> = cells.par_chunks(WIDE).map(run).collect();
    Ok(parts.into_iter().flatten().collect())
}

/// Branches that no cell has are left out of the inner loop.
fn by_branches<const W: usize>(cells: &[BatchCell<'_>], plan: &Plan<'_>) -> Vec<BatchOutcome> {
    match cells
        .iter()
        .map(|c| c.model.erm.branches.len())
        .max()
        .unwrap_or(0)
    {
        0 => run::<W, 0>(cells, plan),
        1 => run::<W, 1>(cells, plan),
        2 => run::<W, 2>(cells, plan),
        3 => run::<W, 3>(cells, plan),
        4 => run::<W, 4>(cells, plan),
        5 => run::<W, 5>(cells, plan),
        6 => run::<W, 6>(cells, plan),
        7 => run::<W, 7>(cells, plan),
        _ => run::<W, 8>(cells, plan),
    }
}

fn run<const W: usize, const N: usize>(
    cells: &[BatchCell<'_>],
    plan: &Plan<'_>,
) -> Vec<BatchOutcome> {
    let mut lanes = Lanes::<W, N>::new(cells, plan);
    let curved = cells
        .iter()
        .any(|c| matches!(c.model.ocv, OcvSource::Curve(_)));
    kernel::run(&mut lanes, plan, curved);
    cells
        .iter()
        .enumerate()
        .map(|(l, cell)| lanes.outcome(l, cell, plan))
        .collect()
}
