//! All that a map states about a cell in one state, for simulations of many cells and steps.

use super::branch_step::Drive;
use super::{CellMap, Outside};

/// Values of a map in one state of a cell; the resistances of the branches are beside it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MapValues {
    /// Series resistance, Ω.
    pub r_ohm: f64,
    /// What is added to the OCV curve, V.
    pub correction_v: f64,
    /// Exchange current of the branches of charge transfer, A; `None` if all branches are linear.
    pub exchange_a: Option<f64>,
    /// Longest time constant of a branch of charge transfer, s.
    pub slowest_s: f64,
    /// Distance from the measured range.
    pub outside: Outside,
}

impl MapValues {
    /// Returns what drives a branch with a time constant, s, and a resistance, Ω, under a current, A.
    #[inline]
    pub fn drive(&self, tau_s: f64, r_ohm: f64, current_a: f64) -> Drive {
        let exchange_a = self.exchange_a.filter(|_| tau_s <= self.slowest_s);
        Drive::new(exchange_a, r_ohm, current_a)
    }
}

impl CellMap {
    /// Returns the values at a SOC and a temperature, °C, and writes the resistances of the branches,
    /// Ω. They equal those of [`Self::resistance_ohm`]; Arrhenius' law is computed once for surfaces
    /// that follow each other with one energy.
    pub fn values(&self, soc: f64, temperature_degc: f64, branch_ohm: &mut [f64]) -> MapValues {
        let at = self.place(soc, temperature_degc);
        let nodes = self.nodes(&at);
        let mut energy = self.series.activation_j_per_mol;
        let mut factors = at.factors(energy);
        let r_ohm = self.series.weighted_ohm(&nodes, factors);
        for (branch, r_ohm) in self.branches.iter().zip(&mut *branch_ohm) {
            let surface = &branch.resistance;
            if surface.activation_j_per_mol != energy {
                energy = surface.activation_j_per_mol;
                factors = at.factors(energy);
            }
            *r_ohm = surface.weighted_ohm(&nodes, factors);
        }
        let law = self.charge_transfer;
        MapValues {
            r_ohm,
            correction_v: self.ocv_correction_v(&at, temperature_degc),
            exchange_a: law
                .map(|law| law.exchange_a(self.transfer_ohm(branch_ohm), temperature_degc)),
            slowest_s: law.map_or(0.0, |law| law.slowest_s),
            outside: at.outside,
        }
    }
}
