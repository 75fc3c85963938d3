//! The DC supply that charges the cell, constant current then constant voltage.

mod contract;
mod keysight_e36312a;
mod rigol_dp832;
mod siglent_spd;

use instruments_domain::units::{Amps, Volts};
use instruments_link::link::LinkError;

use crate::{
    exchange::{Answer, Exchange, Way, forget_errors, look},
    instrument::Instrument,
};
pub use contract::{Capabilities, Charge, Dialect};

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[
    &siglent_spd::SPD3303X,
    &keysight_e36312a::E36312A,
    &rigol_dp832::DP832,
];

/// Returns the greatest multiple of a step that is not above a value.
fn below(value: f64, step: f64) -> f64 {
    /// Part of a step that rounding may take from a value.
    const SLACK: f64 = 1.0e-6;
    (value / step + SLACK).floor() * step
}

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
        let script = self.dialect.prepare(charge);
        let coarser = self.dialect.coarse_step().map(|step| Charge {
            voltage: Volts(below(charge.voltage.value(), step)),
            current: Amps(below(charge.current.value(), step)),
        });
        let coarser = coarser.filter(|coarser| coarser != charge && coarser.current.value() > 0.0);
        let coarser = coarser.map(|coarser| {
            let words = format!("{} and {}", coarser.voltage, coarser.current);
            (self.dialect.prepare(&coarser), words)
        });
        self.tell_or_coarser(&script, coarser).await
    }

    /// Sets a script; if it does not read back, sets that of coarser values below, and says so. A
    /// unit that rounds would round up as well as down.
    async fn tell_or_coarser(
        &mut self,
        script: &[Exchange],
        coarser: Option<(Vec<Exchange>, String)>,
    ) -> Result<(), LinkError> {
        match (self.tell(script).await, coarser) {
            (Err(LinkError::ReadBack { answered, .. }), Some((coarser, words))) => {
                self.tell(&coarser).await?;
                self.link.note(&format!(
                    "the unit has coarser steps (it answered {answered}): set to {words}, rounded \
                    down"
                ));
                Ok(())
            }
            (outcome, _) => outcome,
        }
    }

    /// Sets another current limit, read back, whether the output is on or off.
    ///
    /// # Errors
    /// As [`Self::prepare`].
    pub async fn level(&mut self, current: Amps) -> Result<(), LinkError> {
        let script = self.dialect.level(current);
        let coarser = self
            .dialect
            .coarse_step()
            .map(|step| Amps(below(current.value(), step)));
        let coarser = coarser.filter(|coarser| *coarser != current && coarser.value() > 0.0);
        let coarser = coarser.map(|amps| (self.dialect.level(amps), amps.to_string()));
        self.tell_or_coarser(&script, coarser).await
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
        look(
            &mut self.link,
            self.dialect.settings(),
            &self.dialect.output(false),
        )
        .await
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
