//! Options of a simulation, and its output.

use super::error::ForwardError;
use super::law::Beyond;
use super::limits::CellWindow;
use super::model::SimState;
use super::profile::Profile;
use super::trace::{Summary, Trace};
use serde::{Deserialize, Serialize};

/// Pieces of a profile at most: beyond it a trace would fill the memory.
const MOST_PIECES: f64 = 1e8;

/// Kind of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Exponential steps of second order with error control.
    Exact,
    /// The thesis' three steps: explicit Euler.
    Thesis,
}

/// Options of a simulation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimOptions {
    /// Kind of step.
    pub method: Method,
    /// Treatment of power that cannot be had.
    pub beyond: Beyond,
    /// Error of a sub-step at most, V per cell in series.
    pub tolerance_v: f64,
    /// Longest distance of two rows of the trace, s; infinite for the rows of the profile.
    pub max_step_s: f64,
    /// Longest step of [`Method::Thesis`], s; none for a quarter of the shortest time constant.
    pub thesis_step_s: Option<f64>,
    /// Limits of a cell.
    pub window: CellWindow,
}

impl Default for SimOptions {
    fn default() -> Self {
        Self {
            method: Method::Exact,
            beyond: Beyond::Stop,
            tolerance_v: 1e-8,
            max_step_s: f64::INFINITY,
            thesis_step_s: None,
            window: CellWindow::THESIS,
        }
    }
}

impl SimOptions {
    pub(super) fn check(&self, profile: &Profile) -> Result<(), ForwardError> {
        let bad = |what, expected, met| {
            Err(ForwardError::Value {
                what,
                expected,
                met,
            })
        };
        if let (false, Some(fraction)) = (self.beyond.is_valid(), self.beyond.fraction()) {
            return bad(
                "fraction of the available power",
                "a number above 0 and below 1",
                fraction,
            );
        }
        if self.tolerance_v.is_nan() || self.tolerance_v <= 0.0 {
            return bad("tolerance", "a number of volts above 0", self.tolerance_v);
        }
        if self.max_step_s.is_nan()
            || self.max_step_s <= 0.0
            || profile.duration_s() / self.max_step_s > MOST_PIECES
        {
            return bad(
                "longest step",
                "a number of seconds above 0 that makes fewer than 1e8 steps",
                self.max_step_s,
            );
        }
        Ok(())
    }
}

/// All that a simulation delivers.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {
    /// Figures of the whole run.
    pub summary: Summary,
    /// The run over time.
    pub trace: Trace,
    /// The state at the end.
    pub end: SimState,
}
