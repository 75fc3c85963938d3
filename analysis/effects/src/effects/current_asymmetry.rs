//! Resistances differ between charge and discharge.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Modulation, Parameter, Point, Range,
    Record,
};
use num_complex::Complex64;
use std::f64::consts::FRAC_1_PI;

static CARD: Card = Card {
    name: "current_asymmetry",
    title: "different resistance for charge and discharge",
    group: Group::Cell,
    mechanism: "Insertion and extraction do not meet the same resistance, at any current.",
    state_equation: "R = R_ref·(1 + a) for i < 0 (charge), R_ref for i ≥ 0, for all resistances; \
    capacitances stay",
    impedance: "the base's with its resistances multiplied by 1 + a·w; w = (arccos u − u√(1 − \
    u²))/π, u = bias/amplitude: ½ without a direct current",
    source: "Plett, Battery Management Systems I, chapter 2: separate resistances of charge and \
    discharge; describing function of a bent line",
    signature: "depends on the sign of the current at once, by the same fraction at every \
    amplitude",
    confounders: &["butler_volmer_asymmetric", "hysteresis"],
    contains: &[],
    experiment: "pulses of both signs at several amplitudes; sweeps under direct current of both \
    signs",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct CurrentAsymmetry;

impl Effect for CurrentAsymmetry {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.greatest_a <= 0.0 {
            return Vec::new();
        }
        vec![Parameter::strength(
            "a",
            "",
            Range {
                lower: -0.5,
                upper: 0.5,
            },
            0.01,
        )]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        z_ohm + Modulation::all(1.0 + p[0] * charging_part(at)).change_ohm(&base.erm, at.freq_hz)
    }

    fn dynamics(&self, p: &[f64], _base: &Base, _record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Sign {
            charging: 1.0 + p[0],
        }))
    }

    fn equation(&self, p: &[f64], _base: &Base) -> Option<Equation> {
        Some(Equation::FactorOfCharging { factor: 1.0 + p[0] })
    }
}

/// Returns the share of a sweep's response that comes from the time in which the cell is charged,
/// 0…1.
fn charging_part(at: &Point) -> f64 {
    let u = match at.amplitude_a {
        Some(amplitude_a) if amplitude_a > at.bias_a.abs() => at.bias_a / amplitude_a,
        _ if at.bias_a == 0.0 => 0.0,
        _ => at.bias_a.signum(),
    };
    FRAC_1_PI * (u.acos() - u * (1.0 - u * u).sqrt())
}

struct Sign {
    charging: f64,
}

impl Dynamics for Sign {
    fn modulation(&self, at: &Instant) -> Modulation {
        Modulation::all(if at.current_a < 0.0 {
            self.charging
        } else {
            1.0
        })
    }
}
