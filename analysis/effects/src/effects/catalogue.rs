//! The catalogue: one line per effect.

use super::outside;
use super::{
    ageing, butler_volmer, butler_volmer_asymmetric, cpe, current_asymmetry, diffusion,
    electrolyte_depletion, entropic_heat,
};
use super::{
    channel_bandwidth, clock_error, common_gain, contact_resistance, current_gain, current_offset,
    current_smoothing, inductance, inductance_lossy, insufficient_rest, shunt_heating, thermal_emf,
    time_skew, voltage_gain,
};
use super::{
    hysteresis, ocv_curvature, ocv_slope, rc_slow, self_discharge, self_heating, soc_resistance,
    surface_soc, warburg,
};
use crate::contract::Effect;

static CATALOGUE: &[&dyn Effect] = &[
    // Cell.
    &rc_slow::RcSlow,
    &diffusion::Diffusion,
    &warburg::Warburg,
    &cpe::Cpe,
    &butler_volmer::ButlerVolmer,
    &butler_volmer_asymmetric::ButlerVolmerAsymmetric,
    &self_heating::SelfHeating,
    &entropic_heat::EntropicHeat,
    &ocv_slope::OcvSlope,
    &ocv_curvature::OcvCurvature,
    &hysteresis::Hysteresis,
    &soc_resistance::SocResistance,
    &current_asymmetry::CurrentAsymmetry,
    &electrolyte_depletion::ElectrolyteDepletion,
    &surface_soc::SurfaceSoc,
    &self_discharge::SelfDischarge,
    &ageing::Ageing,
    // Bench.
    &inductance::Inductance,
    &inductance_lossy::InductanceLossy,
    &time_skew::TimeSkew,
    &channel_bandwidth::ChannelBandwidth,
    &contact_resistance::ContactResistance,
    &current_smoothing::CurrentSmoothing,
    &current_gain::CurrentGain,
    &common_gain::CommonGain,
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

/// Returns the effect of a name.
pub fn find(name: &str) -> Option<&'static dyn Effect> {
    CATALOGUE.iter().copied().find(|e| e.card().name == name)
}

/// Returns the title of an effect of the catalogue or of a law outside it.
pub fn title(name: &str) -> Option<&'static str> {
    let mut all = CATALOGUE.iter().chain(outside());
    all.find(|e| e.card().name == name).map(|e| e.card().title)
}

/// Effects that occur together in a cell, so that if one is missing in a model the other often is
/// too: transport and charge transfer carry the same current, hysteresis and diffusion follow the
/// same stored charge, and heat speeds up the charge transfer.
pub const GROUPS: [[&str; 2]; 5] = [
    ["diffusion", "butler_volmer"],
    ["warburg", "butler_volmer"],
    ["hysteresis", "diffusion"],
    ["hysteresis", "surface_soc"],
    ["self_heating", "butler_volmer"],
];
