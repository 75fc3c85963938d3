//! The shunt of the current channel warms up and reads differently.

use crate::contract::{Base, Card, Effect, Group, Parameter, Range, Record};

static CARD: Card = Card {
    name: "shunt_heating",
    title: "self-heating of the current shunt",
    group: Group::Bench,
    mechanism: "The current's heat warms the shunt of the time records; its resistance, and with \
    it the reading, moves by its temperature coefficient.",
    state_equation: "i_logged = i·(1 + s·x), τ·dx/dt = i² − x, x(0) = 0; s in 1/A², positive where \
    the warm shunt reads too much; τ in s",
    impedance: "none: the current of a sweep is too small to warm a shunt",
    source: "power coefficient of shunts; thermal time constants of seconds to minutes",
    signature: "the resistance seems to move with the heat received, for both signs alike, and \
    recovers within the shunt's time constant",
    confounders: &["self_heating", "butler_volmer", "current_gain"],
    contains: &[],
    experiment: "two shunts in series; the record of a long pulse into a fake cell",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct ShuntHeating;

impl Effect for ShuntHeating {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 || base.facts.greatest_a <= 0.0 {
            return Vec::new();
        }
        // A fifth off at the largest current: far more than a shunt survives.
        let most = 0.2 / (base.facts.greatest_a * base.facts.greatest_a);
        vec![
            Parameter::strength(
                "per_a2",
                "1/A²",
                Range {
                    lower: -most,
                    upper: most,
                },
                0.01 * most,
            ),
            Parameter::shape(
                "tau_s",
                "s",
                Range {
                    lower: 0.3,
                    upper: 600.0,
                },
                vec![30.0, 5.0],
            ),
        ]
    }

    fn current(&self, p: &[f64], record: &Record<'_>, current_a: &mut [f64]) {
        let mut warmth_a2 = 0.0;
        for (k, i) in current_a.iter_mut().enumerate() {
            // The bounds keep the reading within a fifth; a search may try values beyond.
            *i /= (1.0 + p[0] * warmth_a2).max(0.1);
            let Some(next_s) = record.time_s.get(k + 1) else {
                break;
            };
            let decay = (-(next_s - record.time_s[k]) / p[1]).exp();
            warmth_a2 = decay * warmth_a2 + (1.0 - decay) * *i * *i;
        }
    }
}
