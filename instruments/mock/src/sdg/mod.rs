//! Siglent SDG1000X function generator: one keyword list per channel,
//! `C1:BSWV WVTP,SINE,FRQ,1000,…`.
//!
//! Out-of-range values are clamped silently, and unknown headers get no reply. A single field
//! cannot be queried: the `?` takes no argument. Voltages are kept as the open-circuit voltage
//! behind 50 Ω; `LOAD` only changes how they are reported and interpreted.
//!
//! Only channel 1 is wired to the bench, and only a sine, a constant voltage and loaded waves are
//! simulated: other wave types are ignored, and so is `ARB` before a loaded wave was selected.
//! `WVDT` accepts raw little-endian words without a block header up to the end of the message.
//! Assumed, for lack of a source: voltages are set in steps of 0.1 mV and frequencies in steps of 1
//! µHz; the phase restarts when the frequency, the phase, the wave type or the output changes, and
//! runs on when an amplitude or an offset changes.

mod channel;

use std::{collections::BTreeMap, sync::Arc};

use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use channel::{Channel, Manner, SHORT_KEY};

use instruments_scpi::decode::Terminator;

use super::{
    Device, MockOptions,
    plant::{Action, SharedPlant},
    quirks::Quirks,
    tree::{Answer, Argument, Arguments, Fallible, both, common, exchange, fail, get, set, text},
    world::World,
};

/// The parser accepts keywords of at most 12 characters; this key has 14.
const LONG_KEY: &[u8] = b"MAX_OUTPUT_AMP";
/// The generator.
pub(super) struct Sdg {
    world: World,
    serial_number: String,
    quirks: Quirks,
    channels: [Channel; 2],
    /// Loaded waves by name.
    waves: BTreeMap<String, Arc<[f64]>>,
    /// The wave that each channel has chosen.
    chosen: [Option<String>; 2],
}

impl Sdg {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let (serial_number, waves) = (options.serial_number.clone(), BTreeMap::new());
        let sdg = Self {
            world: World::new(plant, options.since_s),
            serial_number,
            quirks: options.quirks.clone(),
            channels: [Channel {
                least_vpp: options.quirks.number("least_amplitude"),
                ..Channel::default()
            }; 2],
            waves,
            chosen: [None, None],
        };
        sdg.act();
        sdg
    }

    fn act(&self) {
        self.world.act(Action::Generator(self.channels[0].state()));
    }

    /// Changes one channel, restarts its phase if required, and updates the world.
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

    /// Sends the shape of channel 1 to the world if the channel outputs or has output a wave.
    fn reshape(&self, was_arbitrary: bool) {
        let plays = self.channels[0].arbitrary;
        if plays || was_arbitrary {
            let wave = self.chosen[0]
                .as_ref()
                .and_then(|name| self.waves.get(name))
                .filter(|_| plays);
            self.world.plant().shape(self.world.now_s, wave.cloned());
        }
    }

    fn choose_wave(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        while let (Some(Argument::Word(key)), Some(value)) = (arguments.next(), arguments.next()) {
            let Argument::Word(name) = value else {
                continue;
            };
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

    /// Returns the built-in wave that a channel has chosen at the start, or the loaded one.
    fn describe_wave(&self, index: usize) -> String {
        self.chosen[index].as_ref().map_or_else(
            || "INDEX,2,NAME,StairUp".to_owned(),
            |name| format!("INDEX,60,NAME,{name}"),
        )
    }

    /// Handles `Cn:WVDT WVNM,name,…,WAVEDATA,bytes`; returns true for any message of this header.
    fn load_wave(&mut self, message: &[u8]) -> bool {
        let header = message.get(..7).map(<[u8]>::to_ascii_uppercase);
        if !matches!(header.as_deref(), Some(b"C1:WVDT" | b"C2:WVDT")) {
            return false;
        }
        let marker = b",WAVEDATA,";
        let Some(at) = message
            .windows(marker.len())
            .position(|window| window.eq_ignore_ascii_case(marker))
        else {
            return true;
        };
        let (head, data) = (
            String::from_utf8_lossy(&message[7..at]),
            &message[at + marker.len()..],
        );
        let fields: Vec<&str> = head.trim().split(',').collect();
        let name = fields
            .chunks(2)
            .find(|pair| pair[0].eq_ignore_ascii_case("WVNM"))
            .and_then(|pair| pair.get(1));
        if let (Some(name), true) = (name, data.len() >= 2 && data.len().is_multiple_of(2)) {
            let points = data
                .chunks_exact(2)
                .map(|pair| f64::from(i16::from_le_bytes([pair[0], pair[1]])) / 32_767.0);
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
        // The wave type determines the meaning of the other keys, and the offset leaves room for
        // the amplitude, regardless of their position in the list.
        pairs.sort_by_key(|(key, _)| match key.to_ascii_uppercase().as_str() {
            "WVTP" => 0,
            "AMP" | "AMPVRMS" => 2,
            _ => 1,
        });
        let clamps = self.quirks.is("clamps");
        self.change(index, |channel| {
            let amplitude_vpp = channel.amplitude_vpp;
            if pairs
                .iter()
                .any(|(key, _)| key.eq_ignore_ascii_case("OFST"))
                && pairs.iter().any(|(key, _)| key.eq_ignore_ascii_case("AMP"))
            {
                channel.amplitude_vpp = channel.least_vpp;
            }
            for (key, value) in &pairs {
                let before = *channel;
                channel.set(key, value);
                if !clamps && channel.is_limited(key, value) {
                    *channel = if key.eq_ignore_ascii_case("AMP") {
                        Channel {
                            amplitude_vpp,
                            ..before
                        }
                    } else {
                        before
                    };
                }
            }
        });
        Ok(())
    }

    fn set_output(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.change(index, |channel| channel.set_output(arguments));
        common::ignore(self, arguments)
    }

    fn set_burst(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        if self.quirks.is("bursts") {
            let now_s = self.world.now_s;
            self.change(index, |channel| channel.set_burst(arguments, now_s));
        }
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
        let least_vpp = self.channels[0].least_vpp;
        self.channels = [Channel {
            since_s: self.world.now_s,
            least_vpp,
            ..Channel::default()
        }; 2];
        self.chosen = [None, None];
        self.reshape(was_arbitrary);
        self.act();
        Ok(())
    }

    fn answer(&self, header: &str, list: &str) -> Fallible<Answer> {
        let header = if self.quirks.is("header") { header } else { "" };
        text(format!("{header}{list}"))
    }

    fn manner(&self) -> Manner {
        Manner {
            units: self.quirks.is("units"),
            digits: self.quirks.count("digits"),
        }
    }

    /// It has no queue; the model reports its errors in two forms.
    fn errors(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        match self.quirks.word("errors") {
            "signed" => text("-0, No errors"),
            "silence" => fail(ErrorCode::UndefinedHeader),
            _ => text("0,No Error"),
        }
    }

    fn identity(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        text(format!(
            "Siglent Technologies,SDG1032X,{},1.01.01.33R1B6",
            self.serial_number
        ))
    }
}

macro_rules! basic_wave {
    ($index:literal, $prefix:literal) => {
        &both(
            |sdg: &mut Sdg, arguments| sdg.set_basic_wave($index, arguments),
            |sdg, _| {
                sdg.answer(
                    concat!($prefix, ":BSWV "),
                    &sdg.channels[$index].describe(&sdg.manner()),
                )
            },
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
                |sdg, _| sdg.answer(concat!($prefix, ":OUTP "), &sdg.channels[$index].describe_output()),
            )},
            Leaf! {b"ARWV" => &both(
                |sdg: &mut Sdg, arguments| sdg.choose_wave($index, arguments),
                |sdg, _| sdg.answer(concat!($prefix, ":ARWV "), &sdg.describe_wave($index)),
            )},
            Leaf! {b"BTWV" => &both(
                |sdg: &mut Sdg, arguments| sdg.set_burst($index, arguments),
                |sdg, _| {
                    let channel = &sdg.channels[$index];
                    sdg.answer(concat!($prefix, ":BTWV "), &channel.burst.describe(channel, &sdg.manner()))
                },
            )},
            // Sweep and modulation are off and stay off.
            Leaf! {b"SWWV" => &both(
                common::ignore,
                |sdg: &mut Sdg, _| sdg.answer(concat!($prefix, ":SWWV "), "STATE,OFF"),
            )},
            Leaf! {b"MDWV" => &both(
                common::ignore,
                |sdg: &mut Sdg, _| sdg.answer(concat!($prefix, ":MDWV "), "STATE,OFF"),
            )}
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
    Branch! {b"SYSTem"; Leaf! {b"ERRor" => &get(Sdg::errors)}}
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
    match message
        .windows(LONG_KEY.len())
        .position(|window| window.eq_ignore_ascii_case(LONG_KEY))
    {
        Some(at) => [&message[..at], SHORT_KEY, &message[at + LONG_KEY.len()..]].concat(),
        None => message.to_vec(),
    }
}
