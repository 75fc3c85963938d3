//! Resistances depend on the state of charge.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Modulation, Parameter, Point, Range,
    Record,
};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "soc_resistance",
    title: "resistance over state of charge",
    group: Group::Cell,
    mechanism: "Exchange current and conduction depend on how full the particles are; the base \
    knows one state of charge.",
    state_equation: "R = R_ref·(1 + k(z − z_ref)) for all resistances; z_ref of the spectra; \
    capacitances stay",
    impedance: "the base's with its resistances multiplied by 1 + k(z − z_ref)",
    source: "first term of the Taylor series about z_ref; Plett, Battery Management Systems I, \
    chapter 2: tables of resistance over state of charge",
    signature: "resistance drifts with the charge moved, back when the charge is back",
    confounders: &[
        "self_heating",
        "ageing",
        "ocv_curvature",
        "current_offset",
        "butler_volmer",
    ],
    contains: &[],
    experiment: "a sweep at a second state of charge; bursts without net charge",
};

/// Least factor on a resistance.
const LEAST: f64 = 0.05;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct SocResistance;

fn modulation(k: f64, reference: f64, soc: f64) -> Modulation {
    Modulation::all((1.0 + k * (soc - reference)).max(LEAST))
}

impl Effect for SocResistance {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.widest_soc <= 0.0 {
            return Vec::new();
        }
        vec![Parameter::strength(
            "k",
            "",
            Range {
                lower: -3.0,
                upper: 3.0,
            },
            0.05,
        )]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        z_ohm + modulation(p[0], base.facts.soc, at.soc).change_ohm(&base.erm, at.freq_hz)
    }

    fn dynamics(&self, p: &[f64], base: &Base, _record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Filling {
            k: p[0],
            reference: base.facts.soc,
        }))
    }

    fn equation(&self, p: &[f64], base: &Base) -> Option<Equation> {
        Some(Equation::FactorOfCharge {
            k: p[0],
            reference: base.facts.soc,
            least: LEAST,
        })
    }
}

struct Filling {
    k: f64,
    reference: f64,
}

impl Dynamics for Filling {
    fn modulation(&self, at: &Instant) -> Modulation {
        modulation(self.k, self.reference, at.soc)
    }
}
