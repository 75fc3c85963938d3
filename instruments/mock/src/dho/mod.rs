//! Rigol DHO824 oscilloscope: unsigned 16-bit codes that are not left-justified, a preamble of ten
//! numbers in text, points counted from one, an error queue (guide of April 2025, 3.24.3).
//!
//! The panel is here, the command tree in `tree`, the download in `waveform`; the timing of a frame
//! is shared with the other models. Assumed without a source: an unknown query gets no reply; a
//! memory read while the acquisition runs is empty; the trigger is in the middle of the memory;
//! out-of-range values are clamped.

mod tree;
mod waveform;

use scpi::error::{Error, ErrorCode};

use super::{
    MockOptions,
    acquisition::{Acquisition, Edge, Mode, View},
    number::short_nr3,
    plant::SharedPlant,
    quirks::Quirks,
    tree::{Answer, Argument, Arguments, Fallible, HasStatus, Status, fail, text},
    world::World,
};

const CHANNELS: usize = 4;
/// The names of the channels as keywords, short and long: the number belongs to the name.
const NAMES: [&str; 2 * CHANNELS] = [
    "CHAN1", "CHAN2", "CHAN3", "CHAN4", "CHANNEL1", "CHANNEL2", "CHANNEL3", "CHANNEL4",
];
/// Horizontal divisions of the screen.
const DIVISIONS: f64 = 10.0;
const SCALE_RANGE: (f64, f64) = (500e-6, 10.0);
const TIME_SCALE_RANGE: (f64, f64) = (2e-9, 500.0);
/// Greatest |offset| at the input by scale, V/div and V.
const OFFSET_LIMITS: [(f64, f64); 4] = [
    (65e-3, 1.0),
    (260e-3, 8.0),
    (2.65, 20.0),
    (f64::INFINITY, 100.0),
];
/// Samples per second with one, two and more channels on.
const MAX_RATES: [f64; 3] = [1.25e9, 625e6, 312.5e6];
/// Memory depths; with more than two channels on at most 10 M.
const DEPTHS: [(&str, f64); 6] = [
    ("1k", 1e3),
    ("10k", 1e4),
    ("100k", 1e5),
    ("1M", 1e6),
    ("5M", 5e6),
    ("10M", 1e7),
];
/// Maximum number of points in the screen's format.
const SCREEN_POINTS: f64 = 1000.0;

/// Entries of the error queue; assumed.
const QUEUE_DEPTH: usize = 20;

/// The oscilloscope.
pub(super) struct Dho {
    world: World,
    serial_number: String,
    page_points: usize,
    quirks: Quirks,
    panel: Panel,
    acquisition: Acquisition<Panel>,
    transfer: Transfer,
    status: Status,
}

/// Everything that decides how a frame is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Panel {
    channels: [Channel; CHANNELS],
    /// s/div
    time_scale: f64,
    time_offset_s: f64,
    depth_points: f64,
    source: usize,
    slope: &'static str,
    level: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    on: bool,
    /// V/div behind the probe factor.
    scale: f64,
    /// V, likewise.
    offset: f64,
    coupling: &'static str,
    limited: bool,
    inverted: bool,
    vernier: bool,
    probe: f64,
    /// A label only.
    unit: &'static str,
}

impl Channel {
    fn clamp(&mut self) {
        self.scale = self
            .scale
            .clamp(SCALE_RANGE.0 * self.probe, SCALE_RANGE.1 * self.probe);
        if !self.vernier {
            self.scale = nearest_step(self.scale / self.probe) * self.probe;
        }
        let scale = self.scale / self.probe;
        let limit = OFFSET_LIMITS
            .iter()
            .find(|(most, _)| scale <= most * (1.0 + 1e-9))
            .map_or(0.0, |(_, limit)| *limit)
            * self.probe;
        self.offset = self.offset.clamp(-limit, limit);
    }
}

/// How waveforms are sent; stays from one client to the next.
#[derive(Debug, Clone, Copy)]
struct Transfer {
    source: usize,
    raw: bool,
    words: bool,
    /// First and last point, counted from one.
    start: u64,
    stop: u64,
}

impl Default for Transfer {
    fn default() -> Self {
        Self {
            source: 0,
            raw: false,
            words: false,
            start: 1,
            stop: 1000,
        }
    }
}

impl Panel {
    fn power_on() -> Self {
        let channel = Channel {
            on: false,
            scale: 0.1,
            offset: 0.0,
            coupling: "DC",
            limited: false,
            inverted: false,
            vernier: false,
            probe: 10.0,
            unit: "VOLT",
        };
        let mut channels = [channel; CHANNELS];
        channels[0].on = true;
        Self {
            channels,
            time_scale: 1e-6,
            time_offset_s: 0.0,
            depth_points: 1e4,
            source: 0,
            slope: "POSitive",
            level: 0.0,
        }
    }

    /// Returns the length of the record, s.
    fn span_s(&self) -> f64 {
        let (points, interval_s) = self.sampling();
        points * interval_s
    }

    fn start_after_trigger_s(&self) -> f64 {
        self.time_offset_s - self.span_s() / 2.0
    }

    /// Returns the points of a record and their interval, s. The memory is always filled: if the
    /// converter is too slow for the screen, the record extends beyond the screen.
    fn sampling(&self) -> (f64, f64) {
        let on = self.channels.iter().filter(|channel| channel.on).count();
        let rate = MAX_RATES[on.clamp(1, MAX_RATES.len()) - 1];
        (
            self.depth_points,
            (DIVISIONS * self.time_scale / self.depth_points).max(rate.recip()),
        )
    }

    fn view(&self) -> View {
        let probe = self
            .channels
            .get(self.source)
            .map_or(1.0, |channel| channel.probe);
        let edge = u8::try_from(self.source + 1).ok().map(|channel| Edge {
            channel,
            level_v: self.level / probe,
            rising: self.slope != "NEGative",
            falling: self.slope != "POSitive",
        });
        View {
            start_after_trigger_s: self.start_after_trigger_s(),
            span_s: self.span_s(),
            trigger: edge,
        }
    }
}

/// Returns the nearest step of 1-2-5 on a logarithmic scale.
fn nearest_step(value: f64) -> f64 {
    let decade = 10_f64.powf(value.log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * decade);
    steps
        .into_iter()
        .min_by(|a, b| (a / value).ln().abs().total_cmp(&(b / value).ln().abs()))
        .unwrap_or(value)
}

impl Dho {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        Self {
            world: World::new(plant, options.since_s),
            serial_number: options.serial_number.clone(),
            page_points: options.quirks.count("page_points").max(1),
            quirks: options.quirks.clone(),
            panel: Panel::power_on(),
            acquisition: Acquisition::power_on(options.quirks.number("stop_delay")),
            transfer: Transfer::default(),
            status: Status::new(QUEUE_DEPTH).quirky(&options.quirks),
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

    fn channel(&mut self, index: usize, change: impl FnOnce(&mut Channel)) {
        self.change(|panel| {
            change(&mut panel.channels[index]);
            panel.channels[index].clamp();
        });
    }

    fn set_switch(
        &mut self,
        index: usize,
        field: fn(&mut Channel) -> &mut bool,
        arguments: &mut Arguments,
    ) -> Fallible {
        let on = arguments.switch()?;
        self.channel(index, |channel| *field(channel) = on);
        Ok(())
    }

    fn set_number(
        &mut self,
        index: usize,
        field: fn(&mut Channel) -> &mut f64,
        arguments: &mut Arguments,
    ) -> Fallible {
        let value = bare(arguments)?;
        self.channel(index, |channel| *field(channel) = value);
        Ok(())
    }

    /// Changes the factor of a probe: it rescales the screen, and leaves the input as it is.
    fn set_probe(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let factor = bare(arguments)?.clamp(1e-3, 5e4);
        let amperes = self.quirks.is("unit_after_probe");
        self.channel(index, |channel| {
            if amperes {
                channel.unit = "AMP";
            }
            let ratio = factor / channel.probe;
            channel.probe = factor;
            channel.scale *= ratio;
            channel.offset *= ratio;
        });
        Ok(())
    }

    fn set_unit(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let unit = arguments.word(&["VOLTage", "AMPere", "WATT", "UNKNown"])?;
        self.panel.channels[index].unit = unit.trim_end_matches(char::is_lowercase);
        Ok(())
    }

    fn set_coupling(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let coupling = arguments.word(&["DC", "AC", "GND"])?;
        self.channel(index, |channel| channel.coupling = coupling);
        Ok(())
    }

    fn set_limit(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let limited = arguments.word(&["OFF", "20M"])? == "20M";
        self.channel(index, |channel| channel.limited = limited);
        Ok(())
    }

    fn set_time_scale(&mut self, arguments: &mut Arguments) -> Fallible {
        let seconds = bare(arguments)?.clamp(TIME_SCALE_RANGE.0, TIME_SCALE_RANGE.1);
        self.change(|panel| panel.time_scale = nearest_step(seconds));
        Ok(())
    }

    fn set_time_offset(&mut self, arguments: &mut Arguments) -> Fallible {
        let seconds = bare(arguments)?;
        self.change(|panel| panel.time_offset_s = seconds);
        Ok(())
    }

    fn set_depth(&mut self, arguments: &mut Arguments) -> Fallible {
        let word = match arguments.next() {
            Some(Argument::Number { digits, suffix }) => digits + &suffix,
            Some(Argument::Word(word)) => word,
            _ => return fail(ErrorCode::MissingParameter),
        };
        let known = DEPTHS
            .iter()
            .find(|(name, points)| name.eq_ignore_ascii_case(&word) || word.parse() == Ok(*points));
        let Some((_, points)) = known else {
            return fail(ErrorCode::IllegalParameterValue);
        };
        self.change(|panel| panel.depth_points = *points);
        Ok(())
    }

    fn source(arguments: &mut Arguments) -> Fallible<usize> {
        let word = arguments.word(&NAMES)?;
        NAMES
            .iter()
            .position(|name| *name == word)
            .map(|index| index % CHANNELS)
            .ok_or_else(|| Error::new(ErrorCode::IllegalParameterValue))
    }

    fn set_trigger_source(&mut self, arguments: &mut Arguments) -> Fallible {
        let source = Self::source(arguments)?;
        self.change(|panel| panel.source = source);
        Ok(())
    }

    fn set_slope(&mut self, arguments: &mut Arguments) -> Fallible {
        let slope = arguments.word(&["POSitive", "NEGative", "RFALl"])?;
        self.change(|panel| panel.slope = slope);
        Ok(())
    }

    fn set_level(&mut self, arguments: &mut Arguments) -> Fallible {
        let level = bare(arguments)?;
        self.change(|panel| panel.level = level);
        Ok(())
    }

    fn set_sweep(&mut self, arguments: &mut Arguments) -> Fallible {
        let mode = match arguments.word(&["AUTO", "NORMal", "SINGle"])? {
            "AUTO" => Mode::Auto,
            "NORMal" => Mode::Normal,
            _ => Mode::Single,
        };
        self.acquisition.set_mode(mode, self.world.now_s);
        Ok(())
    }

    fn sweep(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        text(match self.acquisition.mode {
            Mode::Auto => "AUTO",
            Mode::Normal => "NORM",
            Mode::Single => "SING",
        })
    }

    /// A frame that just came shows as a flash of `TD`.
    fn trigger_status(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        let new = self.acquisition.take_new();
        text(match self.acquisition.mode {
            _ if !self.acquisition.running => "STOP",
            Mode::Auto => "AUTO",
            _ if new || (self.acquisition.frame.is_some() && !self.quirks.is("flash")) => "TD",
            _ if self.acquisition.frame.is_some() => "RUN",
            _ => "WAIT",
        })
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        self.panel = Panel::power_on();
        self.acquisition.reset(self.world.now_s);
        Ok(())
    }
}

/// A number without a unit: others are not understood.
fn bare(arguments: &mut Arguments) -> Fallible<f64> {
    let value = arguments.number("")?;
    if value.is_finite() {
        Ok(value)
    } else {
        fail(ErrorCode::DataOutOfRange)
    }
}

/// `1.5E-2`, but a zero in full.
fn real(value: f64) -> Fallible<Answer> {
    text(if value == 0.0 {
        "0.000000".to_owned()
    } else {
        short_nr3(value)
    })
}
impl HasStatus for Dho {
    fn status(&mut self) -> &mut Status {
        &mut self.status
    }
}
