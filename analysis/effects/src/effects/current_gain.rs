//! The current channels of spectra and records do not agree.

use crate::contract::{Base, Card, Effect, Group, Parameter, Range, Record};

static CARD: Card = Card {
    name: "current_gain",
    title: "gain error of the current channel",
    group: Group::Bench,
    mechanism: "Spectra and time records were measured with different current sensors, one of \
    which reads too little or too much.",
    state_equation: "i = (1 + g)·i_logged in records; g as a fraction",
    impedance: "none: spectra are taken as the reference",
    source: "data sheets of current sensors: gain error",
    signature: "all overpotentials and the counted charge of records are off by the same fraction",
    confounders: &["contact_resistance", "voltage_gain", "ageing"],
    contains: &[],
    experiment: "the same shunt through both instruments",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct CurrentGain;

impl Effect for CurrentGain {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        // Without spectra it cannot be separated from resistances and capacity.
        if base.facts.longest_s <= 0.0 || base.facts.highest_hz.is_none() {
            return Vec::new();
        }
        vec![Parameter::strength(
            "gain",
            "",
            Range {
                lower: -0.3,
                upper: 0.3,
            },
            0.01,
        )]
    }

    fn current(&self, p: &[f64], _record: &Record<'_>, current_a: &mut [f64]) {
        current_a.iter_mut().for_each(|i| *i *= 1.0 + p[0]);
    }
}
