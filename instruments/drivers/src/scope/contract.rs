//! Contract between an oscilloscope and its dialects.

use instruments_domain::units::{Seconds, Volts};

use crate::{exchange::Exchange, instrument::Model};

/// Vertical setting of one channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vertical {
    /// Channel 1…4.
    pub channel: u8,
    /// Scale per division.
    pub per_div: Volts,
    /// Added to the signal before the screen: −3.8 V brings a 3.8 V level to the centre.
    pub offset: Volts,
}

/// Edge trigger.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trigger {
    /// Channel 1…4.
    pub channel: u8,
    /// Level at the probe tip.
    pub level: Volts,
}

/// Capabilities of a model.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Capabilities {
    /// Least and greatest vertical scale.
    pub per_div: (Volts, Volts),
    /// Greatest |offset| up to a vertical scale, by rising scale.
    pub offset_limits: &'static [(Volts, Volts)],
    /// Divisions between the centre and the end of the ADC's range.
    pub half_range_div: f64,
    /// Divisions across the screen.
    pub horizontal_div: f64,
    /// Slowest time per division.
    pub max_time_per_div: Seconds,
    /// The scope can send every n-th point. If it cannot, the driver fetches all points and
    /// decimates them, and requests every page by its ends.
    pub thins_out: bool,
    /// Greatest memory depth with four channels on, points.
    pub most_points: u64,
}

impl Capabilities {
    /// Returns the greatest |offset| at a vertical scale.
    pub fn offset_limit(&self, per_div: Volts) -> Volts {
        self.offset_limits
            .iter()
            .find(|(up_to, _)| per_div.value() <= up_to.value() * (1.0 + 1.0e-9))
            .or(self.offset_limits.last())
            .map_or(Volts(0.0), |(_, limit)| *limit)
    }

    /// Returns the smallest vertical scale, not below `wanted`, at which `offset` is allowed, or
    /// the coarsest if none allows it.
    pub fn scale_for_offset(&self, wanted: Volts, offset: Volts) -> Volts {
        let (least, greatest) = self.per_div;
        let wanted = wanted.value().clamp(least.value(), greatest.value());
        if offset.value().abs() <= self.offset_limit(Volts(wanted)).value() {
            return Volts(wanted);
        }
        self.offset_limits
            .windows(2)
            .find(|pair| pair[1].1.value() >= offset.value().abs() && pair[0].0.value() >= wanted)
            // Just above the end of the finer band the coarser band's limit holds.
            .map_or(greatest, |pair| Volts(pair[0].0.value() * 1.03))
    }

    /// Returns the fastest time per division of the 1–2–5 series whose screen is at least as long
    /// as `span`.
    pub fn time_per_div(&self, span: Seconds) -> Seconds {
        let least = span.value() / self.horizontal_div;
        let decade = 10.0_f64.powf(least.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .find(|step| step * decade >= least * (1.0 - 1.0e-9))
            .unwrap_or(10.0);
        Seconds((step * decade).min(self.max_time_per_div.value()))
    }
}

/// An intent that a dialect turns into text.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Intent {
    /// Once per session: number format, acquisition type, memory depth in points.
    Session {
        /// Points per channel.
        memory_points: u64,
    },
    /// A channel's vertical setting, DC coupled, 20 MHz.
    Vertical(Vertical),
    /// Time per division, trigger at the centre.
    Timebase(Seconds),
    /// Edge trigger, rising.
    Trigger(Trigger),
    /// Arm for repeated triggers.
    Arm,
    /// Record without a trigger: if the screen spans half a second or more, a stop keeps the
    /// screen's contents at that time.
    Roll,
    /// Keep the newest complete frame.
    Stop,
    /// Choose a channel and every `stride`-th point for download.
    Transfer {
        /// Channel 1…4.
        channel: u8,
        /// Points per downloaded point.
        stride: u64,
    },
    /// Choose the first downloaded point of the next page.
    Page {
        /// Its index.
        start: u64,
        /// Points of the whole record.
        total: u64,
    },
}

/// Queries of a dialect.
#[derive(Debug, Clone, Copy)]
pub struct Queries {
    /// State of the trigger.
    pub status: &'static str,
    /// The answer of `status` when stopped.
    pub stopped: &'static str,
    /// Points of the acquisition.
    pub points: &'static str,
    /// Descriptor of the chosen channel (a block).
    pub preamble: &'static str,
    /// Samples of the chosen page (a block).
    pub data: &'static str,
}

/// Scaling of a downloaded channel, from the descriptor of the same acquisition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Preamble {
    /// Points of the whole record.
    pub points: u64,
    /// Volts per code.
    pub volts_per_code: f64,
    /// V = code · `volts_per_code` − `offset_v`.
    pub offset_v: f64,
    /// Vertical scale, V per division.
    pub volts_per_div: f64,
    /// Time between two points of the record, s.
    pub interval_s: f64,
    /// Time of the screen's centre relative to the trigger, s.
    pub delay_s: f64,
    /// Least code of the ADC: a sample at it is clipped.
    pub code_min: i16,
    /// Greatest code of the ADC.
    pub code_max: i16,
    /// From one code of the ADC to the next.
    pub code_step: u16,
}

/// One channel of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Waveform {
    /// Channel 1…4.
    pub channel: u8,
    /// ADC codes.
    pub codes: Vec<i16>,
    /// Scaling of the codes and the record.
    pub preamble: Preamble,
    /// Time between two of these codes, s.
    pub interval_s: f64,
    /// The record came whole, and codes were left out after it had come.
    pub thinned_here: bool,
}

impl Waveform {
    /// Returns the fraction of samples at an end of the ADC's range.
    pub fn clipped_share(&self) -> f64 {
        let clipped = self
            .codes
            .iter()
            .filter(|&&code| code <= self.preamble.code_min || code >= self.preamble.code_max)
            .count();
        clipped as f64 / self.codes.len().max(1) as f64
    }

    /// Returns the least and greatest sample, V.
    pub fn extremes_v(&self) -> (f64, f64) {
        let (least, greatest) = self
            .codes
            .iter()
            .fold((i16::MAX, i16::MIN), |(least, greatest), &code| {
                (least.min(code), greatest.max(code))
            });
        let volts =
            |code: i16| f64::from(code) * self.preamble.volts_per_code - self.preamble.offset_v;
        (volts(least), volts(greatest))
    }
}

/// One model's language.
pub trait Dialect: Model {
    /// Capabilities of the model.
    fn capabilities(&self) -> Capabilities;
    /// Returns the texts for an intent.
    fn script(&self, intent: &Intent) -> Vec<Exchange>;
    /// Returns the texts that choose another channel of the same frame, if everything else of an
    /// [`Intent::Transfer`] was sent just before.
    fn beside(&self, channel: u8, stride: u64) -> Vec<Exchange> {
        self.script(&Intent::Transfer { channel, stride })
    }
    /// Returns the queries.
    fn queries(&self) -> Queries;
    /// Returns whether the descriptor comes as a line of text, not as a block.
    fn preamble_is_text(&self) -> bool {
        false
    }
    /// Parses a descriptor. If it does not contain the number of points, the number is `None` and
    /// the delay is that of the first point.
    ///
    /// # Errors
    /// The expected content of the descriptor.
    fn preamble(&self, block: &[u8]) -> Result<Preamble, String>;
    /// Reads the samples of a page.
    ///
    /// # Errors
    /// Expected content of the page.
    fn codes(&self, block: &[u8]) -> Result<Vec<i16>, String>;
}
