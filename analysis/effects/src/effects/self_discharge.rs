//! Charge leaks away inside the cell.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Parameter, Range, Record,
};
use analysis_model::ocv::OcvCurve;

static CARD: Card = Card {
    name: "self_discharge",
    title: "self-discharge",
    group: Group::Cell,
    mechanism: "A side reaction or a soft short inside the cell takes charge that no meter sees.",
    state_equation: "OCV = U(z − i_sd·t/3600Q); i_sd in A, t since the start of the record, whose \
    state of charge is known anew for each record",
    impedance: "none",
    source: "charge balance: a leakage current within the cell",
    signature: "the voltage falls in proportion to time, at rest as well, but never rises",
    confounders: &["current_offset", "thermal_emf", "insufficient_rest"],
    contains: &[],
    experiment: "an hour at rest with the loop open",
};

/// Part of the charge that a sound cell loses in its first day at most: Battery University BU-802b.
const DAILY_PART: f64 = 0.05;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct SelfDischarge;

impl Effect for SelfDischarge {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 {
            return Vec::new();
        }
        // A soft short that empties the cell within two hours.
        let upper = 0.5 * base.ocv.capacity_ah;
        vec![
            Parameter::strength("leak_a", "A", Range { lower: 0.0, upper }, 0.01 * upper).usually(
                Range {
                    lower: 0.0,
                    upper: DAILY_PART * base.ocv.capacity_ah / 24.0,
                },
                "a sound lithium-ion cell loses 5 % in the first day at most (Battery University \
            BU-802b); what leaks more heats the cell by leak × voltage: feel for it at rest, and \
            look for a current that the channel does not see",
            ),
        ]
    }

    fn dynamics(&self, p: &[f64], base: &Base, _record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Leak {
            rate_per_s: p[0] / (3600.0 * base.ocv.capacity_ah),
            curve: base.ocv.clone(),
        }))
    }

    fn equation(&self, p: &[f64], base: &Base) -> Option<Equation> {
        Some(Equation::Leak {
            per_s: p[0] / (3600.0 * base.ocv.capacity_ah),
        })
    }
}

struct Leak {
    rate_per_s: f64,
    curve: OcvCurve,
}

impl Dynamics for Leak {
    fn voltage_v(&self, at: &Instant) -> f64 {
        self.curve.voltage_v(at.soc - self.rate_per_s * at.time_s) - at.ocv_v
    }
}
