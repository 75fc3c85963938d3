//! The open-circuit voltage moves faster or slower with charge than stated.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Parameter, Point, Range, Record,
    storage_ohm,
};
use analysis_model::ocv::OcvCurve;
use num_complex::Complex64;

static CARD: Card = Card {
    name: "ocv_slope",
    title: "slope of the open-circuit voltage (capacity error)",
    group: Group::Cell,
    mechanism: "The cell's capacity is not the stated one, so that the same charge moves the state \
    of charge further or less far.",
    state_equation: "OCV = U(z₀ + (1 + q)(z − z₀)); z₀ at the record's start, Q_true = Q/(1 + q)",
    impedance: "Z += q·(dU/dz)/(jω·3600Q)",
    source: "Plett, Battery Management Systems I, chapter 2: charge counted over capacity",
    signature: "an error proportional to the charge moved, which stays at rest",
    confounders: &[
        "common_gain",
        "hysteresis",
        "current_offset",
        "diffusion",
        "warburg",
        "ocv_curvature",
    ],
    contains: &[],
    experiment: "the same charge moved in both directions; a reference capacity",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct OcvSlope;

impl Effect for OcvSlope {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.widest_soc <= 0.0 {
            return Vec::new();
        }
        vec![Parameter::strength(
            "excess",
            "",
            Range {
                lower: -0.5,
                upper: 0.5,
            },
            0.02,
        )]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if at.is_cell {
            z_ohm + p[0] * storage_ohm(base, at)
        } else {
            z_ohm
        }
    }

    fn dynamics(&self, p: &[f64], base: &Base, record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Moved {
            excess: p[0],
            start: record.soc,
            curve: base.ocv.clone(),
        }))
    }

    fn equation(&self, p: &[f64], _base: &Base) -> Option<Equation> {
        Some(Equation::Slope { excess: p[0] })
    }
}

struct Moved {
    excess: f64,
    start: f64,
    curve: OcvCurve,
}

impl Dynamics for Moved {
    fn voltage_v(&self, at: &Instant) -> f64 {
        self.curve
            .voltage_v(at.soc + self.excess * (at.soc - self.start))
            - at.ocv_v
    }
}
