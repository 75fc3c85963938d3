//! The DC supply that charges the cell, constant current then constant voltage.

mod contract;
mod keysight_e36312a;
mod rigol_dp832;
mod siglent_spd;

use instruments_domain::units::{Amps, Volts};
use instruments_link::link::LinkError;

use crate::{
    exchange::{Exchange, forget_errors},
    instrument::Instrument,
    power::moves_current,
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

moves_current!(output);

impl Instrument<dyn Dialect> {
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
}
