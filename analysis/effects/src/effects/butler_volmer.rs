//! Charge transfer by Butler–Volmer with a transfer coefficient of one half.

use super::charge_transfer::{Kinetics, greatest_beta};
use crate::contract::{Base, Card, Effect, Group, Law, Network, Parameter, Point, Range};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "butler_volmer",
    title: "Butler–Volmer charge transfer, symmetric",
    group: Group::Cell,
    mechanism: "The reaction at the surface needs an overpotential that grows with the logarithm \
    of the current where the current is large.",
    state_equation: "C·dv/dt = i − sinh(βv/R)/β; strength β² in 1/A², β = 1/(2i₀), expected \
    R/(2kT/e) of its branch",
    impedance: "Z = R/(g + jωRC); g = √(1 + β²I²) under a direct current I, 2I₁(x)/x at an \
    amplitude of x = β|v|/R",
    source: "Bard and Faulkner, Electrochemical Methods, 3.3 and 3.4, α = ½; closed step: Riccati \
    equation in tanh(βv/2R)",
    signature: "resistance falls with |i| at once, the same for both signs; a sweep of small \
    amplitude does not see it",
    confounders: &[
        "self_heating",
        "soc_resistance",
        "shunt_heating",
        "butler_volmer_asymmetric",
    ],
    contains: &[],
    experiment: "pulses of several amplitudes with equal charge; sweeps under direct current",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct ButlerVolmer;

impl Effect for ButlerVolmer {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.erm.branches.is_empty() {
            return Vec::new();
        }
        // β itself would have no slope at absence: the voltage is even in it.
        let upper = greatest_beta(base).powi(2);
        vec![
            Parameter::strength(
                "beta_squared_per_a2",
                "1/A²",
                Range { lower: 0.0, upper },
                1e-3 * upper,
            ),
            Parameter::choice("branch", base.erm.branches.len()),
        ]
    }

    fn network(&self, p: &[f64], _base: &Base, network: &mut Network) {
        if let Some(branch) = network
            .branches
            .get_mut(p[1] as usize)
            .filter(|_| p[0] > 0.0)
        {
            branch.law = Law::Symmetric { beta: p[0].sqrt() };
        }
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        z_ohm
            + Kinetics {
                beta: p[0].sqrt(),
                alpha: 0.5,
            }
            .change_ohm(base, p[1] as usize, at)
    }
}
