//! The section `[ocv_soc]` as it is typed.

use serde::Deserialize;

use super::quantity::{Current, Duration, Quantity, Resistance, Voltage, VoltageSlope};

/// The section.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Raw {
    pub(super) charge_current: Quantity<Current>,
    pub(super) charge_voltage: Quantity<Voltage>,
    pub(super) cut_off: Quantity<Current>,
    pub(super) discharge_current: Quantity<Current>,
    pub(super) discharge_until: Quantity<Voltage>,
    pub(super) tail_current: Option<Quantity<Current>>,
    #[serde(default = "nine")]
    pub(super) interruptions: usize,
    #[serde(default = "minute")]
    pub(super) interruption: Quantity<Duration>,
    pub(super) rest_min: Quantity<Duration>,
    pub(super) rest_max: Quantity<Duration>,
    pub(super) rest_slope: Quantity<VoltageSlope>,
    #[serde(default)]
    pub(super) both_directions: bool,
    pub(super) dcir: Option<Quantity<Resistance>>,
    pub(super) polynomial: Option<usize>,
}

fn nine() -> usize {
    9
}
fn minute() -> Quantity<Duration> {
    Quantity::of(60.0)
}
