//! An additional relaxation, slower than the base's branches or between them.

use crate::contract::{
    Base, Branch, Card, Effect, Group, Network, Parameter, Range, quantity::log_grid,
};

static CARD: Card = Card {
    name: "rc_slow",
    title: "additional relaxation",
    group: Group::Cell,
    mechanism: "A relaxation with one time constant that the base model has no branch for.",
    state_equation: "dv/dt = (R·i − v)/τ; R in Ω, τ in s",
    impedance: "Z = R/(1 + jωτ)",
    source: "thesis, equation 3.1, one more branch",
    signature: "a single exponential after an edge, proportional to the current, the same for \
    charge and discharge",
    confounders: &["diffusion", "warburg", "hysteresis", "cpe"],
    contains: &[],
    experiment: "a longer pulse with a long rest",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct RcSlow;

impl Effect for RcSlow {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let dc_ohm = base.erm.dc_resistance_ohm();
        let slowest_s = base
            .facts
            .longest_s
            .max(base.facts.lowest_hz.map_or(0.0, |f| 1.0 / f));
        let fastest_s = base
            .facts
            .highest_hz
            .map_or(base.facts.shortest_s, |f| 0.1 / f);
        let range = Range {
            lower: fastest_s,
            upper: 3.0 * slowest_s,
        };
        vec![
            Parameter::strength(
                "r_ohm",
                "Ω",
                Range {
                    lower: 0.0,
                    upper: dc_ohm,
                },
                0.02 * dc_ohm,
            ),
            Parameter::shape("tau_s", "s", range, log_grid(fastest_s * 3.0, slowest_s, 6)),
        ]
    }

    fn network(&self, p: &[f64], _base: &Base, network: &mut Network) {
        network.branches.push(Branch::linear(p[0], p[1]));
    }
}
