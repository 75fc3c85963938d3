//! Keysight (Agilent) 33500B function generator: a command tree for each channel, numeric replies
//! with sixteen digits, an error queue that reports adjusted settings.
//!
//! Voltages are kept as the open-circuit voltage behind 50 Ω; `OUTPut:LOAD` only changes how they
//! are reported and interpreted. Only channel 1 is wired to the bench, and only a sine, a constant
//! voltage and loaded waves are simulated, continuously or in triggered bursts of a number of
//! periods. Sweep and modulation are off and stay off. Assumed: an amplitude or offset that leaves
//! the range is adjusted to it with −221; the phase restarts when the frequency, the sample rate,
//! the phase, the function or the output changes; a wave is held from point to point regardless of
//! its filter, and ±32767 of the converter is ± half the amplitude. Waves are accepted as text, not
//! as blocks.

mod tree;
mod waves;

use std::{collections::BTreeMap, ops::RangeInclusive, sync::Arc};

use scpi::error::ErrorCode;

use super::{
    MockOptions,
    number::nr3,
    plant::{Action, GeneratorState, SharedPlant},
    tree::{Answer, Argument, Arguments, Fallible, HasStatus, Span, Status, fail, text, to_number},
    world::World,
};

const QUEUE_DEPTH: usize = 20;
/// Source resistance, Ω.
const SOURCE_OHM: f64 = 50.0;
/// Highest open-circuit voltage, V.
const MAX_VOLTS: f64 = 10.0;
/// Least amplitude into an open circuit, V peak to peak.
const MIN_VPP: f64 = 2e-3;
const FREQ_RANGE_HZ: RangeInclusive<f64> = 1e-6..=30e6;
const FUNCTIONS: [&str; 3] = ["SINusoid", "DC", "ARB"];

#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    constant: bool,
    /// Plays the chosen wave.
    arbitrary: bool,
    /// Samples of a wave per second.
    rate_hz: f64,
    filter: &'static str,
    freq_hz: f64,
    /// Open-circuit amplitude, V peak to peak.
    amplitude_vpp: f64,
    /// Open-circuit offset, V.
    offset_v: f64,
    phase_deg: f64,
    output_on: bool,
    /// Infinite: high impedance.
    load_ohm: f64,
    inverted: bool,
    since_s: f64,
    burst: Burst,
}

/// Bursts of a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Burst {
    on: bool,
    /// Source of the trigger of a burst.
    source: &'static str,
    periods: u32,
    /// Where in the period it begins, and what stays behind it, degrees.
    start_deg: f64,
    /// From its trigger to its beginning, s.
    delay_s: f64,
    /// It was triggered since bursts were switched on.
    fired: bool,
}

/// Sources that can trigger a burst.
const SOURCES: [&str; 4] = ["IMMediate", "EXTernal", "TIMer", "BUS"];
/// Fewest and most periods of a burst.
const PERIODS: RangeInclusive<f64> = 1.0..=1e8;
/// Least and greatest phase at which a burst begins, degrees.
const PHASES_DEG: RangeInclusive<f64> = -360.0..=360.0;
/// Least and greatest delay of a burst, s.
const DELAYS_S: RangeInclusive<f64> = 0.0..=1e3;

impl Default for Channel {
    fn default() -> Self {
        Self {
            constant: false,
            arbitrary: false,
            rate_hz: 40e3,
            filter: "NORMal",
            freq_hz: 1000.0,
            // 100 mV peak to peak into 50 Ω.
            amplitude_vpp: 0.2,
            offset_v: 0.0,
            phase_deg: 0.0,
            output_on: false,
            load_ohm: SOURCE_OHM,
            inverted: false,
            since_s: 0.0,
            burst: Burst {
                on: false,
                source: "IMMediate",
                periods: 1,
                start_deg: 0.0,
                delay_s: 0.0,
                fired: false,
            },
        }
    }
}

impl Channel {
    /// Returns the share of the open-circuit voltage at the assumed load.
    fn divider(&self) -> f64 {
        if self.load_ohm.is_finite() {
            self.load_ohm / (self.load_ohm + SOURCE_OHM)
        } else {
            1.0
        }
    }

    /// Brings amplitude and offset into the range by adjusting the one that was not set last.
    /// Returns whether a value was adjusted.
    fn settle(&mut self, amplitude_counts: bool) -> bool {
        let old = (self.amplitude_vpp, self.offset_v);
        self.amplitude_vpp = self.amplitude_vpp.clamp(MIN_VPP, 2.0 * MAX_VOLTS);
        self.offset_v = self.offset_v.clamp(-MAX_VOLTS, MAX_VOLTS);
        if amplitude_counts {
            let room = MAX_VOLTS - self.amplitude_vpp / 2.0;
            self.offset_v = self.offset_v.clamp(-room, room);
        } else {
            let room = 2.0 * (MAX_VOLTS - self.offset_v.abs());
            self.amplitude_vpp = self.amplitude_vpp.min(room).max(MIN_VPP);
        }
        old != (self.amplitude_vpp, self.offset_v)
    }

    fn restarts_from(&self, old: &Self) -> bool {
        let key = |channel: &Self| {
            let signal = (
                channel.constant,
                channel.arbitrary,
                channel.rate_hz,
                channel.freq_hz,
                channel.phase_deg,
            );
            (signal, channel.output_on, channel.burst.on)
        };
        key(self) != key(old)
    }

    /// Periods per second; `points`: those of the chosen wave.
    fn played_hz(&self, points: usize) -> f64 {
        if self.arbitrary {
            self.rate_hz / points.max(1) as f64
        } else {
            self.freq_hz
        }
    }

    /// `points`: those of the chosen wave.
    fn state(&self, points: usize) -> GeneratorState {
        if !self.output_on {
            return GeneratorState::default();
        }
        let offset_v = if self.inverted {
            -self.offset_v
        } else {
            self.offset_v
        };
        if self.constant {
            return GeneratorState {
                offset_v,
                ..GeneratorState::default()
            };
        }
        let turned = if self.inverted {
            std::f64::consts::PI
        } else {
            0.0
        };
        GeneratorState {
            offset_v,
            amplitude_v: self.amplitude_vpp / 2.0,
            freq_hz: self.played_hz(points),
            periods: self.burst.on.then_some(if self.burst.fired {
                self.burst.periods
            } else {
                0
            }),
            phase_rad: if self.burst.on {
                self.burst.start_deg
            } else {
                self.phase_deg
            }
            .to_radians()
                + turned,
            since_s: self.since_s,
        }
    }
}

/// The generator.
pub(super) struct Keysight {
    world: World,
    status: Status,
    serial_number: String,
    bursts: bool,
    channels: [Channel; 2],
    /// Loaded waves by name, of each channel.
    waves: [BTreeMap<String, Arc<[f64]>>; 2],
    /// The wave that each channel has chosen.
    chosen: [Option<String>; 2],
}

impl Keysight {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let (status, serial_number) = (
            Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            options.serial_number.clone(),
        );
        let generator = Self {
            world: World::new(plant, options.since_s),
            status,
            serial_number,
            bursts: options.quirks.is("bursts"),
            channels: [Channel::default(); 2],
            waves: Default::default(),
            chosen: [None, None],
        };
        generator.act();
        generator
    }

    fn act(&self) {
        let points = self.wave(0).map_or(0, |wave| wave.len());
        self.world
            .act(Action::Generator(self.channels[0].state(points)));
    }

    /// Returns the wave that a channel has chosen.
    fn wave(&self, index: usize) -> Option<&Arc<[f64]>> {
        self.chosen[index]
            .as_ref()
            .and_then(|name| self.waves[index].get(name))
    }

    /// Sends the shape of channel 1 to the world.
    fn reshape(&self) {
        let wave = self.wave(0).filter(|_| self.channels[0].arbitrary);
        self.world.plant().shape(self.world.now_s, wave.cloned());
    }

    fn change(&mut self, index: usize, change: impl FnOnce(&mut Channel)) {
        let old = self.channels[index];
        change(&mut self.channels[index]);
        if self.channels[index].restarts_from(&old) {
            self.channels[index].since_s = self.world.now_s;
        }
        if index == 0 && self.channels[0] != old {
            if self.channels[0].arbitrary || old.arbitrary {
                self.reshape();
            }
            self.act();
        }
    }

    fn set_function(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let function = arguments.word(&FUNCTIONS)?;
        if function == "ARB" && self.wave(index).is_none() {
            return fail(ErrorCode::SettingsConflict);
        }
        self.change(index, |channel| {
            (channel.constant, channel.arbitrary) = (function == "DC", function == "ARB");
        });
        Ok(())
    }

    fn set_frequency(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let (min, max) = FREQ_RANGE_HZ.into_inner();
        let freq_hz = arguments.number_in(
            "HZ",
            Span {
                min,
                max,
                default: 1000.0,
            },
        )?;
        let freq_hz = self.status.bounded(freq_hz, FREQ_RANGE_HZ)?;
        self.change(index, |channel| {
            channel.freq_hz = (freq_hz * 1e6).round() / 1e6;
        });
        Ok(())
    }

    /// Takes a voltage at the load and settles the other one.
    fn set_volts(
        &mut self,
        index: usize,
        volts: f64,
        unit: fn(&mut Channel) -> &mut f64,
        amplitude: bool,
    ) -> Fallible {
        if !volts.is_finite() {
            return fail(ErrorCode::DataOutOfRange);
        }
        let mut adjusted = false;
        self.change(index, |channel| {
            let open = volts / channel.divider();
            *unit(channel) = (open * 1e4).round() / 1e4;
            adjusted = channel.settle(amplitude);
        });
        if adjusted && !self.status.clamps() {
            fail(ErrorCode::SettingsConflict)
        } else {
            Ok(())
        }
    }

    fn set_amplitude(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let volts = arguments.number("VPP")?;
        self.set_volts(index, volts, |channel| &mut channel.amplitude_vpp, true)
    }

    fn set_offset(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let volts = arguments.number("V")?;
        self.set_volts(index, volts, |channel| &mut channel.offset_v, false)
    }

    fn set_phase(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let degrees = arguments.number("DEG")?;
        let degrees = self.status.bounded(degrees, -360.0..=360.0)?;
        self.change(index, |channel| channel.phase_deg = degrees);
        Ok(())
    }

    /// `APPLy:SINusoid [freq[,amplitude[,offset]]]`, which also switches the output on.
    fn apply(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.change(index, |channel| {
            (channel.constant, channel.arbitrary) = (false, false);
        });
        if !arguments.is_empty() {
            self.set_frequency(index, arguments)?;
        }
        if !arguments.is_empty() {
            self.set_amplitude(index, arguments)?;
        }
        if !arguments.is_empty() {
            self.set_offset(index, arguments)?;
        }
        self.change(index, |channel| channel.output_on = true);
        Ok(())
    }

    fn set_output(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let on = arguments.switch()?;
        self.change(index, |channel| channel.output_on = on);
        Ok(())
    }

    fn set_load(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let ohms = match arguments.next() {
            Some(Argument::Word(word))
                if ["INF", "INFINITY"]
                    .iter()
                    .any(|name| word.eq_ignore_ascii_case(name)) =>
            {
                f64::INFINITY
            }
            Some(other) => to_number(&other, "OHM")?,
            None => return fail(ErrorCode::MissingParameter),
        };
        let ohms = if ohms == f64::INFINITY {
            ohms
        } else {
            self.status.bounded(ohms, 1.0..=10e3)?
        };
        self.change(index, |channel| channel.load_ohm = ohms);
        Ok(())
    }

    fn set_polarity(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let inverted = arguments.word(&["NORMal", "INVerted"])? == "INVerted";
        self.change(index, |channel| channel.inverted = inverted);
        Ok(())
    }

    fn set_burst_state(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let on = arguments.switch()?;
        if on && !self.bursts {
            return fail(ErrorCode::SettingsConflict);
        }
        self.change(index, |channel| {
            channel.burst = Burst {
                on,
                fired: channel.burst.fired && on,
                ..channel.burst
            }
        });
        Ok(())
    }

    /// Only counted bursts are simulated.
    fn set_burst_mode(&mut self, _: usize, arguments: &mut Arguments) -> Fallible {
        if arguments.word(&["TRIGgered", "GATed"])? == "GATed" {
            fail(ErrorCode::SettingsConflict)
        } else {
            Ok(())
        }
    }

    fn set_burst_periods(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let (min, max) = PERIODS.into_inner();
        let periods = arguments.number_in(
            "",
            Span {
                min,
                max,
                default: min,
            },
        )?;
        let periods = self.status.bounded(periods, PERIODS)?;
        self.change(index, |channel| channel.burst.periods = periods as u32);
        Ok(())
    }

    fn set_burst_phase(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let (min, max) = PHASES_DEG.into_inner();
        let degrees = arguments.number_in(
            "DEG",
            Span {
                min,
                max,
                default: 0.0,
            },
        )?;
        let start_deg = self.status.bounded(degrees, PHASES_DEG)?;
        self.change(index, |channel| channel.burst.start_deg = start_deg);
        Ok(())
    }

    fn set_trigger_delay(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let (min, max) = DELAYS_S.into_inner();
        let seconds = arguments.number_in(
            "S",
            Span {
                min,
                max,
                default: min,
            },
        )?;
        let delay_s = self.status.bounded(seconds, DELAYS_S)?;
        self.change(index, |channel| channel.burst.delay_s = delay_s);
        Ok(())
    }

    fn set_trigger_source(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let source = arguments.word(&SOURCES)?;
        self.change(index, |channel| channel.burst.source = source);
        Ok(())
    }

    /// A trigger begins a burst unless one is in work.
    fn trigger(&mut self, index: usize, _: &mut Arguments) -> Fallible {
        let (channel, now_s) = (self.channels[index], self.world.now_s);
        let played_hz = channel.played_hz(self.wave(index).map_or(0, |wave| wave.len()));
        let plays = channel.burst.fired
            && now_s - channel.since_s < f64::from(channel.burst.periods) / played_hz;
        if !channel.burst.on || plays {
            return fail(ErrorCode::TriggerIgnored);
        }
        self.change(index, |channel| {
            (channel.burst.fired, channel.since_s) = (true, now_s + channel.burst.delay_s);
        });
        Ok(())
    }

    fn align_phases(&mut self, _: &mut Arguments) -> Fallible {
        for channel in &mut self.channels {
            channel.since_s = self.world.now_s;
        }
        self.act();
        Ok(())
    }

    fn at_load(&self, index: usize, open: fn(&Channel) -> f64) -> Fallible<Answer> {
        let channel = &self.channels[index];
        number(open(channel) * channel.divider())
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        self.channels = [Channel {
            since_s: self.world.now_s,
            ..Channel::default()
        }; 2];
        self.waves = Default::default();
        self.chosen = [None, None];
        self.reshape();
        self.act();
        Ok(())
    }
}

impl HasStatus for Keysight {
    fn status(&mut self) -> &mut Status {
        &mut self.status
    }
}

/// Returns a sign, sixteen digits and an exponent: `+1.000000000000000E+03`.
fn number(value: f64) -> Fallible<Answer> {
    let digits = nr3(value, 16);
    text(if digits.starts_with('-') {
        digits
    } else {
        format!("+{digits}")
    })
}
