//! Fall of a resistance under current by charge transfer.

use super::constants::{GAS_J_PER_MOL_K, ZERO_DEGC_K};
use serde::{Deserialize, Serialize};

/// Temperature of the stated exchange current, °C.
const REFERENCE_DEGC: f64 = 25.0;
/// Smallest share of the exchange current at half charge: a cell that is nearly full or empty still
/// exchanges ions.
const LEAST_SHARE: f64 = 0.1;
/// Smallest resistance of a branch in its heat, Ω: below it, the voltage belongs to another state.
const LEAST_OHM: f64 = 1e-5;
/// Largest argument of the hyperbolic sine in the heat of a branch.
const MOST_BEND: f64 = 20.0;

/// Butler–Volmer's law with equal shares of both directions, for the branches of charge transfer.
///
/// A branch of at most `slowest_s` is driven by g(i) = 2·i₀·asinh(i/(2·i₀)) in the place of i. The
/// exchange current is i₀ at half charge and 25 °C; elsewhere it is that times 2·√(z·(1 − z)) (at least
/// 0.1) and by Arrhenius' law times the absolute temperature, because the thermal voltage is
/// proportional to that. Small currents meet the resistance of the map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ChargeTransfer {
    /// Exchange current of the cell at half charge and 25 °C, A.
    pub exchange_current_a: f64,
    /// Its activation energy, J/mol.
    pub activation_j_per_mol: f64,
    /// Longest time constant of a branch that the law bends, s.
    pub slowest_s: f64,
}

impl ChargeTransfer {
    /// Returns the exchange current at a SOC and a temperature, °C, in A.
    pub fn exchange_a(&self, soc: f64, temperature_degc: f64) -> f64 {
        let z = soc.clamp(0.0, 1.0);
        let share = (2.0 * (z * (1.0 - z)).sqrt()).max(LEAST_SHARE);
        let (here_k, reference_k) = (temperature_degc + ZERO_DEGC_K, REFERENCE_DEGC + ZERO_DEGC_K);
        let exponent =
            self.activation_j_per_mol / GAS_J_PER_MOL_K * (1.0 / reference_k - 1.0 / here_k);
        self.exchange_current_a * share * exponent.exp() * here_k / reference_k
    }
}

/// How a current drives a branch in one state of the cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drive {
    /// Exchange current, A; `None` if the branch is linear.
    pub exchange_a: Option<f64>,
}

impl Drive {
    /// Returns the current that drives the branch, A.
    #[inline]
    pub fn driven_a(&self, current_a: f64) -> f64 {
        match self.exchange_a {
            Some(exchange_a) => {
                let twice_a = 2.0 * exchange_a;
                twice_a * (current_a / twice_a).asinh()
            }
            None => current_a,
        }
    }

    /// Returns the change of the driving current with the current, 0 to 1.
    #[inline]
    pub fn slope(&self, current_a: f64) -> f64 {
        match self.exchange_a {
            Some(exchange_a) => {
                let bend = current_a / (2.0 * exchange_a);
                1.0 / (1.0 + bend * bend).sqrt()
            }
            None => 1.0,
        }
    }

    /// Returns the power that a branch of this voltage, V, and resistance, Ω, turns into heat, W.
    #[inline]
    pub fn lost_w(&self, v: f64, r_ohm: f64) -> f64 {
        let current_a = v / r_ohm.max(LEAST_OHM);
        match self.exchange_a {
            Some(exchange_a) => {
                let twice_a = 2.0 * exchange_a;
                v * twice_a * (current_a / twice_a).clamp(-MOST_BEND, MOST_BEND).sinh()
            }
            None => v * current_a,
        }
    }
}
