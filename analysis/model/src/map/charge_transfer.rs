//! Fall of a resistance under current by charge transfer.

use super::constants::{GAS_J_PER_MOL_K, ZERO_DEGC_K};
use serde::{Deserialize, Serialize};

/// Temperature of the stated exchange current, °C.
const REFERENCE_DEGC: f64 = 25.0;

/// Butler–Volmer's law with equal shares of both directions, for the branches of charge transfer.
///
/// The voltage v of a branch of at most `slowest_s` drives the current 2·i₀·sinh(v/(2·i₀·R)) through its
/// resistance in the place of v/R. The exchange current is i₀ at 25 °C; elsewhere it is that by Arrhenius'
/// law times the absolute temperature, because the thermal voltage is proportional to that. It does not
/// follow the state of charge: the usual √(z·(1 − z)) belongs to an electrode that is used from empty to
/// full, and no cell uses one so. Small currents meet the resistance of the map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChargeTransfer {
    /// Exchange current of the cell at 25 °C, A.
    pub exchange_current_a: f64,
    /// Its activation energy, J/mol.
    pub activation_j_per_mol: f64,
    /// Longest time constant of a branch that the law bends, s.
    pub slowest_s: f64,
}

impl ChargeTransfer {
    /// Returns the exchange current at a temperature, °C, in A.
    pub fn exchange_a(&self, temperature_degc: f64) -> f64 {
        let (here_k, reference_k) = (temperature_degc + ZERO_DEGC_K, REFERENCE_DEGC + ZERO_DEGC_K);
        let exponent =
            self.activation_j_per_mol / GAS_J_PER_MOL_K * (1.0 / reference_k - 1.0 / here_k);
        self.exchange_current_a * exponent.exp() * here_k / reference_k
    }
}
