//! The DC load that discharges the cell at constant current.

mod siglent_sdl;

use crate::{
    exchange::{Exchange, Identity, play, play_all},
    link::{Link, LinkError, LinkProfile},
    supply4q::number,
    units::{Amps, Volts},
};

/// A discharge as it is programmed into the instrument.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Discharge {
    /// Current drawn.
    pub current: Amps,
    /// The instrument itself stops sinking below this.
    pub stop_below: Volts,
}

/// What a model can do.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Capabilities {
    /// Greatest current.
    pub max_current: Amps,
    /// Greatest power, W.
    pub max_power_w: f64,
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
    /// Switches the input.
    fn input(&self, on: bool) -> Vec<Exchange>;
    /// Constant current with its limits; assumes the input is off.
    fn prepare(&self, discharge: &Discharge) -> Vec<Exchange>;
    /// Queries for voltage and current.
    fn measure(&self) -> [&'static str; 2];
}

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&siglent_sdl::SDL1000X];

/// A DC load on its link.
pub struct Load {
    link: Link,
    dialect: &'static dyn Dialect,
}

impl Load {
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

    /// Input off, then constant current with the limits read back.
    ///
    /// # Errors
    /// The first message that was refused or whose read-back was wrong.
    pub async fn prepare(&mut self, discharge: &Discharge) -> Result<(), LinkError> {
        play(&mut self.link, &self.dialect.input(false)).await?;
        play(&mut self.link, &self.dialect.prepare(discharge)).await
    }

    /// Input on.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn energise(&mut self) -> Result<(), LinkError> {
        play(&mut self.link, &self.dialect.input(true)).await
    }

    /// Input off. Safe at any time, also twice.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        play_all(&mut self.link, &self.dialect.input(false)).await
    }

    /// Voltage at the sense terminals and current drawn.
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
