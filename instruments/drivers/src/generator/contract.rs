//! Contract between a generator and its dialects.

use instruments_domain::units::{Hertz, Volts};

use crate::{exchange::Exchange, instrument::Model};

/// The least sine of a model may be this much, V peak to peak: 20 mA of a supply of ±20 A at ±10 V,
/// a fifth of what a meter may show where nothing flows.
pub(super) const QUIET_VPP: f64 = 0.02;

/// A burst may begin so far from phase zero, degrees: behind it stays the level at which it began,
/// here a thousandth of the amplitude.
pub(super) const PHASE_TOLERANCE_DEG: f64 = 0.05;

/// A burst may begin so much later than its trigger, s: the least that models can is below a
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
    /// One period in equal steps, −1 … 1 of the amplitude; a power of two, at most what the model
    /// holds.
    pub steps: Vec<f64>,
    /// Periods per second.
    pub freq: Hertz,
    /// Amplitude, zero to peak.
    pub amplitude: Volts,
    /// Offset.
    pub offset: Volts,
}

impl Wave {
    /// A wave whose name ends in a digest of its shape: an instrument that plays a wave of that
    /// name plays this shape, not one that was loaded before it. `kind` has at most four letters,
    /// for names of twelve characters are all that a 33500B takes. Names are not used again for
    /// another shape, although no command is known by which an SDG forgets one: were the upload
    /// lost, the old shape would play under the new amplitude. Frequency, amplitude and offset are
    /// those of `sine`.
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

/// FNV-1a of the numbers' bits.
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
    /// Output off (with an open-circuit load setting, so that the volts are true), or on; on is
    /// refused where the volts would not be true.
    fn output(&self, channel: u8, on: bool) -> Vec<Exchange>;
    /// A sine; the output stays as it is.
    fn sine(&self, channel: u8, sine: &Sine) -> Vec<Exchange>;
    /// Most steps of a wave; none where the model plays no waves.
    fn wave_steps(&self) -> Option<usize> {
        None
    }
    /// A wave; the output stays as it is.
    fn wave(&self, channel: u8, wave: &Wave) -> Vec<Exchange> {
        let _ = channel;
        vec![Exchange::Refuse {
            message: wave.name.clone(),
            reason: "expected a model that plays waves, found one that plays sines".to_owned(),
        }]
    }
    /// Most periods of a burst; none where the model has no bursts.
    fn most_periods(&self) -> Option<u32> {
        None
    }
    /// From now on so many periods of what is set, then the offset without a further message;
    /// without a number no end. The output stays as it is.
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
    /// The least sine around an offset, as near to a direct current as it comes; the output and the
    /// rest stay as they are. A unit whose least amplitude is greater than its manual says is not
    /// refused for that, up to 20 mVpp.
    fn direct(&self, channel: u8, offset: Volts) -> Vec<Exchange>;
    /// The least sine around an offset, everything else that could move the output off; the output
    /// stays as it is.
    fn quiet(&self, channel: u8, offset: Volts) -> Vec<Exchange>;
}
