//! The open-circuit voltage bends more or less than its curve.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Parameter, Range, Record,
};

static CARD: Card = Card {
    name: "ocv_curvature",
    title: "curvature of the open-circuit voltage",
    group: Group::Cell,
    mechanism: "The stated curve is too coarse or was smoothed: between its knots the true one \
    bends otherwise.",
    state_equation: "OCV = U(z) + ½c(z − z₀)²; z₀ at the record's start, where the voltage is \
    known; c in V",
    impedance: "none within the band",
    source: "Taylor series of the open-circuit voltage about the record's start, second term",
    signature: "an error with the square of the charge moved, the same sign for charge and \
    discharge",
    confounders: &[
        "ocv_slope",
        "soc_resistance",
        "surface_soc",
        "butler_volmer_asymmetric",
    ],
    contains: &[],
    experiment: "the same charge moved in both directions; a slow discharge with a finer table",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct OcvCurvature;

impl Effect for OcvCurvature {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let widest = base.facts.widest_soc;
        if widest <= 0.0 {
            return Vec::new();
        }
        // At the widest reach the error is at most a tenth of the whole curve.
        let (Some(first), Some(last)) = (base.ocv.ocv_v.first(), base.ocv.ocv_v.last()) else {
            return Vec::new();
        };
        let most_v = 0.2 * (last - first) / (widest * widest);
        vec![Parameter::strength(
            "curvature_v",
            "V",
            Range {
                lower: -most_v,
                upper: most_v,
            },
            0.02 * most_v,
        )]
    }

    fn dynamics(&self, p: &[f64], _base: &Base, record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Bend {
            half_v: 0.5 * p[0],
            start: record.soc,
        }))
    }

    fn equation(&self, p: &[f64], _base: &Base) -> Option<Equation> {
        Some(Equation::Curvature { half_v: 0.5 * p[0] })
    }
}

struct Bend {
    half_v: f64,
    start: f64,
}

impl Dynamics for Bend {
    fn voltage_v(&self, at: &Instant) -> f64 {
        self.half_v * (at.soc - self.start).powi(2)
    }
}
