//! Diffusion over a finite length.

use super::ladder::transmissive;
use crate::contract::{
    Base, Branch, Card, Effect, Group, Network, Parameter, Range, quantity::log_grid,
};

static CARD: Card = Card {
    name: "diffusion",
    title: "diffusion over a finite length",
    group: Group::Cell,
    mechanism: "Ions must diffuse through a layer (electrolyte in a porous electrode or separator) \
    whose far side keeps its concentration.",
    state_equation: "R_k = 2R_W/g_k, τ_k = τ_d/g_k, g_k = (k + ½)²π²: dv_k/dt = (R_k·i − v_k)/τ_k; \
    R_W in Ω, τ_d in s; close terms merged, the far ones lumped",
    impedance: "Z = R_W·tanh(√(jωτ_d))/√(jωτ_d)",
    source: "Barsoukov and Macdonald, Impedance Spectroscopy, chapter 2: finite-length Warburg \
    element; its Mittag-Leffler series",
    signature: "a slope of 45° that bends into an arc at the bottom of the band; √t after an edge, \
    then an exponential",
    confounders: &["rc_slow", "warburg", "cpe", "surface_soc", "hysteresis"],
    contains: &["warburg"],
    experiment: "a pulse of a minute with half an hour of rest; a sweep down to 1 mHz",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct Diffusion;

impl Effect for Diffusion {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let dc_ohm = base.erm.dc_resistance_ohm();
        let slowest_s = base.facts.slowest_s();
        let fastest_s = 3.0 * base.facts.fastest_s();
        // The slowest start still feels its far side within the data: its slowest branch has
        // τ_d/2.5.
        vec![
            Parameter::strength(
                "r_ohm",
                "Ω",
                Range {
                    lower: 0.0,
                    upper: 3.0 * dc_ohm,
                },
                0.02 * dc_ohm,
            ),
            Parameter::shape(
                "tau_s",
                "s",
                Range {
                    lower: fastest_s,
                    upper: 10.0 * slowest_s,
                },
                log_grid(30.0 * fastest_s, slowest_s / 3.0, 4),
            ),
        ]
    }

    fn network(&self, p: &[f64], _base: &Base, network: &mut Network) {
        network.branches.extend(
            transmissive()
                .iter()
                .map(|r| Branch::linear(p[0] * r.part, p[1] * r.time)),
        );
    }
}
