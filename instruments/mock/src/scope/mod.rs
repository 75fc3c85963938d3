//! Siglent SDS800X HD oscilloscope: four channels, 12 bits, captures downloaded as blocks with a
//! 346-byte descriptor.
//!
//! This file contains the front panel's state and the effect of commands on it; `tree` contains the
//! command tree, `acquisition` the timing of frames, and `waveform` the block formats. Of a capture
//! only its time and settings are stored; it is digitised when it is downloaded.
//!
//! # Assumptions
//! * **Offset limits**, at the input: ±1.6 V to 5 mV/div, ±4 V to 10, ±8 V to 20, ±16 V to 100, ±80
//!   V to 200 mV/div, ±160 V to 1 V/div, ±400 V above. They are those of the family's data sheets
//!   as far as known, not verified for this model; they allow the thesis' setting of a cell's tap
//!   at 80 mV/div and forbid it below 5 mV/div. Values beyond are clamped silently.
//! * Time bases snap to the nearest step of 1-2-5. Unknown commands queue −101, as reported of
//!   firmware 4.8; unknown queries get no reply.
//! * A change of the time base, the memory depth, a channel or the trigger while running restarts the
//!   acquisition.
//! * AC coupling, averaging, peak detection and the bandwidth limit are kept and read back but do
//!   not change the signal.

mod acquisition;
mod control;
mod descriptor;
mod kept;
mod tree;
mod waveform;

use super::{
    MockOptions,
    number::nr3,
    plant::SharedPlant,
    quirks::Quirks,
    tree::{Answer, Fallible, HasStatus, Status, text},
    world::World,
};

use super::acquisition::Acquisition;

pub(super) const CHANNELS: usize = 4;
/// Horizontal divisions of the screen.
const DIVISIONS: f64 = 10.0;
/// ADC counts per vertical division: 12 bits, left-justified in 16 (7680 = 480 · 16).
const COUNTS_PER_DIV: f64 = 480.0;
const QUEUE_DEPTH: usize = 20;
/// Scale and offset limits at the input, V/div and V.
const OFFSET_LIMITS: [(f64, f64); 7] = [
    (0.005, 1.6),
    (0.01, 4.0),
    (0.02, 8.0),
    (0.1, 16.0),
    (0.2, 80.0),
    (1.0, 160.0),
    (f64::INFINITY, 400.0),
];
const SCALE_RANGE: (f64, f64) = (500e-6, 10.0);
/// Sample rate with one, two and more channels on, samples/s.
const MAX_RATES: [f64; 3] = [2e9, 1e9, 500e6];
const DEPTHS: [(&str, f64); 4] = [("10k", 1e4), ("100k", 1e5), ("1M", 1e6), ("10M", 1e7)];

/// The oscilloscope.
pub(super) struct Scope {
    world: World,
    status: Status,
    serial_number: String,
    page_points: usize,
    quirks: Quirks,
    panel: Panel,
    acquisition: Acquisition<Panel>,
    transfer: Transfer,
    /// Significant digits of real numbers in answers.
    digits: usize,
    number_format: String,
    /// Kept for `:SYSTem:REMote?` alone.
    remote: bool,
    /// Settings without an effect, by their names.
    kept: std::collections::BTreeMap<&'static str, String>,
}

/// Everything that decides how a frame is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Panel {
    channels: [Channel; CHANNELS],
    /// s/div
    time_scale: f64,
    delay_s: f64,
    /// Position of the trigger without delay, per cent of the screen from the left.
    reference_percent: f64,
    /// The delay follows the time scale, so that the trigger stays at its place on the screen.
    keep_position: bool,
    depth: &'static str,
    depth_points: f64,
    trigger: Trigger,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    on: bool,
    /// V/div behind the probe factor.
    scale: f64,
    /// V, likewise.
    offset: f64,
    coupling: &'static str,
    bandwidth: &'static str,
    probe: f64,
    unit: &'static str,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Trigger {
    source: &'static str,
    slope: &'static str,
    level: f64,
}

impl Channel {
    /// V/div at the input.
    fn input_scale(&self) -> f64 {
        self.scale / self.probe
    }

    /// Offset at the input, V.
    fn input_offset(&self) -> f64 {
        self.offset / self.probe
    }

    fn clamp_offset(&mut self) {
        let scale = self.input_scale();
        let limit = OFFSET_LIMITS
            .iter()
            .find(|(most, _)| scale <= most * (1.0 + 1e-9))
            .map_or(0.0, |(_, limit)| *limit)
            * self.probe;
        self.offset = self.offset.clamp(-limit, limit);
    }
}

impl Panel {
    fn power_on() -> Self {
        let channel = Channel {
            on: false,
            scale: 1.0,
            offset: 0.0,
            coupling: "DC",
            bandwidth: "FULL",
            probe: 1.0,
            unit: "V",
        };
        let mut channels = [channel; CHANNELS];
        channels[0].on = true;
        Self {
            channels,
            time_scale: 1e-6,
            delay_s: 0.0,
            reference_percent: 50.0,
            keep_position: false,
            depth: "10M",
            depth_points: 1e7,
            trigger: Trigger {
                source: "C1",
                slope: "RISing",
                level: 0.0,
            },
        }
    }

    /// Returns the points of a record and their distance, s: as many as the memory holds unless the
    /// converter is too slow for that.
    fn sampling(&self) -> (f64, f64) {
        let on = self.channels.iter().filter(|channel| channel.on).count();
        let rate = MAX_RATES[on.clamp(1, MAX_RATES.len()) - 1];
        let span_s = self.span_s();
        let points = self.depth_points.min((rate * span_s).round()).max(1.0);
        (points, span_s / points)
    }

    fn span_s(&self) -> f64 {
        DIVISIONS * self.time_scale
    }

    /// Returns the time of the first sample after the trigger, s.
    fn start_after_trigger_s(&self) -> f64 {
        self.delay_s - self.reference_percent / 100.0 * self.span_s()
    }

    /// Returns the delay as the descriptor reports it, relative to the centre of the screen, s.
    fn centre_delay_s(&self) -> f64 {
        self.start_after_trigger_s() + self.span_s() / 2.0
    }
}

/// How waveforms are sent. Survives clients, resets of the connection and acquisitions.
#[derive(Debug, Clone, Copy)]
struct Transfer {
    source: usize,
    start: u64,
    points: u64,
    interval: u64,
    words: bool,
    big_endian: bool,
}

impl Default for Transfer {
    fn default() -> Self {
        Self {
            source: 0,
            start: 0,
            points: 0,
            interval: 1,
            words: false,
            big_endian: false,
        }
    }
}

impl Scope {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        Self {
            world: World::new(plant, options.since_s),
            status: Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            serial_number: options.serial_number.clone(),
            page_points: options.quirks.count("page_points").max(1),
            quirks: options.quirks.clone(),
            panel: Panel::power_on(),
            acquisition: Acquisition::power_on(options.quirks.number("stop_delay")),
            transfer: Transfer::default(),
            digits: 3,
            number_format: "CUSTom,3".to_owned(),
            remote: false,
            kept: std::collections::BTreeMap::new(),
        }
    }

    /// Changes what decides about frames; a running acquisition restarts when something did change.
    fn change(&mut self, change: impl FnOnce(&mut Panel)) {
        let old = self.panel;
        change(&mut self.panel);
        if self.panel != old {
            self.acquisition.restart(self.world.now_s);
        }
    }

    fn real(&self, value: f64) -> Fallible<Answer> {
        text(nr3(value, self.digits))
    }

    fn reset(&mut self) {
        self.panel = Panel::power_on();
        self.acquisition.reset(self.world.now_s);
        self.digits = 3;
        "CUSTom,3".clone_into(&mut self.number_format);
    }
}

impl HasStatus for Scope {
    fn status(&mut self) -> &mut Status {
        &mut self.status
    }
}
