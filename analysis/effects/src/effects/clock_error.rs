//! The clock of the records is not the clock of the spectra.

use crate::contract::{Base, Card, Effect, Group, Parameter, Range};

static CARD: Card = Card {
    name: "clock_error",
    title: "clock error of the logger",
    group: Group::Bench,
    mechanism: "The logger of the time records counts seconds that are too long or too short, by \
    its oscillator or by a wrong rate in its file.",
    state_equation: "t = (1 + ε)·t_logged; ε as a fraction",
    impedance: "none: the spectra's frequencies are the reference",
    source: "data sheets of oscillators; nominal sampling rates taken for true ones",
    signature: "all time constants and the counted charge of records are off by the same fraction; \
    levels that do not move are right",
    confounders: &["current_gain", "ocv_slope"],
    contains: &[],
    experiment: "a record of a square wave of a generator with a known frequency",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct ClockError;

impl Effect for ClockError {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 {
            return Vec::new();
        }
        vec![Parameter::strength(
            "error",
            "",
            Range {
                lower: -0.3,
                upper: 0.3,
            },
            0.01,
        )]
    }

    fn clock(&self, p: &[f64]) -> f64 {
        1.0 + p[0]
    }
}
