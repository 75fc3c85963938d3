//! Siglent SDG1000X function generator: one keyword list a channel, `C1:BSWV WVTP,SINE,FRQ,1000,…`.
//!
//! Out-of-range values are clamped silently, unknown headers met with silence, and there is no query of a single field: the `?` stands bare.
//! Voltages are kept as the open-circuit voltage behind 50 Ω; `LOAD` only changes how they are reported and understood.
//!
//! Only channel 1 is wired to the bench, and only a sine, a constant voltage and loaded waves are simulated: other wave types are ignored, and so is `ARB`
//! before a loaded wave was chosen. `WVDT` takes raw little-endian words without a block's header up to the end of the message. Assumed, for want of
//! a source: voltages are set in steps of 0.1 mV and frequencies in steps of 1 µHz; the phase starts anew when the frequency, the phase, the wave
//! type or the output changes, and runs on when an amplitude or an offset changes.

use std::{collections::BTreeMap, f64::consts::SQRT_2, sync::Arc};

use scpi::{Branch, Leaf, Root, error::Error, parser::mnemonic_compare, tree::Node};

use super::{
    Device, MockOptions,
    number::general,
    plant::{Action, GeneratorState, SharedPlant},
    tree::{Answer, Argument, Arguments, Fallible, both, common, exchange, get, set, text, to_number},
    world::World,
};
use crate::scpi::decode::Terminator;

/// Source resistance, Ω.
const SOURCE_OHM: f64 = 50.0;
/// Highest open-circuit voltage, V; the greatest amplitude is twice that, peak to peak.
const MAX_VOLTS: f64 = 10.0;
/// Least amplitude into an open circuit, V peak to peak.
const MIN_VPP: f64 = 2e-3;
const FREQ_RANGE_HZ: (f64, f64) = (1e-6, 30e6);
const LOAD_RANGE_OHM: (f64, f64) = (50.0, 100e3);
/// The parser takes words of at most 12 characters; this key has 14.
const LONG_KEY: &[u8] = b"MAX_OUTPUT_AMP";
const SHORT_KEY: &[u8] = b"MAXOUTPUTAMP";

/// The generator.
pub(super) struct Sdg {
    world: World,
    serial_number: String,
    channels: [Channel; 2],
    /// Loaded waves by name.
    waves: BTreeMap<String, Arc<[f64]>>,
    /// The wave that each channel has chosen.
    chosen: [Option<String>; 2],
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Channel {
    constant: bool,
    /// Plays the chosen wave.
    arbitrary: bool,
    /// A loaded wave is chosen.
    has_wave: bool,
    freq_hz: f64,
    /// Open-circuit amplitude, V peak to peak.
    amplitude_vpp: f64,
    /// Open-circuit offset, V.
    offset_v: f64,
    phase_deg: f64,
    /// Open-circuit ceiling of the amplitude, V peak to peak.
    max_vpp: f64,
    output_on: bool,
    /// `None`: high impedance.
    load_ohm: Option<f64>,
    inverted: bool,
    since_s: f64,
}

impl Default for Channel {
    fn default() -> Self {
        Self {
            constant: false,
            arbitrary: false,
            has_wave: false,
            freq_hz: 1000.0,
            amplitude_vpp: 4.0,
            offset_v: 0.0,
            phase_deg: 0.0,
            max_vpp: 2.0 * MAX_VOLTS,
            output_on: false,
            load_ohm: None,
            inverted: false,
            since_s: 0.0,
        }
    }
}

impl Channel {
    /// What part of the open-circuit voltage stands at the assumed load.
    fn divider(&self) -> f64 {
        self.load_ohm.map_or(1.0, |load| load / (load + SOURCE_OHM))
    }

    /// Takes one key and value; what it does not understand it ignores.
    fn set(&mut self, key: &str, value: &Argument) {
        let is = |name: &str| key.eq_ignore_ascii_case(name);
        let number = |unit: &str| to_number(value, unit).ok().filter(|number| number.is_finite());
        let divider = self.divider();
        if is("WVTP") {
            self.set_wave(value);
        } else if is("FRQ") {
            self.set_frequency(number("HZ"));
        } else if is("PERI") {
            self.set_frequency(number("S").map(f64::recip));
        } else if is("AMP") {
            self.set_amplitude(number("V").map(|volts| volts / divider));
        } else if is("AMPVRMS") {
            self.set_amplitude(number("VRMS").map(|volts| volts * 2.0 * SQRT_2 / divider));
        } else if is("OFST") {
            self.set_offset(number("V").map(|volts| volts / divider));
        } else if is("HLEV") {
            let low = self.offset_v - self.amplitude_vpp / 2.0;
            self.set_levels(low, number("V").map(|volts| volts / divider));
        } else if is("LLEV") {
            let high = self.offset_v + self.amplitude_vpp / 2.0;
            self.set_levels(high, number("V").map(|volts| volts / divider));
        } else if is("PHSE") {
            self.phase_deg = number("DEG").map_or(self.phase_deg, |degrees| degrees.rem_euclid(360.0));
        } else if key.as_bytes().eq_ignore_ascii_case(SHORT_KEY) {
            self.max_vpp = number("V").map_or(self.max_vpp, |volts| (volts / divider).clamp(MIN_VPP, 2.0 * MAX_VOLTS));
            self.set_amplitude(Some(self.amplitude_vpp));
        }
    }

    fn set_wave(&mut self, value: &Argument) {
        match value {
            Argument::Word(word) if word.eq_ignore_ascii_case("SINE") => (self.constant, self.arbitrary) = (false, false),
            Argument::Word(word) if word.eq_ignore_ascii_case("DC") => (self.constant, self.arbitrary) = (true, false),
            Argument::Word(word) if word.eq_ignore_ascii_case("ARB") && self.has_wave => (self.constant, self.arbitrary) = (false, true),
            _ => {}
        }
    }

    fn set_frequency(&mut self, freq_hz: Option<f64>) {
        if let Some(freq_hz) = freq_hz.filter(|freq_hz| freq_hz.is_finite()) {
            self.freq_hz = (freq_hz * 1e6).round().max(0.0) / 1e6;
            self.freq_hz = self.freq_hz.clamp(FREQ_RANGE_HZ.0, FREQ_RANGE_HZ.1);
        }
    }

    fn set_amplitude(&mut self, vpp: Option<f64>) {
        if let Some(vpp) = vpp {
            let room = 2.0 * (MAX_VOLTS - self.offset_v.abs());
            self.amplitude_vpp = step(vpp).min(self.max_vpp).min(room).max(MIN_VPP);
        }
    }

    fn set_offset(&mut self, volts: Option<f64>) {
        if let Some(volts) = volts {
            let room = if self.constant { MAX_VOLTS } else { (MAX_VOLTS - self.amplitude_vpp / 2.0).max(0.0) };
            self.offset_v = step(volts).clamp(-room, room);
        }
    }

    fn set_levels(&mut self, kept: f64, moved: Option<f64>) {
        if let Some(moved) = moved {
            let moved = moved.clamp(-MAX_VOLTS, MAX_VOLTS);
            self.offset_v = step((kept + moved) / 2.0);
            self.set_amplitude(Some((kept - moved).abs()));
        }
    }

    fn describe(&self) -> String {
        let volts = |open: f64| general(open * self.divider(), 6);
        let offset = volts(self.offset_v);
        if self.constant {
            return format!("WVTP,DC,MAX_OUTPUT_AMP,{}V,OFST,{offset}V", volts(self.max_vpp));
        }
        let half = self.amplitude_vpp / 2.0;
        format!(
            "WVTP,{},FRQ,{}HZ,PERI,{}S,AMP,{}V,AMPVRMS,{}Vrms,MAX_OUTPUT_AMP,{}V,OFST,{offset}V,HLEV,{}V,LLEV,{}V,PHSE,{}",
            if self.arbitrary { "ARB" } else { "SINE" },
            general(self.freq_hz, 12),
            general(self.freq_hz.recip(), 6),
            volts(self.amplitude_vpp),
            general(self.amplitude_vpp * self.divider() / (2.0 * SQRT_2), 4),
            volts(self.max_vpp),
            volts(self.offset_v + half),
            volts(self.offset_v - half),
            general(self.phase_deg, 6),
        )
    }

    fn describe_output(&self) -> String {
        let load = self.load_ohm.map_or_else(|| "HZ".to_owned(), |load| general(load, 6));
        format!("{},LOAD,{load},PLRT,{}", on_off(self.output_on), if self.inverted { "INVT" } else { "NOR" })
    }

    /// Takes `ON`, `OFF`, `LOAD,x` and `PLRT,x` in any number and order.
    fn set_output(&mut self, arguments: &mut Arguments) {
        while let Some(Argument::Word(word)) = arguments.next() {
            if word.eq_ignore_ascii_case("ON") || word.eq_ignore_ascii_case("OFF") {
                self.output_on = word.eq_ignore_ascii_case("ON");
            } else if word.eq_ignore_ascii_case("LOAD") {
                match arguments.next() {
                    Some(Argument::Word(load)) if load.eq_ignore_ascii_case("HZ") => self.load_ohm = None,
                    Some(load) => {
                        let ohms = to_number(&load, "OHM").ok().filter(|ohms| ohms.is_finite());
                        self.load_ohm = ohms.map_or(self.load_ohm, |ohms| Some(ohms.clamp(LOAD_RANGE_OHM.0, LOAD_RANGE_OHM.1)));
                    }
                    None => {}
                }
            } else if word.eq_ignore_ascii_case("PLRT") {
                match arguments.next() {
                    Some(Argument::Word(polarity)) if mnemonic_compare(b"NOR", polarity.as_bytes()) => self.inverted = false,
                    Some(Argument::Word(polarity)) if mnemonic_compare(b"INVT", polarity.as_bytes()) => self.inverted = true,
                    _ => {}
                }
            }
        }
    }

    fn restarts_from(&self, old: &Self) -> bool {
        let key = |channel: &Self| (channel.constant, channel.arbitrary, channel.freq_hz, channel.phase_deg, channel.output_on);
        key(self) != key(old)
    }

    fn state(&self) -> GeneratorState {
        if !self.output_on {
            return GeneratorState::default();
        }
        let sign = if self.inverted { -1.0 } else { 1.0 };
        let offset_v = sign * self.offset_v;
        if self.constant {
            return GeneratorState { offset_v, ..GeneratorState::default() };
        }
        GeneratorState {
            offset_v,
            amplitude_v: self.amplitude_vpp / 2.0,
            freq_hz: self.freq_hz,
            phase_rad: self.phase_deg.to_radians() + if self.inverted { std::f64::consts::PI } else { 0.0 },
            since_s: self.since_s,
        }
    }
}

fn step(volts: f64) -> f64 {
    (volts * 1e4).round() / 1e4
}

fn on_off(on: bool) -> &'static str {
    if on { "ON" } else { "OFF" }
}

impl Sdg {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let (serial_number, waves) = (options.serial_number.clone(), BTreeMap::new());
        let sdg = Self {
            world: World::new(plant, options.since_s),
            serial_number,
            channels: [Channel::default(); 2],
            waves,
            chosen: [None, None],
        };
        sdg.act();
        sdg
    }

    fn act(&self) {
        self.world.act(Action::Generator(self.channels[0].state()));
    }

    /// Changes one channel, starts its phase anew where that is due, and tells the world.
    fn change(&mut self, index: usize, change: impl FnOnce(&mut Channel)) {
        let old = self.channels[index];
        let channel = &mut self.channels[index];
        change(channel);
        if channel.restarts_from(&old) {
            channel.since_s = self.world.now_s;
        }
        if self.channels[index] != old && index == 0 {
            self.reshape(old.arbitrary);
            self.act();
        }
    }

    /// Tells the world the shape of channel 1, where it is or was a wave.
    fn reshape(&self, was_arbitrary: bool) {
        let plays = self.channels[0].arbitrary;
        if plays || was_arbitrary {
            let wave = self.chosen[0].as_ref().and_then(|name| self.waves.get(name)).filter(|_| plays);
            self.world.plant().shape(self.world.now_s, wave.cloned());
        }
    }

    fn choose_wave(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        while let (Some(Argument::Word(key)), Some(value)) = (arguments.next(), arguments.next()) {
            let Argument::Word(name) = value else { continue };
            if key.eq_ignore_ascii_case("NAME") && self.waves.contains_key(&name) {
                self.chosen[index] = Some(name);
                self.change(index, |channel| channel.has_wave = true);
                if index == 0 {
                    self.reshape(false);
                }
            }
        }
        common::ignore(self, arguments)
    }

    /// The built-in wave that a channel has chosen at the start, or the loaded one.
    fn describe_wave(&self, index: usize) -> String {
        self.chosen[index].as_ref().map_or_else(|| "INDEX,2,NAME,StairUp".to_owned(), |name| format!("INDEX,60,NAME,{name}"))
    }

    /// `Cn:WVDT WVNM,name,…,WAVEDATA,bytes`; true for any message of this header.
    fn load_wave(&mut self, message: &[u8]) -> bool {
        let header = message.get(..7).map(<[u8]>::to_ascii_uppercase);
        if !matches!(header.as_deref(), Some(b"C1:WVDT" | b"C2:WVDT")) {
            return false;
        }
        let marker = b",WAVEDATA,";
        let Some(at) = message.windows(marker.len()).position(|window| window.eq_ignore_ascii_case(marker)) else { return true };
        let (head, data) = (String::from_utf8_lossy(&message[7..at]), &message[at + marker.len()..]);
        let fields: Vec<&str> = head.trim().split(',').collect();
        let name = fields.chunks(2).find(|pair| pair[0].eq_ignore_ascii_case("WVNM")).and_then(|pair| pair.get(1));
        if let (Some(name), true) = (name, data.len() >= 2 && data.len().is_multiple_of(2)) {
            let points = data.chunks_exact(2).map(|pair| f64::from(i16::from_le_bytes([pair[0], pair[1]])) / 32_767.0);
            self.waves.insert((*name).to_owned(), points.collect());
        }
        true
    }

    fn set_basic_wave(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let mut pairs = Vec::new();
        while let (Some(Argument::Word(key)), Some(value)) = (arguments.next(), arguments.next()) {
            pairs.push((key, value));
        }
        common::ignore(self, arguments)?;
        // The wave type decides what the other keys mean, and the offset leaves room for the amplitude, wherever they stand in the list.
        pairs.sort_by_key(|(key, _)| match key.to_ascii_uppercase().as_str() {
            "WVTP" => 0,
            "AMP" | "AMPVRMS" => 2,
            _ => 1,
        });
        self.change(index, |channel| {
            if pairs.iter().any(|(key, _)| key.eq_ignore_ascii_case("OFST")) && pairs.iter().any(|(key, _)| key.eq_ignore_ascii_case("AMP"))
            {
                channel.amplitude_vpp = MIN_VPP;
            }
            for (key, value) in &pairs {
                channel.set(key, value);
            }
        });
        Ok(())
    }

    fn set_output(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.change(index, |channel| channel.set_output(arguments));
        common::ignore(self, arguments)
    }

    fn align_phases(&mut self, _: &mut Arguments) -> Fallible {
        for index in 0..self.channels.len() {
            self.channels[index].since_s = self.world.now_s;
        }
        self.act();
        Ok(())
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        let was_arbitrary = self.channels[0].arbitrary;
        self.channels = [Channel { since_s: self.world.now_s, ..Channel::default() }; 2];
        self.chosen = [None, None];
        self.reshape(was_arbitrary);
        self.act();
        Ok(())
    }

    fn identity(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        text(format!("Siglent Technologies,SDG1032X,{},1.01.01.33R1B6", self.serial_number))
    }
}

macro_rules! basic_wave {
    ($index:literal, $prefix:literal) => {
        &both(
            |sdg: &mut Sdg, arguments| sdg.set_basic_wave($index, arguments),
            |sdg, _| text(format!(concat!($prefix, ":BSWV {}"), sdg.channels[$index].describe())),
        )
    };
}

macro_rules! channel {
    ($name:literal, $index:literal, $prefix:literal) => {
        Branch! {$name;
            Leaf! {b"BSWV" => basic_wave!($index, $prefix)},
            Leaf! {b"BASIC_WAVE" => basic_wave!($index, $prefix)},
            Leaf! {b"OUTPut" => &both(
                |sdg: &mut Sdg, arguments| sdg.set_output($index, arguments),
                |sdg, _| text(format!(concat!($prefix, ":OUTP {}"), sdg.channels[$index].describe_output())),
            )},
            Leaf! {b"ARWV" => &both(
                |sdg: &mut Sdg, arguments| sdg.choose_wave($index, arguments),
                |sdg, _| text(format!(concat!($prefix, ":ARWV {}"), sdg.describe_wave($index))),
            )},
            // Burst, sweep and modulation are off and stay off.
            Leaf! {b"BTWV" => &both(common::ignore, |_, _| text(concat!($prefix, ":BTWV STATE,OFF")))},
            Leaf! {b"SWWV" => &both(common::ignore, |_, _| text(concat!($prefix, ":SWWV STATE,OFF")))},
            Leaf! {b"MDWV" => &both(common::ignore, |_, _| text(concat!($prefix, ":MDWV STATE,OFF")))}
        }
    };
}

const TREE: Node<'static, Sdg> = Root! {
    Leaf! {b"*IDN" => &get(Sdg::identity)},
    Leaf! {b"*RST" => &set(Sdg::reset)},
    Leaf! {b"*OPC" => &both(common::ignore, common::opc_query)},
    channel! {b"C1", 0, "C1"},
    channel! {b"C2", 1, "C2"},
    Leaf! {b"EQPHASE" => &set(Sdg::align_phases)},
    Branch! {b"SYSTem"; Leaf! {b"ERRor" => &get(|_: &mut Sdg, _| text("0,No Error"))}}
};

impl scpi::Device for Sdg {
    fn handle_error(&mut self, _: Error) {}
}

impl Device for Sdg {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        if self.load_wave(message) {
            return Vec::new();
        }
        exchange(&TREE, self, &shortened(message))
    }
}

fn shortened(message: &[u8]) -> Vec<u8> {
    match message.windows(LONG_KEY.len()).position(|window| window.eq_ignore_ascii_case(LONG_KEY)) {
        Some(at) => [&message[..at], SHORT_KEY, &message[at + LONG_KEY.len()..]].concat(),
        None => message.to_vec(),
    }
}
