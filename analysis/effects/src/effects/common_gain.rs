//! The current channel is off in spectra and records alike.

use num_complex::Complex64;

use crate::contract::{Base, Card, Effect, Group, Parameter, Point, Range, Record};

static CARD: Card = Card {
    name: "common_gain",
    title: "gain error of the current channel in everything",
    group: Group::Bench,
    mechanism: "Shunt or channel of the current read too little or too much in all measurements. \
    Resistances take it up, so that it looks like a cell of another capacity; only a known \
    impedance instead of the cell shows it.",
    state_equation: "i = (1 + g)·i_logged everywhere; g as a fraction",
    impedance: "Z_logged = (1 + g)·Z, of the cell and of what is known",
    source: "data sheets of shunts and oscilloscopes: gain error",
    signature: "the counted charge is off by a fraction, and so is every impedance, that of a \
    shunt too",
    confounders: &["ocv_slope", "current_gain"],
    contains: &[],
    experiment: "the shunt instead of the cell",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct CommonGain;

impl Effect for CommonGain {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        // Without charge that moves the open-circuit voltage nothing but resistances would show it.
        if base.facts.longest_s <= 0.0 || base.facts.widest_soc <= 0.0 {
            return Vec::new();
        }
        vec![Parameter::strength(
            "gain",
            "",
            Range {
                lower: -0.05,
                upper: 0.05,
            },
            0.01,
        )]
    }

    fn impedance(&self, p: &[f64], _base: &Base, _at: &Point, z_ohm: Complex64) -> Complex64 {
        z_ohm * (1.0 + p[0])
    }

    fn current(&self, p: &[f64], _record: &Record<'_>, current_a: &mut [f64]) {
        current_a.iter_mut().for_each(|i| *i *= 1.0 + p[0]);
    }
}
