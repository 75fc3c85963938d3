//! The signal generator. Its sine is the set-point of the bipolar supply.

mod contract;
mod keysight_33500b;
mod siglent_sdg;

use instruments_domain::units::Volts;
use instruments_link::link::LinkError;

use crate::{
    exchange::{Answer, Exchange, NOT_KNOWN, forget_errors, look},
    instrument::Instrument,
};
pub use contract::{Capabilities, Dialect, Sine, Wave};
use contract::{DELAY_TOLERANCE_S, PHASE_TOLERANCE_DEG, QUIET_VPP};

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&siglent_sdg::SDG1000X, &keysight_33500b::B33500];

/// One channel of a signal generator on its link.
pub type Generator = Instrument<dyn Dialect>;

impl Instrument<dyn Dialect> {
    /// Capabilities of the model.
    pub fn capabilities(&self) -> Capabilities {
        self.dialect.capabilities()
    }

    /// Sets the sine and reads it back: this family clamps silently. For true volts
    /// [`Self::output`] must have been off before.
    ///
    /// # Errors
    /// The link's; a read-back that differs.
    pub async fn sine(&mut self, sine: &Sine) -> Result<(), LinkError> {
        let script = self.dialect.sine(self.output_channel(), sine);
        self.forget_signal().await;
        match self.tell(&script).await {
            // The amplitude is clamped by the offset that it finds and the other way round; once
            // more, and each finds the new one.
            Err(LinkError::ReadBack { .. }) => self.tell(&script).await,
            outcome => outcome,
        }
    }

    /// Returns the maximum number of steps of a wave, or `None` if the model has no arbitrary
    /// waves.
    pub fn wave_steps(&self) -> Option<usize> {
        self.dialect.wave_steps()
    }

    /// Loads a wave, outputs it and reads back its name, frequency and amplitude. The shape cannot
    /// be read back.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn wave(&mut self, wave: &Wave) -> Result<(), LinkError> {
        let script = self.dialect.wave(self.output_channel(), wave);
        self.forget_signal().await;
        self.tell(&script).await
    }

    /// Returns the maximum number of periods of a burst, or `None` if the model has no bursts.
    pub fn most_periods(&self) -> Option<u32> {
        self.dialect.most_periods()
    }

    /// Starts `periods` periods of the current signal. Afterwards the output stays at its offset,
    /// even if no further message arrives. Without a number the signal does not end.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn burst(&mut self, periods: Option<u32>) -> Result<(), LinkError> {
        let script = self.dialect.burst(self.output_channel(), periods);
        self.refuse_unread(&script, periods)?;
        self.tell(&script).await?;
        self.refuse_unread(&script, periods)
    }

    /// Refuses a burst on a unit that does not answer what it has taken: an end of the signal that
    /// cannot be read back must not be relied on.
    fn refuse_unread(&self, script: &[Exchange], periods: Option<u32>) -> Result<(), LinkError> {
        let unread = script.iter().find_map(|exchange| match exchange {
            Exchange::Set { read_back, .. } if self.link.lacks(read_back) => Some(read_back),
            _ => None,
        });
        match (unread, periods) {
            (Some(question), Some(_)) => Err(LinkError::unexpected(
                self.link.name(),
                question,
                NOT_KNOWN,
                "the settings of the burst",
            )),
            _ => Ok(()),
        }
    }

    /// Sets the closest approximation of a steady offset: the smallest sine, never another waveform
    /// that could restore an old amplitude.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn quiet(&mut self, offset: Volts) -> Result<(), LinkError> {
        let script = self.dialect.quiet(self.output_channel(), offset);
        self.forget_signal().await;
        self.play_all(&script).await
    }

    /// Sets the closest approximation of a steady offset that commands a direct current: the
    /// smallest sine around it, read back.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn direct(&mut self, offset: Volts) -> Result<(), LinkError> {
        let script = self.dialect.direct(self.output_channel(), offset);
        self.forget_signal().await;
        self.tell(&script).await
    }

    /// Switches the output.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn output(&mut self, on: bool) -> Result<(), LinkError> {
        forget_errors(&mut self.link).await?;
        let script = self.dialect.output(self.output_channel(), on);
        self.tell(&script).await
    }

    /// Switches the output off. Safe at any time, also twice.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        let script = self.dialect.output(self.output_channel(), false);
        self.expect_nothing().await;
        self.play_all(&script).await
    }

    /// Queries whether the output is off, and changes nothing.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn look(&mut self) -> Result<Vec<Answer>, LinkError> {
        let script = self.dialect.output(self.output_channel(), false);
        look(&mut self.link, self.dialect.settings(), &script).await
    }

    /// Queries whether the generator is at its least sine around an offset, and changes nothing.
    ///
    /// # Errors
    /// The link's errors.
    pub async fn look_at_zero(&mut self, offset: Volts) -> Result<Vec<Answer>, LinkError> {
        let script = self.dialect.quiet(self.output_channel(), offset);
        look(&mut self.link, self.dialect.settings(), &script).await
    }

    /// Forgets the known state of the signal, but not that of the output.
    async fn forget_signal(&self) {
        let script = self.dialect.output(self.output_channel(), true);
        self.expected.lock().await.keep(&script);
    }

    /// Returns the first of the channels in use, or 1 if none was named.
    fn output_channel(&self) -> u8 {
        self.setup
            .channels
            .first()
            .and_then(|channel| u8::try_from(*channel).ok())
            .unwrap_or(1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use instruments_domain::units::Hertz;

    #[test]
    fn each_shape_has_a_name_of_its_own_that_every_model_takes() {
        let name = |steps: &[f64]| {
            let sine = Sine {
                freq: Hertz(1.0),
                amplitude: Volts(1.0),
                offset: Volts(0.0),
            };
            Wave::named("eis", steps.to_vec(), sine).name
        };
        assert_eq!(name(&[0.0, 1.0]), name(&[0.0, 1.0]));
        let names: std::collections::BTreeSet<String> = (0..1000)
            .map(|shape| name(&[0.0, 1.0 / f64::from(shape + 1)]))
            .collect();
        assert_eq!(names.len(), 1000);
        assert!(
            names.iter().all(|name| name.len() <= 12
                && name.chars().all(|letter| letter.is_ascii_alphanumeric())),
            "{names:?}"
        );
    }
}
