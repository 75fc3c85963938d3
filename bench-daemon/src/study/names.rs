//! What the hidden kinds are called in the catalogue, and which true value is which parameter.

use fixtures::hidden::{EffectKind as Kind, LabelledEffect};

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

/// The strength of the catalogue's effect (its first parameter, in its unit) that a hidden effect
/// has; none for what is outside of the catalogue.
pub fn true_strength(effect: &LabelledEffect) -> Option<f64> {
    let of = |name: &str| {
        effect
            .parameters
            .iter()
            .find(|p| p.name == name)
            .map(|p| p.value)
    };
    let first = effect.parameters.first().map(|p| p.value)?;
    catalogue_name(effect.kind)?;
    Some(match effect.kind {
        Kind::Diffusion => of("r_w_ohm")?,
        Kind::Cpe => 1.0 - of("alpha")?,
        // β is even in the voltage: the catalogue's strength is its square.
        Kind::ButlerVolmer => of("beta_per_a")?.powi(2),
        Kind::ButlerVolmerAsymmetric => of("beta_per_a")?,
        Kind::Heat => of("kappa_per_k")? / of("heat_j_per_k")?,
        Kind::Entropic => of("entropy_v_per_k")?,
        Kind::OcvCurvature => 2.0 * of("curvature_v")?,
        Kind::Hysteresis => of("m_v")?,
        Kind::Depletion => of("gain_per_a")?,
        Kind::SurfaceSoc => of("surface_soc_per_a")?,
        // Orders run from 0 to 16 in the standard campaign.
        Kind::Ageing => 16.0 * of("per_run")?,
        // Stated at 300 Hz there and at 1 kHz here.
        Kind::InductanceLossy => of("l_at_300hz_h")? * (1000.0_f64 / 300.0).powf(of("n")? - 1.0),
        Kind::TimeSkew => -of("skew_s")?,
        Kind::CurrentGain => 1.0 / (1.0 + of("gain_rel")?) - 1.0,
        Kind::ClockError => -of("clock_rel")? / (1.0 + of("clock_rel")?),
        Kind::ShuntHeating => of("per_a2")?,
        Kind::InsufficientRest => of("rest_v")?,
        _ => first,
    })
}
