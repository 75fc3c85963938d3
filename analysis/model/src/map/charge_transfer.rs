//! Fall of a resistance under current by charge transfer.

use super::branch_step::Drive;
use super::constants::ZERO_DEGC_K;
use serde::{Deserialize, Serialize};

/// Temperature of the stated voltage, °C.
const REFERENCE_DEGC: f64 = 25.0;

/// Butler–Volmer's law with equal shares of both directions, for the branches of charge transfer.
///
/// In place of v/R, the voltage v of a branch of at most `slowest_s` drives the current
/// 2·i₀·sinh(v/(2·i₀·R)) through its resistance. The exchange current i₀ is not a parameter: small currents
/// meet the whole resistance ΣR of these branches, so that 2·i₀ = b/ΣR, with a voltage b that is
/// 2·R_gas·T/F = 51 mV at 25 °C for one electrode, and more where two electrodes and the thickness of a
/// porous one share the current. It follows the resistances over charge and temperature.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written")]
pub struct ChargeTransfer {
    /// Voltage b of all these branches together at 25 °C, V; elsewhere it is proportional to the absolute
    /// temperature.
    pub voltage_v: f64,
    /// Longest time constant of a branch that the law bends, s.
    pub slowest_s: f64,
}

/// The law as a file has it; an earlier version wrote an exchange current and its energy.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    voltage_v: Option<f64>,
    slowest_s: f64,
    exchange_current_a: Option<f64>,
    activation_j_per_mol: Option<f64>,
}

impl TryFrom<Written> for ChargeTransfer {
    type Error = &'static str;

    fn try_from(written: Written) -> Result<Self, Self::Error> {
        if written.exchange_current_a.is_some() || written.activation_j_per_mol.is_some() {
            return Err(
                "charge_transfer: expected voltage_v and slowest_s, met exchange_current_a or \
                activation_j_per_mol, which an earlier version wrote: fit the map again with eis-bench map",
            );
        }
        let voltage_v = written
            .voltage_v
            .ok_or("charge_transfer: expected voltage_v, met none")?;
        Ok(Self {
            voltage_v,
            slowest_s: written.slowest_s,
        })
    }
}

impl ChargeTransfer {
    /// Returns the voltage b at a temperature, °C, in V.
    pub fn whole_v(&self, temperature_degc: f64) -> f64 {
        self.voltage_v * (temperature_degc + ZERO_DEGC_K) / (REFERENCE_DEGC + ZERO_DEGC_K)
    }

    /// Returns the exchange current of a cell whose branches of charge transfer have a whole resistance, Ω,
    /// at a temperature, °C, in A.
    pub fn exchange_a(&self, whole_ohm: f64, temperature_degc: f64) -> f64 {
        0.5 * self.whole_v(temperature_degc) / whole_ohm.max(Drive::LEAST_OHM)
    }
}
