//! Contract between a generator and its dialects.

use instruments_domain::units::{Hertz, Volts};

use crate::{exchange::Exchange, instrument::Model};

/// Largest accepted smallest sine of a model, V peak to peak: 20 mA of a supply of ±20 A at ±10 V,
/// a fifth of what a meter may show without a current.
pub(super) const QUIET_VPP: f64 = 0.02;

/// A burst may begin so far from phase zero, degrees: behind it stays the level at which it began,
/// here a thousandth of the amplitude.
pub(super) const PHASE_TOLERANCE_DEG: f64 = 0.05;

/// Largest delay of a burst after its trigger, s: the smallest setting of the models is below a
/// microsecond.
pub(super) const DELAY_TOLERANCE_S: f64 = 1.0e-3;

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

/// A periodic signal of any shape with an offset.
#[derive(Debug, Clone, PartialEq)]
pub struct Wave {
    /// Its name in the instrument: a letter, then letters and digits.
    pub name: String,
    /// One period in equal steps, −1 … 1 of the amplitude; their number is a power of two, at most
    /// what the model holds.
    pub steps: Vec<f64>,
    /// Periods per second.
    pub freq: Hertz,
    /// Amplitude, zero to peak.
    pub amplitude: Volts,
    /// Offset.
    pub offset: Volts,
}

impl Wave {
    /// Creates a wave whose name ends in a digest of its shape. An instrument that outputs a wave
    /// of that name therefore outputs this shape, not one that was loaded earlier. `kind` has at
    /// most four letters, because a 33500B accepts names of at most twelve characters. A name is
    /// never reused for another shape, since no command is known that deletes a wave from an SDG:
    /// if the upload were lost, the old shape would be output with the new amplitude. Frequency,
    /// amplitude and offset are those of `sine`.
    pub fn named(kind: &str, steps: Vec<f64>, sine: Sine) -> Self {
        Self {
            name: format!("{kind}{:08x}", digest(&steps)),
            steps,
            freq: sine.freq,
            amplitude: sine.amplitude,
            offset: sine.offset,
        }
    }
}

/// Returns the FNV-1a hash of the numbers' bits.
fn digest(steps: &[f64]) -> u32 {
    let bytes = steps.iter().flat_map(|step| step.to_bits().to_le_bytes());
    bytes.fold(0x811c_9dc5, |digest, byte| {
        (digest ^ u32::from(byte)).wrapping_mul(0x0100_0193)
    })
}

/// Capabilities of a model.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Capabilities {
    /// Lowest and highest frequency of a sine.
    pub freq_range: (Hertz, Hertz),
    /// Least amplitude (zero to peak) of a sine into an open circuit: below it the instrument
    /// clamps silently.
    pub min_amplitude: Volts,
    /// Greatest |offset| + amplitude into an open circuit.
    pub max_peak: Volts,
    /// Steps in which a frequency can be set.
    pub freq_step: Hertz,
}

/// One model's language.
pub trait Dialect: Model {
    /// Capabilities of the model.
    fn capabilities(&self) -> Capabilities;
    /// Switches the output off (with an open-circuit load setting, so that the volts are true) or
    /// on. Switching on is refused if the volts would not be true.
    fn output(&self, channel: u8, on: bool) -> Vec<Exchange>;
    /// Sets a sine; the output state does not change.
    fn sine(&self, channel: u8, sine: &Sine) -> Vec<Exchange>;
    /// Returns the maximum number of steps of a wave, or `None` if the model has no arbitrary
    /// waves.
    fn wave_steps(&self) -> Option<usize> {
        None
    }
    /// Sets a wave; the output state does not change.
    fn wave(&self, channel: u8, wave: &Wave) -> Vec<Exchange> {
        let _ = channel;
        vec![Exchange::Refuse {
            message: wave.name.clone(),
            reason: "expected a model that plays waves, found one that plays sines".to_owned(),
        }]
    }
    /// Returns the maximum number of periods of a burst, or `None` if the model has no bursts.
    fn most_periods(&self) -> Option<u32> {
        None
    }
    /// Starts `periods` periods of the current signal, followed by the offset without a further
    /// message. Without a number the signal does not end. The output state does not change.
    fn burst(&self, channel: u8, periods: Option<u32>) -> Vec<Exchange> {
        let (message, reason) = (
            format!("burst on channel {channel}"),
            "expected a model that has bursts".to_owned(),
        );
        if periods.is_some() {
            vec![Exchange::Refuse { message, reason }]
        } else {
            Vec::new()
        }
    }
    /// Sets the smallest sine around an offset, the closest approximation of a direct current. The
    /// output state and the other settings do not change. A unit is not refused if its smallest
    /// amplitude exceeds that of its manual, up to 20 mVpp.
    fn direct(&self, channel: u8, offset: Volts) -> Vec<Exchange>;
    /// Sets the smallest sine around an offset and switches off everything else that could move the
    /// output; the output state does not change.
    fn quiet(&self, channel: u8, offset: Volts) -> Vec<Exchange>;
}
