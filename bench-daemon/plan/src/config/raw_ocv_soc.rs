//! The section `[ocv_soc]` as it is typed.

use serde::Deserialize;

use super::quantity::{Current, Duration, Quantity, Resistance, Voltage, VoltageSlope};

/// Open-circuit voltage over the state of charge; the bench needs a load and a supply.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Raw {
    /// Current of the charge, from C/100 to 1C and the limits of cell and supply.
    pub(super) charge_current: Quantity<Current>,
    /// Voltage of the supply at the end of a charge, within the limits of the cell.
    pub(super) charge_voltage: Quantity<Voltage>,
    /// Current at which the cell counts as full, from 0.02 A to half of `charge_current`.
    pub(super) cut_off: Quantity<Current>,
    /// Current of the discharge, positive, from C/100 to 1C and the limits of cell and load.
    pub(super) discharge_current: Quantity<Current>,
    /// Voltage under load at which the discharge ends, below `charge_voltage` and within the limits
    /// of the cell.
    pub(super) discharge_until: Quantity<Voltage>,
    /// Current of the last part of the discharge, from 15 % of `discharge_current` to all of it.
    /// Left out: `discharge_current`.
    pub(super) tail_current: Option<Quantity<Current>>,
    /// Number of pauses in each direction, 0 to 50; they show the resistance.
    #[serde(default = "nine")]
    pub(super) interruptions: usize,
    /// Length of a pause, 30 s to 7200 s.
    #[serde(default = "minute")]
    pub(super) interruption: Quantity<Duration>,
    /// Shortest rest before the discharge and between the directions, 1 s to 86 400 s.
    pub(super) rest_min: Quantity<Duration>,
    /// Longest such rest, from `rest_min` to 86 400 s.
    pub(super) rest_max: Quantity<Duration>,
    /// Slope of the voltage below which the rest ends, 1 nV/s to 10 mV/s.
    pub(super) rest_slope: Quantity<VoltageSlope>,
    /// Whether the charge is measured as well.
    #[serde(default)]
    pub(super) both_directions: bool,
    /// Resistance for the compensation of the drop under load, 0 Ω to 1 Ω. Left out: that of the
    /// pauses, whose number must then not be 0.
    pub(super) dcir: Option<Quantity<Resistance>>,
    /// Order of an additional fitted polynomial, 1 to 15. Left out: none.
    pub(super) polynomial: Option<usize>,
}

fn nine() -> usize {
    9
}
fn minute() -> Quantity<Duration> {
    Quantity::of(60.0)
}
