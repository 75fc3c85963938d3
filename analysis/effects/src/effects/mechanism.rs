//! Mechanisms of a cell: groups of effects whose formulas describe one piece of physics.
//!
//! A real cell follows none of the formulas exactly, and several of them describe it about as well.
//! What they have in common can be named where no single formula can.

use serde::Serialize;

/// A group of effects with one physical cause.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mechanism {
    /// Charge transfer whose resistance depends on the current.
    ChargeTransfer,
    /// Transport that takes time: diffusion, depletion, distributed relaxation.
    Transport,
    /// Warming by the current.
    Heat,
    /// Voltage and resistance that follow the stored charge.
    StoredCharge,
    /// A change from run to run.
    Ageing,
    /// The bench.
    Bench,
}

impl Mechanism {
    /// Returns the mechanism of an effect of the catalogue, by its name; of the bench for others.
    pub fn of(effect: &str) -> Self {
        match effect {
            "butler_volmer" | "butler_volmer_asymmetric" | "current_asymmetry" => {
                Self::ChargeTransfer
            }
            "diffusion"
            | "warburg"
            | "cpe"
            | "rc_slow"
            | "surface_soc"
            | "electrolyte_depletion" => Self::Transport,
            "self_heating" | "entropic_heat" => Self::Heat,
            "ocv_slope" | "ocv_curvature" | "hysteresis" | "soc_resistance" | "self_discharge" => {
                Self::StoredCharge
            }
            "ageing" => Self::Ageing,
            _ => Self::Bench,
        }
    }

    /// Returns the mechanism as text.
    pub fn title(self) -> &'static str {
        match self {
            Self::ChargeTransfer => "charge transfer that changes with the current",
            Self::Transport => "slow transport (diffusion or depletion)",
            Self::Heat => "heat",
            Self::StoredCharge => "stored charge (OCV, hysteresis, resistance over charge)",
            Self::Ageing => "a change from run to run",
            Self::Bench => "the bench",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Mechanism;
    use crate::{contract::Group, effects::catalogue};

    #[test]
    fn effects_of_the_cell_have_a_mechanism_of_the_cell() {
        for effect in catalogue() {
            let card = effect.card();
            let is_bench = Mechanism::of(card.name) == Mechanism::Bench;
            assert_eq!(is_bench, card.group == Group::Bench, "{}", card.name);
        }
    }
}
