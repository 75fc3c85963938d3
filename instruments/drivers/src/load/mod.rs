//! The DC load that discharges the cell at constant current or constant power.

mod rigol_dl3000;
mod siglent_sdl;

use instruments_domain::units::{Amps, Volts, Watts};
use instruments_link::link::LinkError;

use crate::{
    exchange::{Answer, Bound, Exchange, ExpectedAnswers, Way, look},
    instrument::{Instrument, Model, Unattended},
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
    /// Constant current or power with its limits; assumes the input is off.
    fn prepare(&self, discharge: &Discharge) -> Vec<Exchange>;
    /// Another level of the function that was prepared, within its range; the input stays as it is.
    fn level(&self, draw: Draw) -> Vec<Exchange>;
    /// The finest range for a cell's voltage; assumes the input is off.
    fn watch(&self) -> Vec<Exchange>;
    /// Queries for voltage and current.
    fn measure(&self) -> [&'static str; 2];
}

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&siglent_sdl::SDL1000X, &rigol_dl3000::DL3000];

/// A DC load on its link.
pub type Load = Instrument<dyn Dialect>;

impl Instrument<dyn Dialect> {
    /// Capabilities of the model.
    pub fn capabilities(&self) -> Capabilities {
        self.dialect.capabilities()
    }

    /// Input off, then constant current or power with the limits read back.
    ///
    /// # Errors
    /// The first message that was refused or whose read-back was wrong.
    pub async fn prepare(&mut self, discharge: &Discharge) -> Result<(), LinkError> {
        self.play(&self.dialect.input(false)).await?;
        self.expected = ExpectedAnswers::default();
        let script = self.dialect.prepare(discharge);
        self.play(&script).await?;
        self.expected.add_bounds(&script, self.dialect.bounds());
        self.expected.add(&self.dialect.level(discharge.draw));
        Ok(())
    }

    /// Another level, read back, whether the input is on or off.
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
        self.play(&self.dialect.watch()).await
    }

    /// Input on.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn energise(&mut self) -> Result<(), LinkError> {
        self.tell(&self.dialect.input(true)).await
    }

    /// Input off. Safe at any time, also twice.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        self.expected = ExpectedAnswers::default();
        self.play_all(&self.dialect.input(false)).await
    }

    /// Ways to sink nothing while the input does not open, the gentlest first.
    pub fn zero(&self) -> Vec<Way> {
        self.dialect.zero()
    }

    /// Limits of the current within the instrument, by its own answers.
    pub async fn bounds(&mut self) -> Vec<String> {
        self.bounded_by(self.dialect.bounds()).await
    }

    /// Asks whether the input is off, and changes nothing.
    ///
    /// # Errors
    /// The link's.
    pub async fn look(&mut self) -> Result<Vec<Answer>, LinkError> {
        look(&mut self.link, &self.dialect.input(false)).await
    }

    /// Voltage at the sense terminals and current drawn.
    ///
    /// # Errors
    /// The link's; an answer that is no number.
    pub async fn measure(&mut self) -> Result<(Volts, Amps), LinkError> {
        let queries = self.dialect.measure();
        self.volts_and_amps(queries).await
    }
}
