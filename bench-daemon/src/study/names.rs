//! What the hidden kinds are called in the catalogue, and which true value is which parameter.

use fixtures::hidden::EffectKind as Kind;

/// Name of the catalogue's effect for a hidden kind; none for what is outside of it.
pub fn catalogue_name(kind: Kind) -> Option<&'static str> {
    Some(match kind {
        Kind::SlowRc => "rc_slow",
        Kind::Diffusion => "diffusion",
        Kind::DiffusionSemiInfinite => "warburg",
        Kind::Cpe => "cpe",
        Kind::ButlerVolmer => "butler_volmer",
        Kind::ButlerVolmerAsymmetric => "butler_volmer_asymmetric",
        Kind::Heat => "self_heating",
        Kind::Entropic => "entropic_heat",
        Kind::OcvSlope => "ocv_slope",
        Kind::OcvCurvature => "ocv_curvature",
        Kind::Hysteresis => "hysteresis",
        Kind::ResistanceSoc => "soc_resistance",
        Kind::Asymmetry => "current_asymmetry",
        Kind::Depletion => "electrolyte_depletion",
        Kind::SurfaceSoc => "surface_soc",
        Kind::SelfDischarge => "self_discharge",
        Kind::Ageing => "ageing",
        Kind::Inductance => "inductance",
        Kind::InductanceLossy => "inductance_lossy",
        Kind::TimeSkew => "time_skew",
        Kind::VoltageBandwidth => "channel_bandwidth",
        Kind::CurrentSmoothing => "current_smoothing",
        Kind::CurrentGain => "current_gain",
        Kind::CurrentOffset => "current_offset",
        Kind::ThermalEmf => "thermal_emf",
        Kind::ContactResistance => "contact_resistance",
        Kind::ShuntHeating => "shunt_heating",
        Kind::InsufficientRest => "insufficient_rest",
        Kind::ClockError => "clock_error",
        _ => return None,
    })
}
