//! The catalogue of effects that a model may lack: one file per effect, each with its mechanism,
//! equations, bounds, signature and the experiment that would decide it.
//!
//! An effect has a *strength*, its first parameter, which is zero if the effect is absent, and
//! perhaps *shape* parameters. It acts through the hooks of [`Effect`](crate::contract::Effect): on
//! the linear network, on a spectrum's point, on the reading of the current channel, on the cell
//! while time passes, on the reading of the voltage channel. [`crate::augmented`] simulates any set
//! of them together. The search for effects is not here: it is the diagnosis.

mod ageing;
mod butler_volmer;
mod butler_volmer_asymmetric;
mod catalogue;
mod channel_bandwidth;
mod charge_transfer;
mod clock_error;
mod common_gain;
mod contact_resistance;
mod cpe;
mod current_asymmetry;
mod current_gain;
mod current_offset;
mod current_smoothing;
mod diffusion;
mod electrolyte_depletion;
mod entropic_heat;
mod hysteresis;
mod inductance;
mod inductance_lossy;
mod insufficient_rest;
mod ladder;
mod mechanism;
mod ocv_curvature;
mod ocv_slope;
mod outside;
mod rc_slow;
mod resistance_spread;
mod self_discharge;
mod self_heating;
mod shunt_heating;
mod soc_resistance;
mod surface_soc;
#[cfg(test)]
mod tests;
mod thermal_emf;
mod time_skew;
mod voltage_gain;
mod warburg;

pub use catalogue::{GROUPS, catalogue, find, title};
pub use mechanism::Mechanism;
pub use outside::outside;
pub use resistance_spread::resistance_spread;
