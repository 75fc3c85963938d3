//! The catalogue: one line per effect.

use super::Effect;
use super::{ageing, butler_volmer, butler_volmer_asymmetric, cpe, current_asymmetry, diffusion, electrolyte_depletion, entropic_heat};
use super::{current_offset, time_skew};
use super::{hysteresis, ocv_curvature, ocv_slope, rc_slow, self_discharge, self_heating, soc_resistance, surface_soc, warburg};

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
    &time_skew::TimeSkew,
    &current_offset::CurrentOffset,
];

/// All effects, cells' first.
pub fn catalogue() -> &'static [&'static dyn Effect] {
    CATALOGUE
}

/// The effect of a name.
pub fn find(name: &str) -> Option<&'static dyn Effect> {
    CATALOGUE.iter().copied().find(|e| e.card().name == name)
}
