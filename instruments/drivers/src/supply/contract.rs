//! Contract between a supply and its dialects.

use instruments_domain::units::{Amps, Volts};

use crate::{
    exchange::{Bound, Exchange, Way},
    instrument::{Model, Unattended},
};

/// A charge as it is programmed into the instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Charge {
    /// Voltage limit.
    pub voltage: Volts,
    /// Current limit.
    pub current: Amps,
}

/// Capabilities of a model.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Capabilities {
    /// Greatest current of one channel.
    pub max_current: Amps,
    /// Greatest voltage of one channel.
    pub max_voltage: Volts,
    /// End of its current without a message.
    pub unattended: Unattended,
}

/// One model's language.
pub trait Dialect: Model {
    /// Capabilities of the model.
    fn capabilities(&self) -> Capabilities;
    /// Switches the output.
    fn output(&self, on: bool) -> Vec<Exchange>;
    /// Ways to deliver nothing while the output does not go off, the gentlest first: the current,
    /// then the voltage, for below the cell's own voltage no charger charges, but one that can sink
    /// would discharge, within its limit of the current.
    fn zero(&self) -> Vec<Way>;
    /// Limits of the current within the instrument.
    fn bounds(&self) -> &'static [Bound];
    /// Sets voltage and current limit; assumes the output is off.
    fn prepare(&self, charge: &Charge) -> Vec<Exchange>;
    /// Sets another current limit; the output state does not change.
    fn level(&self, current: Amps) -> Vec<Exchange>;
    /// Coarsest steps of voltage and current among the units of this model, V and A, if they are
    /// coarser than a millivolt and a milliampere.
    fn coarse_step(&self) -> Option<f64> {
        None
    }
    /// Queries for voltage and current.
    fn measure(&self) -> [&'static str; 2];
}
