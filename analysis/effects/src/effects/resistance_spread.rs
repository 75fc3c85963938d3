//! All resistances of the network a part larger at constant time constants: how a cell scatters
//! from run to run. Never named: the noise is made of it.

use crate::contract::{Base, Card, Effect, Group, Network, Parameter};

static CARD: Card = Card {
    name: "resistance_spread",
    title: "all resistances larger by a part",
    group: Group::Cell,
    mechanism: "Contact pressure, temperature and history scatter from run to run.",
    state_equation: "every resistance of the network × (1 + d); time constants stay",
    impedance: "as its resistances",
    source: "first term of the Taylor series in the logarithm of the resistances",
    signature: "not looked for by name",
    confounders: &[],
    contains: &[],
    experiment: "none: it is never named",
};

/// Returns its only instance. Its only parameter is d; it acts on the parts before it.
pub fn resistance_spread() -> &'static dyn Effect {
    &ResistanceSpread
}

#[derive(Debug)]
struct ResistanceSpread;

impl Effect for ResistanceSpread {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, _base: &Base) -> Vec<Parameter> {
        Vec::new()
    }

    fn network(&self, p: &[f64], _base: &Base, network: &mut Network) {
        network.r_ohm *= 1.0 + p[0];
        network
            .branches
            .iter_mut()
            .for_each(|b| b.r_ohm *= 1.0 + p[0]);
    }
}
