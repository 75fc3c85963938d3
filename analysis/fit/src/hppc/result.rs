//! The table of pulse resistances as a value.

use serde::Serialize;

use super::options::Limits;
use crate::loads::{Base, Estimate, KnownSoc};

/// Direction of a pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Direction {
    /// Current out of the cell.
    Discharge,
    /// Current into the cell.
    Charge,
}

impl Direction {
    /// Its name.
    pub fn word(self) -> &'static str {
        match self {
            Self::Discharge => "discharge",
            Self::Charge => "charge",
        }
    }
}

/// What the states of a table are given by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StateAxis {
    /// State of charge, 0 to 1.
    Soc,
    /// Charge drawn since the first row of the log, Ah.
    ChargeDrawn,
    /// Voltage of the rest before the pulse, V: the log has cuts in which charge may have moved.
    RestVoltage,
}

/// Pulse resistances of a log.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Hppc {
    /// Name of the log.
    pub name: String,
    /// What the states are given by: the first of these that all pulses have.
    pub axis: StateAxis,
    /// Times after the start of a pulse, s.
    pub at_s: Vec<f64>,
    /// Limits for the power.
    pub limits: Option<Limits>,
    /// Noise and code steps of the whole log.
    pub noise: Estimate,
    /// Pulses in the order of the log.
    pub pulses: Vec<Pulse>,
    /// Loads that are no pulses, with the reason.
    pub left_out: Vec<LeftOutLoad>,
}

/// A load that is not in the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LeftOutLoad {
    /// Its start in the time of the log, s.
    pub start_s: f64,
    /// Its mean current, A, positive for discharge.
    pub current_a: f64,
    /// Why it is left out.
    pub reason: String,
}

/// A pulse and its resistances.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Pulse {
    /// Last row before the current, in the time of the log, s. Ages of rows count from it.
    pub start_s: f64,
    /// Direction.
    pub direction: Direction,
    /// Current, A, positive for discharge.
    pub current_a: f64,
    /// Duration, s: from the last row before the current to the first row behind it.
    pub duration_s: f64,
    /// State of the cell at its start.
    pub state: PulseState,
    /// One for each time of the table.
    pub resistances: Vec<Resistance>,
    /// Least power of all times.
    pub least_power: Option<LeastPower>,
    /// Remarks, for example the reason why a pulse has no power.
    pub notes: Vec<String>,
}

/// State of the cell at the start of a pulse.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PulseState {
    /// State of charge, if known.
    pub soc: Option<KnownSoc>,
    /// Charge drawn since the first row of the log, Ah; `None` after a cut of the log, in which charge
    /// may have moved.
    pub drawn_ah: Option<f64>,
    /// Temperature of the cell, °C, if logged.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
    /// Voltage of the rest before the pulse; `None` if it stands on a current.
    pub open_circuit: Option<OpenCircuit>,
    /// The current that it stands on.
    pub base: Option<Base>,
}

/// Voltage of a rest, continued to the start of the pulse.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct OpenCircuit {
    /// Voltage, V.
    pub v: f64,
    /// Standard uncertainty, V; `None` if the log does not show its noise.
    pub sigma_v: Option<f64>,
    /// Duration of the rest, s.
    pub rest_s: f64,
}

/// Resistance of a pulse at a time, or why there is none.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Resistance {
    /// Time after the start of the pulse, s.
    pub at_s: f64,
    /// The resistance.
    pub found: Option<Found>,
    /// Why there is none.
    pub reason: Option<String>,
}

/// A resistance of one row of the log.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Found {
    /// Age of the row, s.
    pub row_s: f64,
    /// Resistance, Ω.
    pub ohm: f64,
    /// Standard uncertainty, Ω; `None` if the log does not show its noise.
    pub sigma_ohm: Option<f64>,
    /// Change of the resistance if the current began at its first row and not at the last row before
    /// it, Ω. `None` if the log has no row that shows it.
    pub start_ohm: Option<f64>,
    /// Power at the voltage limit, W.
    pub power_w: Option<f64>,
    /// Its standard uncertainty, W.
    pub power_sigma_w: Option<f64>,
}

/// Least power of a pulse.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LeastPower {
    /// Power, W.
    pub w: f64,
    /// Its standard uncertainty, W.
    pub sigma_w: Option<f64>,
    /// Its time after the start of the pulse, s.
    pub at_s: f64,
}
