//! The signal generator whose sine is the command of the bipolar supply.

mod siglent_sdg;

use crate::{
    exchange::{Exchange, Identity, play, play_all},
    link::{Link, LinkError, LinkProfile},
    units::{Hertz, Volts},
};

/// A sine with an offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sine {
    /// Frequency.
    pub freq: Hertz,
    /// Amplitude, zero to peak.
    pub amplitude: Volts,
    /// Offset.
    pub offset: Volts,
}

/// What a model can do.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Capabilities {
    /// Lowest and highest frequency of a sine.
    pub freq_range: (Hertz, Hertz),
    /// Least amplitude (zero to peak) of a sine into an open circuit: below it the instrument clamps silently.
    pub min_amplitude: Volts,
    /// Greatest |offset| + amplitude into an open circuit.
    pub max_peak: Volts,
    /// Steps in which a frequency can be set.
    pub freq_step: Hertz,
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
    fn output(&self, channel: u8, on: bool) -> Vec<Exchange>;
    /// What an earlier user may have left that makes another voltage of the same setting: load, polarity, burst, sweep, modulation.
    fn prepare(&self, channel: u8) -> Vec<Exchange>;
    /// A sine; the output stays as it is.
    fn sine(&self, channel: u8, sine: &Sine) -> Vec<Exchange>;
    /// A steady voltage; the output stays as it is.
    fn steady(&self, channel: u8, level: Volts) -> Vec<Exchange>;
}

/// Every known model.
pub const DIALECTS: &[&dyn Dialect] = &[&siglent_sdg::SDG1000X];

/// One channel of a signal generator on its link.
pub struct Generator {
    link: Link,
    dialect: &'static dyn Dialect,
    channel: u8,
    /// The volts that are set are the volts that come.
    prepared: bool,
}

impl Generator {
    /// Puts a dialect on a link; `channel` is the output in use. Sends nothing.
    pub fn new(link: Link, dialect: &'static dyn Dialect, channel: u8) -> Self {
        Self { link, dialect, channel, prepared: false }
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

    /// Sets the sine and reads it back: this family clamps silently.
    ///
    /// # Errors
    /// The link's; a read-back that differs.
    pub async fn sine(&mut self, sine: &Sine) -> Result<(), LinkError> {
        self.prepare().await?;
        let script = self.dialect.sine(self.channel, sine);
        match play(&mut self.link, &script).await {
            // The amplitude is clamped by the offset that it finds and the other way round; once more, and each finds the new one.
            Err(LinkError::ReadBack { .. }) => play(&mut self.link, &script).await,
            outcome => outcome,
        }
    }

    /// Sets a steady level.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn steady(&mut self, level: Volts) -> Result<(), LinkError> {
        self.prepare().await?;
        play(&mut self.link, &self.dialect.steady(self.channel, level)).await
    }

    /// Switches the output; off first, then whatever an earlier user left is undone.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn output(&mut self, on: bool) -> Result<(), LinkError> {
        if !on {
            play(&mut self.link, &self.dialect.output(self.channel, false)).await?;
        }
        self.prepare().await?;
        if on { play(&mut self.link, &self.dialect.output(self.channel, true)).await } else { Ok(()) }
    }

    /// Output off. Safe at any time, also twice.
    ///
    /// # Errors
    /// As [`Self::sine`].
    pub async fn safe(&mut self) -> Result<(), LinkError> {
        play_all(&mut self.link, &self.dialect.output(self.channel, false)).await
    }

    /// The link, for reconnecting. Somebody else may have used the instrument meanwhile, so that nothing is taken as set afterwards.
    pub fn link_mut(&mut self) -> &mut Link {
        self.prepared = false;
        &mut self.link
    }

    async fn prepare(&mut self) -> Result<(), LinkError> {
        if !self.prepared {
            play(&mut self.link, &self.dialect.prepare(self.channel)).await?;
            self.prepared = true;
        }
        Ok(())
    }
}
