//! The current channel does not read zero at zero.

use crate::contract::{Base, Card, Effect, Group, Parameter, Range, Record};

static CARD: Card = Card {
    name: "current_offset",
    title: "zero error of the current channel",
    group: Group::Bench,
    mechanism: "The logger of the time records shows a current where none flows; the counted \
    charge drifts with it.",
    state_equation: "i = i_logged − i_off; i_off in A, discharge positive",
    impedance: "none: a sweep does not see direct current",
    source: "data sheets of current sensors: zero-flux offset",
    signature: "a ramp of the voltage with time, U'·i_off·t/3600Q, at rest as well",
    confounders: &["ocv_slope", "self_discharge", "thermal_emf"],
    contains: &[],
    experiment: "log the current for ten minutes with the loop open",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct CurrentOffset;

impl Effect for CurrentOffset {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 {
            return Vec::new();
        }
        let most_a = 0.05 * base.facts.greatest_a;
        vec![Parameter::strength(
            "offset_a",
            "A",
            Range {
                lower: -most_a,
                upper: most_a,
            },
            0.02 * most_a,
        )]
    }

    fn current(&self, p: &[f64], _record: &Record<'_>, current_a: &mut [f64]) {
        current_a.iter_mut().for_each(|i| *i -= p[0]);
    }
}
