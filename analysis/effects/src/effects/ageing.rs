//! The cell has changed at the end of the campaign.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Modulation, Parameter, Point, Range,
    Record,
};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "ageing",
    title: "ageing between runs",
    group: Group::Cell,
    mechanism: "Films grow and contacts work loose from run to run, so that all resistances rise \
    over the campaign.",
    state_equation: "R = R_ref·(1 + d·n) for all resistances; n is the order of the run over the \
    span of all orders, 0…1, or the time since the first run over \
                     the span of all starts; capacitances stay",
    impedance: "the base's with its resistances multiplied by 1 + d·n",
    source: "first term of the Taylor series in the number of runs",
    signature: "a trend of the misfit with the order of runs or the time since the first, in none \
    with frequency",
    confounders: &["current_gain", "contact_resistance", "soc_resistance"],
    contains: &[],
    experiment: "the first run once more at the end; runs in random order",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct Ageing;

impl Effect for Ageing {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.orders <= 0.0 {
            return Vec::new();
        }
        // By the order of runs, or by time, within a run too.
        let ways = if base.facts.span_s > 0.0 { 2 } else { 1 };
        vec![
            Parameter::strength(
                "d",
                "",
                Range {
                    lower: -0.3,
                    upper: 1.0,
                },
                0.01,
            ),
            Parameter::choice("by_time", ways),
        ]
    }

    fn tells_repeats_apart(&self, _p: &[f64]) -> bool {
        true
    }

    /// The effect stays as at the end of the campaign: a campaign of hours does not determine what
    /// a cell does over days.
    fn predicting(&self, p: Vec<f64>) -> Vec<f64> {
        vec![p[0], 0.0]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        Aged::new(p, base, at.order, at.start_s)
            .after(0.0)
            .change_ohm(&base.erm, at.freq_hz)
            + z_ohm
    }

    fn dynamics(&self, p: &[f64], base: &Base, record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Aged::new(p, base, record.order, record.start_s)))
    }

    fn equation(&self, p: &[f64], base: &Base) -> Option<Equation> {
        // By time, the factor would follow the age of the cell, which a prediction does not know.
        (p[1] <= 0.5).then(|| Equation::Factor {
            factor: Aged::new(p, base, base.facts.orders, base.facts.span_s)
                .after(0.0)
                .series,
        })
    }
}

/// Growth at the start of a run, and per second.
struct Aged {
    start: f64,
    per_s: f64,
}

impl Aged {
    fn new(p: &[f64], base: &Base, order: f64, start_s: f64) -> Self {
        let (orders, span_s) = (base.facts.orders, base.facts.span_s);
        if p[1] > 0.5 && span_s > 0.0 {
            return Self {
                start: p[0] * start_s / span_s,
                per_s: p[0] / span_s,
            };
        }
        Self {
            start: if orders > 0.0 {
                p[0] * order / orders
            } else {
                0.0
            },
            per_s: 0.0,
        }
    }

    /// So long after the start of the run.
    fn after(&self, time_s: f64) -> Modulation {
        Modulation::all(1.0 + self.start + self.per_s * time_s)
    }
}

impl Dynamics for Aged {
    fn modulation(&self, at: &Instant) -> Modulation {
        self.after(at.time_s)
    }
}
