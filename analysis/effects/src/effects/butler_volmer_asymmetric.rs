//! Charge transfer by Butler–Volmer with any transfer coefficient.

use super::charge_transfer::{Kinetics, greatest_beta};
use crate::contract::{Base, Card, Effect, Group, Law, Network, Parameter, Point, Range};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "butler_volmer_asymmetric",
    title: "Butler–Volmer charge transfer, asymmetric",
    group: Group::Cell,
    mechanism: "The reaction at the surface is not equally fast in both directions where the \
    overpotential is large.",
    state_equation: "C·dv/dt = i − (exp(2αβv/R) − exp(−2(1 − α)βv/R))/(2β); β = 1/(2i₀) in 1/A; α \
    of the discharge direction",
    impedance: "Z = R/(g + jωRC); g is the slope of the conducted current at the direct current, \
    averaged over the amplitude",
    source: "Bard and Faulkner, Electrochemical Methods, 3.3; describing function of exponentials: \
    modified Bessel functions",
    signature: "resistance falls with |i| at once, more in one direction than in the other; a \
    second harmonic",
    confounders: &[
        "butler_volmer",
        "current_asymmetry",
        "hysteresis",
        "ocv_curvature",
    ],
    contains: &["butler_volmer"],
    experiment: "pulses of both signs and several amplitudes with equal charge; the second \
    harmonic of a sweep",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct ButlerVolmerAsymmetric;

impl Effect for ButlerVolmerAsymmetric {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.erm.branches.is_empty() {
            return Vec::new();
        }
        let upper = greatest_beta(base);
        vec![
            Parameter::strength(
                "beta_per_a",
                "1/A",
                Range { lower: 0.0, upper },
                0.03 * upper,
            ),
            Parameter::choice("branch", base.erm.branches.len()),
            Parameter::shape(
                "alpha",
                "",
                Range {
                    lower: 0.1,
                    upper: 0.9,
                },
                vec![0.3, 0.7],
            ),
        ]
    }

    fn network(&self, p: &[f64], _base: &Base, network: &mut Network) {
        if let Some(branch) = network
            .branches
            .get_mut(p[1] as usize)
            .filter(|_| p[0] > 0.0)
        {
            branch.law = Law::Asymmetric {
                beta: p[0],
                alpha: p[2],
            };
        }
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        z_ohm
            + Kinetics {
                beta: p[0],
                alpha: p[2],
            }
            .change_ohm(base, p[1] as usize, at)
    }
}
