//! Runs whose steps are halved until they agree.

use super::error::ForwardError;
use super::law::Beyond;
use super::model::SimModel;
use super::options::{SimOptions, Simulation};

/// Halvings at most.
const MOST_HALVINGS: u32 = 8;
/// First step after a change of the demand, as a part of the shortest time constant.
pub(super) const FIRST: f64 = 0.25;
/// Ratio of the length of each step to the one before.
pub(super) const GROWTH: f64 = 1.3;
/// Longest step of a run without halvings, s.
pub(super) const LONGEST_S: f64 = 2.0;

/// Why no two runs agree.
pub(super) enum Apart {
    /// A run failed.
    Failed(ForwardError),
    /// The shortest steps still differ.
    Unresolved {
        /// Largest difference allowed, V per cell.
        tolerance_v: f64,
        /// Difference met, V per cell.
        met_v: f64,
    },
}

/// Repeats a run, given the number of halvings of its steps, until no row differs by more than
/// `agree_v` (V per cell) from the run before, or by as much more as the largest overpotential of a cell
/// exceeds 1 V. A run that stops where power ends is as good as the instant at which it stops.
pub(super) fn halved(
    model: &SimModel,
    options: &SimOptions,
    agree_v: f64,
    play: impl Fn(u32) -> Result<Simulation, ForwardError>,
) -> Result<Simulation, Apart> {
    let series = f64::from(model.pack.series);
    let tolerance_v = |run: &Simulation| {
        let rows = run.trace.ccv_v.iter().zip(&run.trace.ocv_v);
        let losses_v = rows.map(|(v, ocv_v)| (ocv_v - v).abs() / series);
        agree_v * losses_v.fold(1.0, f64::max)
    };
    let mut coarse = play(0).map_err(Apart::Failed)?;
    let (mut met_v, mut allowed_v) = (f64::NAN, agree_v);
    for halvings in 1..=MOST_HALVINGS {
        let fine = play(halvings).map_err(Apart::Failed)?;
        let stopped =
            options.beyond == Beyond::Stop && !fine.summary.feasible && !coarse.summary.feasible;
        let rows = fine.trace.ccv_v.iter().zip(&coarse.trace.ccv_v);
        met_v = rows.fold(0.0, |most: f64, (a, b)| most.max((a - b).abs())) / series;
        allowed_v = tolerance_v(&fine);
        if stopped || (met_v <= allowed_v && fine.trace.ccv_v.len() == coarse.trace.ccv_v.len()) {
            return Ok(fine);
        }
        coarse = fine;
    }
    Err(Apart::Unresolved {
        tolerance_v: allowed_v,
        met_v,
    })
}
