//! Input and result of a batch of cells.

use analysis_model::map::Outside;
use serde::Serialize;

use super::super::{
    law::Beyond,
    model::{SimModel, SimState},
};

/// One cell (or pack) of a batch.
#[derive(Debug, Clone, Copy)]
pub struct BatchCell<'a> {
    /// The model.
    pub model: &'a SimModel,
    /// State at the start.
    pub state: &'a SimState,
    /// Factor of the profile's demand for this cell.
    pub scale: f64,
}

/// Options of a batch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatchOptions {
    /// Treatment of power that cannot be delivered. [`Beyond::Stop`] continues as [`Beyond::Clamp`]
    /// and reports when it would have stopped; [`Beyond::Bend`] is refused.
    pub beyond: Beyond,
    /// Longest step, s; infinite for the rows of the profile.
    pub max_step_s: f64,
}

impl Default for BatchOptions {
    fn default() -> Self {
        Self {
            beyond: Beyond::Stop,
            max_step_s: f64::INFINITY,
        }
    }
}

/// Result of one cell. Extremes are those at both ends of every step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BatchOutcome {
    /// Lowest voltage at the terminals, V.
    pub min_ccv_v: f64,
    /// Highest voltage at the terminals, V.
    pub max_ccv_v: f64,
    /// Lowest mean voltage of a cell, V, without the interconnect.
    pub min_cell_v: f64,
    /// Highest mean voltage of a cell, V.
    pub max_cell_v: f64,
    /// Energy delivered at the terminals, J (trapezoids).
    pub energy_j: f64,
    /// Charge taken, C.
    #[serde(rename = "charge_c")]
    pub charge_coulomb: f64,
    /// Start of the first step in which the requested power exceeded the available power, s.
    pub infeasible_s: Option<f64>,
    /// The state at the end.
    pub end: SimState,
    /// True when the voltage behind the series resistance was gone under a power: the other figures
    /// then mean nothing.
    pub collapsed: bool,
    /// Largest distance from the range of the map, of a model with a map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outside_map: Option<Outside>,
}
