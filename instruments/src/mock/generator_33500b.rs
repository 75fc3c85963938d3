//! Keysight (Agilent) 33500B function generator: a command tree for each channel, numbers answered with sixteen digits, an error queue that tells what
//! was adjusted.
//!
//! Voltages are kept as the open-circuit voltage behind 50 Ω; `OUTPut:LOAD` only changes how they are reported and understood. Only channel 1 is wired to
//! the bench, and only a sine, a constant voltage and loaded waves are simulated. Burst, sweep and modulation are off and stay off. Assumed: an amplitude or
//! offset that leaves the range is adjusted to it with −221; the phase starts anew when the frequency, the sample rate, the phase, the function or the output
//! changes; a wave is held from point to point whatever its filter, and ±32767 of the converter is ± half the amplitude. Waves are taken as text, not as blocks.

mod waves;

use std::{collections::BTreeMap, sync::Arc};

use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{
    Device, MockOptions,
    number::nr3,
    plant::{Action, GeneratorState, SharedPlant},
    tree::{Answer, Argument, Arguments, Fallible, HasStatus, Span, Status, both, common, exchange, fail, get, set, text, to_number},
    world::World,
};
use crate::scpi::decode::Terminator;

const QUEUE_DEPTH: usize = 20;
/// Source resistance, Ω.
const SOURCE_OHM: f64 = 50.0;
/// Highest open-circuit voltage, V.
const MAX_VOLTS: f64 = 10.0;
/// Least amplitude into an open circuit, V peak to peak.
const MIN_VPP: f64 = 2e-3;
const FREQ_RANGE_HZ: (f64, f64) = (1e-6, 30e6);
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
}

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
        }
    }
}

impl Channel {
    /// What part of the open-circuit voltage stands at the assumed load.
    fn divider(&self) -> f64 {
        if self.load_ohm.is_finite() { self.load_ohm / (self.load_ohm + SOURCE_OHM) } else { 1.0 }
    }

    /// Brings amplitude and offset into the range, the one that was not asked for last; tells whether something had to give.
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
        let key =
            |channel: &Self| (channel.constant, channel.arbitrary, channel.rate_hz, channel.freq_hz, channel.phase_deg, channel.output_on);
        key(self) != key(old)
    }

    /// `points`: those of the chosen wave.
    fn state(&self, points: usize) -> GeneratorState {
        if !self.output_on {
            return GeneratorState::default();
        }
        let offset_v = if self.inverted { -self.offset_v } else { self.offset_v };
        if self.constant {
            return GeneratorState { offset_v, ..GeneratorState::default() };
        }
        let turned = if self.inverted { std::f64::consts::PI } else { 0.0 };
        GeneratorState {
            offset_v,
            amplitude_v: self.amplitude_vpp / 2.0,
            freq_hz: if self.arbitrary { self.rate_hz / points.max(1) as f64 } else { self.freq_hz },
            phase_rad: self.phase_deg.to_radians() + turned,
            since_s: self.since_s,
        }
    }
}

/// The generator.
pub(super) struct Keysight {
    world: World,
    status: Status,
    serial_number: String,
    channels: [Channel; 2],
    /// Loaded waves by name, of each channel.
    waves: [BTreeMap<String, Arc<[f64]>>; 2],
    /// The wave that each channel has chosen.
    chosen: [Option<String>; 2],
}

impl Keysight {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let (status, serial_number) = (Status::new(QUEUE_DEPTH), options.serial_number.clone());
        let generator = Self {
            world: World::new(plant, options.since_s),
            status,
            serial_number,
            channels: [Channel::default(); 2],
            waves: Default::default(),
            chosen: [None, None],
        };
        generator.act();
        generator
    }

    fn act(&self) {
        let points = self.wave(0).map_or(0, |wave| wave.len());
        self.world.act(Action::Generator(self.channels[0].state(points)));
    }

    /// The wave that a channel has chosen.
    fn wave(&self, index: usize) -> Option<&Arc<[f64]>> {
        self.chosen[index].as_ref().and_then(|name| self.waves[index].get(name))
    }

    /// Tells the world the shape of channel 1.
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
        self.change(index, |channel| (channel.constant, channel.arbitrary) = (function == "DC", function == "ARB"));
        Ok(())
    }

    fn set_frequency(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let (min, max) = FREQ_RANGE_HZ;
        let freq_hz = arguments.number_in("HZ", Span { min, max, default: 1000.0 })?;
        if !(min..=max).contains(&freq_hz) {
            return fail(ErrorCode::DataOutOfRange);
        }
        self.change(index, |channel| channel.freq_hz = (freq_hz * 1e6).round() / 1e6);
        Ok(())
    }

    /// Takes a voltage at the load and settles the other one.
    fn set_volts(&mut self, index: usize, (volts, unit): (f64, fn(&mut Channel) -> &mut f64), amplitude: bool) -> Fallible {
        if !volts.is_finite() {
            return fail(ErrorCode::DataOutOfRange);
        }
        let mut adjusted = false;
        self.change(index, |channel| {
            let open = volts / channel.divider();
            *unit(channel) = (open * 1e4).round() / 1e4;
            adjusted = channel.settle(amplitude);
        });
        if adjusted { fail(ErrorCode::SettingsConflict) } else { Ok(()) }
    }

    fn set_amplitude(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let volts = arguments.number("VPP")?;
        self.set_volts(index, (volts, |channel| &mut channel.amplitude_vpp), true)
    }

    fn set_offset(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let volts = arguments.number("V")?;
        self.set_volts(index, (volts, |channel| &mut channel.offset_v), false)
    }

    fn set_phase(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let degrees = arguments.number("DEG")?;
        if !(-360.0..=360.0).contains(&degrees) {
            return fail(ErrorCode::DataOutOfRange);
        }
        self.change(index, |channel| channel.phase_deg = degrees);
        Ok(())
    }

    /// `APPLy:SINusoid [freq[,amplitude[,offset]]]`, which also switches the output on.
    fn apply(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.change(index, |channel| (channel.constant, channel.arbitrary) = (false, false));
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
            Some(Argument::Word(word)) if ["INF", "INFINITY"].iter().any(|name| word.eq_ignore_ascii_case(name)) => f64::INFINITY,
            Some(other) => to_number(&other, "OHM")?,
            None => return fail(ErrorCode::MissingParameter),
        };
        if !(ohms == f64::INFINITY || (1.0..=10e3).contains(&ohms)) {
            return fail(ErrorCode::DataOutOfRange);
        }
        self.change(index, |channel| channel.load_ohm = ohms);
        Ok(())
    }

    fn set_polarity(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let inverted = arguments.word(&["NORMal", "INVerted"])? == "INVerted";
        self.change(index, |channel| channel.inverted = inverted);
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
        self.channels = [Channel { since_s: self.world.now_s, ..Channel::default() }; 2];
        self.waves = Default::default();
        self.chosen = [None, None];
        self.reshape();
        self.act();
        Ok(())
    }
}

/// A sign, sixteen digits and an exponent: `+1.000000000000000E+03`.
fn number(value: f64) -> Fallible<Answer> {
    let digits = nr3(value, 16);
    text(if digits.starts_with('-') { digits } else { format!("+{digits}") })
}

/// Only `VPP` is simulated.
fn only_vpp(_: &mut Keysight, arguments: &mut Arguments) -> Fallible {
    arguments.word(&["VPP"]).map(|_| ())
}

/// Burst, sweep and modulation can be switched off.
fn only_off(_: &mut Keysight, arguments: &mut Arguments) -> Fallible {
    if arguments.switch()? { fail(ErrorCode::SettingsConflict) } else { Ok(()) }
}

macro_rules! modifier {
    ($name:literal) => {
        Branch! {$name; Leaf! {b"STATe" => &both(only_off, |_, _| text("0"))}}
    };
}

macro_rules! source {
    ($name:literal, $index:literal) => {
        Branch! {$name;
            Branch! {b"FUNCtion" => &both(
                |device: &mut Keysight, arguments| device.set_function($index, arguments),
                |device, _| text(match &device.channels[$index] {
                    Channel { constant: true, .. } => "DC",
                    Channel { arbitrary: true, .. } => "ARB",
                    _ => "SIN",
                }),
            );
                Branch! {b"ARBitrary" => &both(
                    |device: &mut Keysight, arguments| device.choose_wave($index, arguments),
                    |device, _| text(format!("\"{}\"", device.chosen[$index].as_deref().unwrap_or("EXP_RISE"))),
                );
                    Leaf! {b"SRATe" => &both(
                        |device: &mut Keysight, arguments| device.set_rate($index, arguments),
                        |device, _| number(device.channels[$index].rate_hz),
                    )},
                    Leaf! {b"FILTer" => &both(
                        |device: &mut Keysight, arguments| device.set_filter($index, arguments),
                        |device, _| text(device.channels[$index].filter.trim_end_matches(char::is_lowercase)),
                    )}
                }
            },
            Branch! {b"DATA"; Branch! {b"VOLatile";
                Leaf! {b"CLEar" => &set(|device: &mut Keysight, arguments| device.clear_waves($index, arguments))}
            }},
            Leaf! {b"FREQuency" => &both(
                |device: &mut Keysight, arguments| device.set_frequency($index, arguments),
                |device, _| number(device.channels[$index].freq_hz),
            )},
            Branch! {b"VOLTage" => &both(
                |device: &mut Keysight, arguments| device.set_amplitude($index, arguments),
                |device, _| device.at_load($index, |channel| channel.amplitude_vpp),
            );
                Leaf! {b"UNIT" => &both(only_vpp, |_, _| text("VPP"))},
                Leaf! {b"OFFSet" => &both(
                    |device: &mut Keysight, arguments| device.set_offset($index, arguments),
                    |device, _| device.at_load($index, |channel| channel.offset_v),
                )},
                Leaf! {b"HIGH" => &get(|device: &mut Keysight, _| device.at_load($index, |channel| channel.offset_v + channel.amplitude_vpp / 2.0))},
                Leaf! {b"LOW" => &get(|device: &mut Keysight, _| device.at_load($index, |channel| channel.offset_v - channel.amplitude_vpp / 2.0))}
            },
            Branch! {b"PHASe" => &both(
                |device: &mut Keysight, arguments| device.set_phase($index, arguments),
                |device, _| number(device.channels[$index].phase_deg),
            ); Leaf! {b"SYNChronize" => &set(Keysight::align_phases)}},
            Branch! {b"APPLy"; Leaf! {b"SINusoid" => &set(|device: &mut Keysight, arguments| device.apply($index, arguments))}},
            modifier! {b"BURSt"},
            modifier! {b"SWEep"},
            modifier! {b"AM"},
            modifier! {b"FM"}
        }
    };
}

macro_rules! output {
    ($name:literal, $index:literal) => {
        Branch! {$name => &both(
            |device: &mut Keysight, arguments| device.set_output($index, arguments),
            |device, _| text(if device.channels[$index].output_on { "1" } else { "0" }),
        );
            Leaf! {b"LOAD" => &both(
                |device: &mut Keysight, arguments| device.set_load($index, arguments),
                |device, _| match device.channels[$index].load_ohm {
                    // Infinity as the standard writes it.
                    f64::INFINITY => text("+9.900000000000000E+37"),
                    ohms => number(ohms),
                },
            )},
            Leaf! {b"POLarity" => &both(
                |device: &mut Keysight, arguments| device.set_polarity($index, arguments),
                |device, _| text(if device.channels[$index].inverted { "INV" } else { "NORM" }),
            )}
        }
    };
}

const TREE: Node<'static, Keysight> = Root! {
    Leaf! {b"*IDN" => &get(|device: &mut Keysight, _| text(format!("Agilent Technologies,33522B,{},5.00-1.19-2.00-58-00", device.serial_number)))},
    Leaf! {b"*RST" => &set(Keysight::reset)},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    source! {b"SOURce", 0},
    source! {b"SOURce1", 0},
    source! {b"SOURce2", 1},
    output! {b"OUTPut", 0},
    output! {b"OUTPut1", 0},
    output! {b"OUTPut2", 1},
    Branch! {b"SYSTem"; Branch! {b"ERRor" => &get(common::signed_error_query); Leaf! {b"NEXT" => &get(common::signed_error_query)}}}
};

impl HasStatus for Keysight {
    fn status(&mut self) -> &mut Status {
        &mut self.status
    }
}

impl scpi::Device for Keysight {
    fn handle_error(&mut self, error: Error) {
        self.status.push(Error::custom(error.get_code(), error.get_message()));
    }
}

impl Device for Keysight {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        if self.load_wave(message) {
            return Vec::new();
        }
        exchange(&TREE, self, message)
    }
}
