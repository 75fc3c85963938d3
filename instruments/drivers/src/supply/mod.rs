//! The DC supply that charges the cell, constant current then constant voltage.

mod contract;
mod keysight_e36312a;
mod rigol_dp832;
mod siglent_spd;

use instruments_domain::units::{Amps, Volts};
use instruments_link::link::LinkError;

use crate::{
    exchange::{Answer, Way, forget_errors, look},
    instrument::Instrument,
};
pub use contract::{Capabilities, Charge, Dialect};

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[
    &siglent_spd::SPD3303X,
    &keysight_e36312a::E36312A,
    &rigol_dp832::DP832,
];

/// Channel 1 of a DC supply on its link.
pub type Supply = Instrument<dyn Dialect>;

impl Instrument<dyn Dialect> {
    /// Capabilities of the model.
    pub fn capabilities(&self) -> Capabilities {
        self.dialect.capabilities()
    }

    /// Switches the output off, then sets the limits and reads them back.
    ///
    /// # Errors
    /// The error of the first message that was refused or whose read-back was wrong.
    pub async fn prepare(&mut self, charge: &Charge) -> Result<(), LinkError> {
        self.expect_nothing().await;
        forget_errors(&mut self.link).await?;
        self.play(&self.dialect.output(false)).await?;
        self.tell(&self.dialect.prepare(charge)).await
    }

    /// Sets another current limit, read back, whether the output is on or off.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn level(&mut self, current: Amps) -> Result<(), LinkError> {
        self.tell(&self.dialect.level(current)).await
    }

    /// Switches the output on.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn energise(&mut self) -> Result<(), LinkError> {
        self.tell(&self.dialect.output(true)).await
    }

    /// Switches the output off. Safe at any time, also twice.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        self.expect_nothing().await;
        self.play_all(&self.dialect.output(false)).await
    }

    /// Ways to deliver nothing while the output does not go off, the gentlest first.
    pub fn zero(&self) -> Vec<Way> {
        self.dialect.zero()
    }

    /// Limits of the current within the instrument, by its own answers.
    pub async fn bounds(&mut self) -> Vec<String> {
        self.bounded_by(self.dialect.bounds()).await
    }

    /// Queries whether the output is off, and changes nothing.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn look(&mut self) -> Result<Vec<Answer>, LinkError> {
        look(&mut self.link, &self.dialect.output(false)).await
    }

    /// Returns the voltage at the terminals and the current delivered.
    ///
    /// # Errors
    /// The link's errors, including a reply that is not a number.
    pub async fn measure(&mut self) -> Result<(Volts, Amps), LinkError> {
        let queries = self.dialect.measure();
        self.volts_and_amps(queries).await
    }

    /// Queries the current alone, in half the time.
    ///
    /// # Errors
    /// As [`Self::measure`].
    pub async fn measure_current(&mut self) -> Result<Amps, LinkError> {
        let [_, amps] = self.dialect.measure();
        self.keep_amps(None, amps).await
    }
}
