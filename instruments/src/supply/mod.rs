//! The DC supply that charges the cell, constant current then constant voltage.

mod siglent_spd;

use crate::{
    exchange::{Exchange, Identity, forget_errors, play, play_all},
    link::{Link, LinkError, LinkProfile},
    supply4q::number,
    units::{Amps, Volts},
};

/// A charge as it is programmed into the instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Charge {
    /// Voltage limit.
    pub voltage: Volts,
    /// Current limit.
    pub current: Amps,
}

/// What a model can do.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Capabilities {
    /// Greatest current of one channel.
    pub max_current: Amps,
    /// Greatest voltage of one channel.
    pub max_voltage: Volts,
}

/// One model's language.
pub trait Dialect: Send + Sync {
    /// The name in a bench file.
    fn key(&self) -> &'static str;
    /// Pace and deadlines of its link.
    fn profile(&self) -> LinkProfile;
    /// What it can do.
    fn capabilities(&self) -> Capabilities;
    /// Whether an identity answer is this dialect's.
    fn recognises(&self, identity: &Identity) -> bool;
    /// Switches the output.
    fn output(&self, on: bool) -> Vec<Exchange>;
    /// Voltage and current limit; assumes the output is off.
    fn prepare(&self, charge: &Charge) -> Vec<Exchange>;
    /// Queries for voltage and current.
    fn measure(&self) -> [&'static str; 2];
}

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&siglent_spd::SPD3303X];

/// Channel 1 of a DC supply on its link.
pub struct Supply {
    link: Link,
    dialect: &'static dyn Dialect,
}

impl Supply {
    /// Puts a dialect on a link. Sends nothing.
    pub fn new(link: Link, dialect: &'static dyn Dialect) -> Self {
        Self { link, dialect }
    }

    /// What the model can do.
    pub fn capabilities(&self) -> Capabilities {
        self.dialect.capabilities()
    }

    /// Asks who it is; changes nothing.
    ///
    /// # Errors
    /// The link's.
    pub async fn identify(&mut self) -> Result<Identity, LinkError> {
        Ok(Identity::parse(&self.link.query("*IDN?").await?))
    }

    /// Output off, then the limits, read back.
    ///
    /// # Errors
    /// The first message that was refused or whose read-back was wrong.
    pub async fn prepare(&mut self, charge: &Charge) -> Result<(), LinkError> {
        forget_errors(&mut self.link).await?;
        play(&mut self.link, &self.dialect.output(false)).await?;
        play(&mut self.link, &self.dialect.prepare(charge)).await
    }

    /// Output on.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn energise(&mut self) -> Result<(), LinkError> {
        play(&mut self.link, &self.dialect.output(true)).await
    }

    /// Output off. Safe at any time, also twice.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        play_all(&mut self.link, &self.dialect.output(false)).await
    }

    /// Voltage at the terminals and current delivered.
    ///
    /// # Errors
    /// The link's; an answer that is no number.
    pub async fn measure(&mut self) -> Result<(Volts, Amps), LinkError> {
        let [volts, amps] = self.dialect.measure();
        Ok((Volts(number(&mut self.link, volts).await?), Amps(number(&mut self.link, amps).await?)))
    }

    /// The link, for reconnecting.
    pub fn link_mut(&mut self) -> &mut Link {
        &mut self.link
    }
}
