//! The section `[map]` as it is typed.

use serde::Deserialize;

use super::{
    quantity::{
        Current, Duration, Quantity, Resistance, Share, Temperature, Voltage, VoltageSlope,
    },
    raw_pulses::{Pulses, Through},
};

/// Measurement at several states of charge and temperatures: at each point the sweep of `[eis]`, the
/// record of `[multisine]` and pulses. The bench needs a load and a supply, the cell file `[ocv]`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Raw {
    /// States of charge, 1 to 50, falling, from 99 % to 1 %: each is measured at each temperature.
    /// Left out: `points`.
    pub(super) soc: Option<Vec<Quantity<Share>>>,
    /// Points in place of `soc`, 1 to 200, in order: those of one temperature follow each other, from
    /// high to low charge.
    pub(super) points: Option<Vec<Point>>,
    /// Temperatures, 1 to 20, all different, within the range of the chiller and the limits of the
    /// cell. `within` and `timeout` of `[temperature]` hold for each; at its `setpoint` the cell is
    /// charged before the points of each temperature.
    pub(super) temperatures: Vec<Quantity<Temperature>>,
    /// Highest resistance of the cell, leads to the voltmeter included, 0.1 mΩ to 1 Ω: one for all
    /// temperatures, or one for each.
    pub(super) resistance_max: Vec<Quantity<Resistance>>,
    /// Current of the full charge, from C/100 to 1C and the limits of cell and supply.
    pub(super) charge_current: Quantity<Current>,
    /// Voltage that the supply holds at the end of the full charge, within the limits of the cell;
    /// at most 5 mV below its highest voltage.
    pub(super) charge_voltage: Quantity<Voltage>,
    /// Current below which the cell counts as full, from 0.02 A to half of `charge_current`.
    pub(super) cut_off: Quantity<Current>,
    /// Current of the discharge from point to point, positive, from C/100 to the limits of cell and
    /// load.
    pub(super) discharge_current: Quantity<Current>,
    /// Voltage under load at which a discharge ends before its charge, at least 50 mV above the
    /// lowest voltage of the cell. Left out: 50 mV above it.
    pub(super) discharge_until: Option<Quantity<Voltage>>,
    /// Shortest rest before each point, 1 s to 86 400 s.
    pub(super) rest_min: Quantity<Duration>,
    /// Longest rest before each point, from `rest_min` to 86 400 s.
    pub(super) rest_max: Quantity<Duration>,
    /// Slope of the voltage below which the rest ends, 1 nV/s to 10 mV/s.
    pub(super) rest_slope: Quantity<VoltageSlope>,
    /// Largest difference between the counted state of charge and that of the OCV curve, 0.2 % to
    /// 20 %.
    #[serde(default = "three_percent")]
    pub(super) soc_within: Quantity<Share>,
    /// Treatment of a point that exceeds `soc_within`.
    #[serde(default = "flag")]
    pub(super) missed: crate::plan::Missed,
    /// Pulses at each point, after sweep and multisine. A pulse that could exceed the voltage limits
    /// of the cell at a point is left out there. Left out: none.
    pub(super) pulses: Option<Pulses>,
    /// Instruments that drive the pulses.
    #[serde(default)]
    pub(super) through: Through,
    /// Resistance between the cell and the voltmeter of the load if load and supply drive the
    /// pulses, 0 Ω to 0.1 Ω. Left out: 0 Ω.
    pub(super) lead_resistance: Option<Quantity<Resistance>>,
}

/// A point of a map.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Point {
    /// State of charge, from 99 % to 1 %.
    pub(super) soc: Quantity<Share>,
    /// Temperature, one of `temperatures`.
    pub(super) temperature: Quantity<Temperature>,
    /// What is measured: `"spectrum"`, the sweep of `[eis]` or the record of `[multisine]`, and
    /// `"pulses"`. Left out: all that the experiment has.
    pub(super) measure: Option<Vec<Signal>>,
}

/// What a map measures at a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Signal {
    /// The sweep of `[eis]` or the record of `[multisine]`.
    Spectrum,
    /// The pulses of `[map]`.
    Pulses,
}

fn three_percent() -> Quantity<Share> {
    Quantity::of(0.03)
}
fn flag() -> crate::plan::Missed {
    crate::plan::Missed::Flag
}
