//! The DC load that discharges the cell at constant current or constant power.

mod contract;
mod rigol_dl3000;
mod siglent_sdl;

use instruments_domain::units::{Amps, Volts};
use instruments_link::link::LinkError;

use crate::{
    exchange::{Exchange, ExpectedAnswers},
    instrument::Instrument,
    power::moves_current,
};
pub use contract::{Capabilities, Dialect, Discharge, Draw};

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&siglent_sdl::SDL1000X, &rigol_dl3000::DL3000];

/// A DC load on its link.
pub type Load = Instrument<dyn Dialect>;

moves_current!(input);

impl Instrument<dyn Dialect> {
    /// Switches the input off, then sets constant current or power and reads the limits back.
    ///
    /// # Errors
    /// The error of the first message that was refused or whose read-back was wrong.
    pub async fn prepare(&mut self, discharge: &Discharge) -> Result<(), LinkError> {
        let mut expected = self.expected.clone().lock_owned().await;
        *expected = ExpectedAnswers::default();
        self.play(&self.dialect.input(false)).await?;
        let sense = self.sense();
        self.play(&sense).await?;
        let script = self.dialect.prepare(discharge);
        self.play(&script).await?;
        expected.add(&sense);
        expected.add_bounds(&script, self.dialect.bounds());
        expected.add(&self.dialect.level(discharge.draw));
        Ok(())
    }

    /// Sets another level, read back, whether the input is on or off.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn level(&mut self, draw: Draw) -> Result<(), LinkError> {
        self.tell(&self.dialect.level(draw)).await
    }

    /// Makes it a voltmeter for a cell; the input stays off.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn watch(&mut self) -> Result<(), LinkError> {
        self.play(&self.sense()).await?;
        self.play(&self.dialect.watch()).await
    }

    /// Sets where it measures the voltage: at its sense terminals or at its input. `None` leaves it
    /// as it is.
    #[must_use]
    pub fn sensing(mut self, remote: Option<bool>) -> Self {
        self.setup.remote_sense = remote;
        self
    }

    fn sense(&self) -> Vec<Exchange> {
        let remote = self.setup.remote_sense.or(self.dialect.usual_sense());
        remote.map_or_else(Vec::new, |remote| self.dialect.sense(remote))
    }

    /// Switches the input on.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn energise(&mut self) -> Result<(), LinkError> {
        self.tell(&self.dialect.input(true)).await
    }

    /// Switches the input off. Safe at any time, also twice.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        self.expect_nothing().await;
        self.play_all(&self.dialect.input(false)).await
    }
}
