//! The catalogue: one line per effect.

use super::Effect;
use super::{
    channel_bandwidth, clock_error, contact_resistance, current_gain, current_offset, current_smoothing, inductance, inductance_lossy,
    insufficient_rest, shunt_heating, thermal_emf, time_skew, voltage_gain,
};
use super::{rc_slow, self_heating};

static CATALOGUE: &[&dyn Effect] = &[
    // The cell.
    &rc_slow::RcSlow,
    &self_heating::SelfHeating,
    // The bench.
    &inductance::Inductance,
    &inductance_lossy::InductanceLossy,
    &time_skew::TimeSkew,
    &channel_bandwidth::ChannelBandwidth,
    &contact_resistance::ContactResistance,
    &current_smoothing::CurrentSmoothing,
    &current_gain::CurrentGain,
    &current_offset::CurrentOffset,
    &shunt_heating::ShuntHeating,
    &voltage_gain::VoltageGain,
    &thermal_emf::ThermalEmf,
    &insufficient_rest::InsufficientRest,
    &clock_error::ClockError,
];

/// All effects, cells' first.
pub fn catalogue() -> &'static [&'static dyn Effect] {
    CATALOGUE
}

/// The effect of a name.
pub fn find(name: &str) -> Option<&'static dyn Effect> {
    CATALOGUE.iter().copied().find(|e| e.card().name == name)
}
