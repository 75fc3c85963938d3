//! A place on a map: the nodes around a state of charge and a temperature, and their weights.

use super::constants::{GAS_J_PER_MOL_K, ZERO_DEGC_K};
use serde::Serialize;

/// Distance of a query from the measured range; zero within it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Outside {
    /// SOC below the first or above the last knot, as a positive distance.
    pub soc: f64,
    /// Temperature below the first or above the last node, K, as a positive distance.
    pub temperature_k: f64,
}

impl Outside {
    /// Returns the farther distance of two queries, in each direction.
    #[must_use]
    pub fn farther(self, other: Self) -> Self {
        Self {
            soc: self.soc.max(other.soc),
            temperature_k: self.temperature_k.max(other.temperature_k),
        }
    }

    /// Returns whether the query lies outside the range.
    pub fn is_outside(&self) -> bool {
        self.soc > 0.0 || self.temperature_k > 0.0
    }
}

impl std::fmt::Display for Outside {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "leaves the range in which the map was measured by up to {:.3} of charge and {:.1} K",
            self.soc, self.temperature_k
        )
    }
}

/// A place on the map: the nodes around it and their weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    pub(super) soc: Neighbours,
    pub(super) temperature: Neighbours,
    /// 1/(k·T_node) − 1/(k·T) of both temperature nodes, with the sign of Arrhenius' exponent,
    /// mol/J.
    pub(super) exponents: [f64; 2],
    /// Distance from the measured range.
    pub outside: Outside,
}

/// A list index, and the weight of the entry after it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Neighbours {
    low: usize,
    weight: f64,
}

impl Neighbours {
    /// Finds `x` in a rising list; a place beyond an end is that end.
    fn find(list: &[f64], x: f64) -> Self {
        let last = list.len().saturating_sub(2);
        let low = list
            .partition_point(|knot| *knot <= x)
            .saturating_sub(1)
            .min(last);
        let weight = match list.get(low + 1) {
            Some(high) => ((x - list[low]) / (high - list[low])).clamp(0.0, 1.0),
            None => 0.0,
        };
        Self { low, weight }
    }

    /// Indices and weights, of one entry or of two.
    pub(super) fn pairs(self, count: usize) -> [(usize, f64); 2] {
        let high = (self.low + 1).min(count - 1);
        [(self.low, 1.0 - self.weight), (high, self.weight)]
    }
}

/// Indices and weights of the nodes around a place.
pub(super) struct Nodes {
    pub(super) temperature: [(usize, f64); 2],
    pub(super) soc: [(usize, f64); 2],
}

impl Place {
    /// Finds a SOC and a temperature, °C, among knots and nodes, which rise.
    pub(super) fn find(knots: &[f64], nodes_degc: &[f64], soc: f64, temperature_degc: f64) -> Self {
        let low = Neighbours::find(nodes_degc, temperature_degc).low;
        let high = (low + 1).min(nodes_degc.len() - 1);
        let (at, ends) = (
            inverse_k(temperature_degc),
            [inverse_k(nodes_degc[low]), inverse_k(nodes_degc[high])],
        );
        let weight = if high == low {
            0.0
        } else {
            ((at - ends[0]) / (ends[1] - ends[0])).clamp(0.0, 1.0)
        };
        Self {
            soc: Neighbours::find(knots, soc),
            temperature: Neighbours { low, weight },
            exponents: ends.map(|end| (at - end) / GAS_J_PER_MOL_K),
            outside: Outside {
                soc: distance(knots, soc),
                temperature_k: distance(nodes_degc, temperature_degc),
            },
        }
    }

    /// Returns the factors of Arrhenius' law from both temperature nodes to this place. That of a
    /// node without weight is zero.
    pub(super) fn factors(&self, activation_j_per_mol: f64) -> [f64; 2] {
        let weights = [1.0 - self.temperature.weight, self.temperature.weight];
        let factor = |side: usize| {
            if weights[side] == 0.0 {
                return 0.0;
            }
            (activation_j_per_mol * self.exponents[side]).exp()
        };
        [factor(0), factor(1)]
    }
}

fn distance(list: &[f64], x: f64) -> f64 {
    let (first, last) = (list[0], list[list.len() - 1]);
    (first - x).max(x - last).max(0.0)
}

fn inverse_k(temperature_degc: f64) -> f64 {
    1.0 / (temperature_degc + ZERO_DEGC_K)
}

/// Returns the factor on a resistance by Arrhenius' law between two temperatures, °C: at the first
/// over that at the second.
pub fn arrhenius(activation_j_per_mol: f64, at_degc: f64, over_degc: f64) -> f64 {
    let exponent = inverse_k(at_degc) - inverse_k(over_degc);
    (activation_j_per_mol / GAS_J_PER_MOL_K * exponent).exp()
}
