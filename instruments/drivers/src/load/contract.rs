//! Contract between a load and its dialects.

use instruments_domain::units::{Amps, Volts, Watts};

use crate::{
    exchange::{Bound, Exchange, Way},
    instrument::{Model, Unattended},
};

/// Quantity that a load draws.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Draw {
    /// Constant current.
    Current(Amps),
    /// Constant power at its terminals.
    Power(Watts),
}

/// A discharge as it is programmed into the instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discharge {
    /// Quantity that is drawn; of levels that change, the greatest.
    pub draw: Draw,
    /// The instrument itself stops sinking below this.
    pub stop_below: Volts,
}

/// Capabilities of a model.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Capabilities {
    /// Greatest current.
    pub max_current: Amps,
    /// Greatest power, W.
    pub max_power_w: f64,
    /// End of its current without a message.
    pub unattended: Unattended,
}

/// One model's language.
pub trait Dialect: Model {
    /// Capabilities of the model.
    fn capabilities(&self) -> Capabilities;
    /// Switches the input.
    fn input(&self, on: bool) -> Vec<Exchange>;
    /// Ways to sink nothing while the input does not open, the gentlest first.
    fn zero(&self) -> Vec<Way>;
    /// Limits of the current within the instrument.
    fn bounds(&self) -> &'static [Bound];
    /// Sets constant current or power with its limits; assumes the input is off.
    fn prepare(&self, discharge: &Discharge) -> Vec<Exchange>;
    /// Sets another level of the prepared function, within its range; the input state does not
    /// change.
    fn level(&self, draw: Draw) -> Vec<Exchange>;
    /// Where the model measures unless the bench file states it; `None` to leave it as it is.
    fn usual_sense(&self) -> Option<bool> {
        None
    }
    /// Selects whether the voltage is measured at the sense terminals or at the input.
    fn sense(&self, remote: bool) -> Vec<Exchange>;
    /// Selects the finest range for a cell's voltage; assumes the input is off.
    fn watch(&self) -> Vec<Exchange>;
    /// Queries for voltage and current.
    fn measure(&self) -> [&'static str; 2];
}
