//! The cell is not the same at the end of the campaign.

use super::{Base, Card, Dynamics, Effect, Group, Instant, Modulation, Parameter, Point, Range, Record};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "ageing",
    title: "ageing between runs",
    group: Group::Cell,
    mechanism: "Films grow and contacts work loose from run to run, so that all resistances rise over the campaign.",
    state_equation: "R = R_ref·(1 + d·n) for all resistances; n is the order of the run over the span of all orders, 0…1; capacitances stay",
    impedance: "the base's with its resistances multiplied by 1 + d·n",
    source: "first term of the Taylor series in the number of runs",
    signature: "a trend of the misfit with the order of runs, in none with frequency or time",
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
        vec![Parameter::strength("d", "", Range { lower: -0.3, upper: 1.0 }, 0.01)]
    }

    fn tells_repeats_apart(&self, _p: &[f64]) -> bool {
        true
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        z_ohm + modulation(p[0], base, at.order).change_ohm(&base.erm, at.freq_hz)
    }

    fn dynamics(&self, p: &[f64], base: &Base, record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Aged { modulation: modulation(p[0], base, record.order) }))
    }
}

fn modulation(d: f64, base: &Base, order: f64) -> Modulation {
    Modulation::all(1.0 + d * if base.facts.orders > 0.0 { order / base.facts.orders } else { 0.0 })
}

struct Aged {
    modulation: Modulation,
}

impl Dynamics for Aged {
    fn modulation(&self, _at: &Instant) -> Modulation {
        self.modulation
    }
}
