//! One channel of the simulated generator: its settings, their answers, and their effect on the
//! world.

use std::f64::consts::SQRT_2;

use scpi::parser::mnemonic_compare;

use crate::{
    number::general,
    plant::GeneratorState,
    tree::{Argument, Arguments, to_number},
};

/// Source resistance, Ω.
const SOURCE_OHM: f64 = 50.0;
/// Highest open-circuit voltage, V; the greatest amplitude is twice that, peak to peak.
const MAX_VOLTS: f64 = 10.0;
/// Least amplitude into an open circuit, V peak to peak, as the manual has it.
const MIN_VPP: f64 = 2e-3;
const FREQ_RANGE_HZ: (f64, f64) = (1e-6, 30e6);
const LOAD_RANGE_OHM: (f64, f64) = (50.0, 100e3);

/// Format of numbers in answers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Manner {
    /// With their units.
    pub(super) units: bool,
    /// Maximum number of digits; 0 selects the model's default.
    pub(super) digits: usize,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Channel {
    pub(super) constant: bool,
    /// Plays the chosen wave.
    pub(super) arbitrary: bool,
    /// A loaded wave is chosen.
    pub(super) has_wave: bool,
    pub(super) freq_hz: f64,
    /// Open-circuit amplitude, V peak to peak.
    pub(super) amplitude_vpp: f64,
    /// Open-circuit offset, V.
    pub(super) offset_v: f64,
    pub(super) phase_deg: f64,
    /// Open-circuit ceiling of the amplitude, V peak to peak.
    pub(super) max_vpp: f64,
    /// Open-circuit floor of the amplitude, V peak to peak.
    pub(super) least_vpp: f64,
    pub(super) output_on: bool,
    /// `None`: high impedance.
    pub(super) load_ohm: Option<f64>,
    pub(super) inverted: bool,
    pub(super) since_s: f64,
    pub(super) burst: Burst,
}

/// Bursts of a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Burst {
    on: bool,
    /// Gated by a signal instead of counted.
    gated: bool,
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
const SOURCES: [&str; 3] = ["INT", "EXT", "MAN"];
/// Most periods of a burst.
const MOST_PERIODS: f64 = 1e6;
/// Least and greatest delay of a burst, s.
const DELAYS_S: (f64, f64) = (2.4e-7, 1e3);

impl Burst {
    const OFF: Self = Self {
        on: false,
        gated: false,
        source: "INT",
        periods: 1,
        start_deg: 0.0,
        delay_s: DELAYS_S.0,
        fired: false,
    };

    /// Sets one key and value; ignores unknown ones.
    fn set(&mut self, key: &str, value: &Argument) {
        match (key.to_ascii_uppercase().as_str(), value) {
            ("STATE", Argument::Word(word)) => {
                let on = word.eq_ignore_ascii_case("ON");
                *self = Self {
                    on,
                    fired: self.fired && on == self.on,
                    ..*self
                };
            }
            ("GATE_NCYC", Argument::Word(word)) => self.gated = word.eq_ignore_ascii_case("GATE"),
            ("TRSR", Argument::Word(word)) => {
                self.source = SOURCES
                    .into_iter()
                    .find(|source| word.eq_ignore_ascii_case(source))
                    .unwrap_or(self.source);
            }
            ("TIME", value) => {
                if let Ok(periods) = to_number(value, "") {
                    self.periods = periods.clamp(1.0, MOST_PERIODS) as u32;
                }
            }
            ("STPS", value) => {
                self.start_deg = to_number(value, "DEG")
                    .map_or(self.start_deg, |degrees| degrees.rem_euclid(360.0));
            }
            ("DLAY", value) => {
                self.delay_s = to_number(value, "S").map_or(self.delay_s, |seconds| {
                    seconds.clamp(DELAYS_S.0, DELAYS_S.1)
                });
            }
            _ => {}
        }
    }

    pub(super) fn describe(&self, channel: &Channel, manner: &Manner) -> String {
        if !self.on {
            return "STATE,OFF".to_owned();
        }
        let mode = if self.gated { "GATE" } else { "NCYC" };
        format!(
            "STATE,ON,PRD,0.01S,STPS,{},TRSR,{},TRMD,OFF,TIME,{},DLAY,{}S,GATE_NCYC,{mode},CARR,{}",
            general(self.start_deg, 6),
            self.source,
            self.periods,
            general(self.delay_s, 6),
            channel.describe(manner)
        )
    }
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
            least_vpp: MIN_VPP,
            output_on: false,
            load_ohm: None,
            inverted: false,
            since_s: 0.0,
            burst: Burst::OFF,
        }
    }
}

impl Channel {
    /// Returns the share of the open-circuit voltage at the assumed load.
    fn divider(&self) -> f64 {
        self.load_ohm.map_or(1.0, |load| load / (load + SOURCE_OHM))
    }

    /// Sets one key and value; ignores unknown ones.
    pub(super) fn set(&mut self, key: &str, value: &Argument) {
        let is = |name: &str| key.eq_ignore_ascii_case(name);
        let number = |unit: &str| {
            to_number(value, unit)
                .ok()
                .filter(|number| number.is_finite())
        };
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
            self.phase_deg =
                number("DEG").map_or(self.phase_deg, |degrees| degrees.rem_euclid(360.0));
        } else if key.as_bytes().eq_ignore_ascii_case(SHORT_KEY) {
            self.max_vpp = number("V").map_or(self.max_vpp, |volts| {
                (volts / divider).clamp(self.least_vpp, 2.0 * MAX_VOLTS)
            });
            self.set_amplitude(Some(self.amplitude_vpp));
        }
    }

    fn set_wave(&mut self, value: &Argument) {
        match value {
            Argument::Word(word) if word.eq_ignore_ascii_case("SINE") => {
                (self.constant, self.arbitrary) = (false, false);
            }
            Argument::Word(word) if word.eq_ignore_ascii_case("DC") => {
                (self.constant, self.arbitrary) = (true, false);
            }
            Argument::Word(word) if word.eq_ignore_ascii_case("ARB") && self.has_wave => {
                (self.constant, self.arbitrary) = (false, true);
            }
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
            self.amplitude_vpp = step(vpp).min(self.max_vpp).min(room).max(self.least_vpp);
        }
    }

    fn set_offset(&mut self, volts: Option<f64>) {
        if let Some(volts) = volts {
            let room = if self.constant {
                MAX_VOLTS
            } else {
                (MAX_VOLTS - self.amplitude_vpp / 2.0).max(0.0)
            };
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

    /// Returns whether a value that was just set differs from the requested one by more than the
    /// steps of the converter.
    pub(super) fn is_limited(&self, key: &str, value: &Argument) -> bool {
        let divider = self.divider();
        let (met, unit, step) = match key.to_ascii_uppercase().as_str() {
            "FRQ" => (self.freq_hz, "HZ", 1e-6),
            "AMP" => (self.amplitude_vpp * divider, "V", 1e-4),
            "OFST" => (self.offset_v * divider, "V", 1e-4),
            _ => return false,
        };
        to_number(value, unit).is_ok_and(|asked| (asked - met).abs() > step)
    }

    pub(super) fn describe(&self, manner: &Manner) -> String {
        let digits = |usual: usize| {
            if manner.digits == 0 {
                usual
            } else {
                manner.digits.min(usual)
            }
        };
        let with = |unit: &'static str| if manner.units { unit } else { "" };
        let (hertz, seconds, v, vrms) = (with("HZ"), with("S"), with("V"), with("Vrms"));
        let volts = |open: f64| general(open * self.divider(), digits(6));
        let offset = volts(self.offset_v);
        if self.constant {
            return format!(
                "WVTP,DC,MAX_OUTPUT_AMP,{}{v},OFST,{offset}{v}",
                volts(self.max_vpp)
            );
        }
        let half = self.amplitude_vpp / 2.0;
        format!(
            "WVTP,{},FRQ,{}{hertz},PERI,{}{seconds},AMP,{}{v},AMPVRMS,{}{vrms},\
            MAX_OUTPUT_AMP,{}{v},OFST,{offset}{v},HLEV,{}{v},LLEV,{}{v},PHSE,{}",
            if self.arbitrary { "ARB" } else { "SINE" },
            general(self.freq_hz, digits(12)),
            general(self.freq_hz.recip(), digits(6)),
            volts(self.amplitude_vpp),
            general(
                self.amplitude_vpp * self.divider() / (2.0 * SQRT_2),
                digits(4)
            ),
            volts(self.max_vpp),
            volts(self.offset_v + half),
            volts(self.offset_v - half),
            general(self.phase_deg, digits(6)),
        )
    }

    pub(super) fn describe_output(&self) -> String {
        let load = self
            .load_ohm
            .map_or_else(|| "HZ".to_owned(), |load| general(load, 6));
        format!(
            "{},LOAD,{load},PLRT,{}",
            on_off(self.output_on),
            if self.inverted { "INVT" } else { "NOR" }
        )
    }

    /// Takes `ON`, `OFF`, `LOAD,x` and `PLRT,x` in any number and order.
    pub(super) fn set_output(&mut self, arguments: &mut Arguments) {
        while let Some(Argument::Word(word)) = arguments.next() {
            if word.eq_ignore_ascii_case("ON") || word.eq_ignore_ascii_case("OFF") {
                self.output_on = word.eq_ignore_ascii_case("ON");
            } else if word.eq_ignore_ascii_case("LOAD") {
                match arguments.next() {
                    Some(Argument::Word(load)) if load.eq_ignore_ascii_case("HZ") => {
                        self.load_ohm = None;
                    }
                    Some(load) => {
                        let ohms = to_number(&load, "OHM").ok().filter(|ohms| ohms.is_finite());
                        self.load_ohm = ohms.map_or(self.load_ohm, |ohms| {
                            Some(ohms.clamp(LOAD_RANGE_OHM.0, LOAD_RANGE_OHM.1))
                        });
                    }
                    None => {}
                }
            } else if word.eq_ignore_ascii_case("PLRT") {
                match arguments.next() {
                    Some(Argument::Word(polarity))
                        if mnemonic_compare(b"NOR", polarity.as_bytes()) =>
                    {
                        self.inverted = false;
                    }
                    Some(Argument::Word(polarity))
                        if mnemonic_compare(b"INVT", polarity.as_bytes()) =>
                    {
                        self.inverted = true;
                    }
                    _ => {}
                }
            }
        }
    }

    /// Takes `STATE,x`, `GATE_NCYC,x`, `TRSR,x`, `STPS,x`, `DLAY,x` and `TIME,n` in any number and
    /// order, and `MTRIG`, which starts a burst now.
    pub(super) fn set_burst(&mut self, arguments: &mut Arguments, now_s: f64) {
        while let Some(Argument::Word(key)) = arguments.next() {
            if key.eq_ignore_ascii_case("MTRIG") {
                // A channel that waits for a signal gets no trigger, and a running burst is not
                // restarted.
                if self.burst.on && self.burst.source == "MAN" && !self.plays(now_s) {
                    (self.burst.fired, self.since_s) = (true, now_s + self.burst.delay_s);
                }
            } else if let Some(value) = arguments.next() {
                self.burst.set(&key, &value);
            }
        }
    }

    /// Returns whether a burst is in work.
    fn plays(&self, now_s: f64) -> bool {
        self.burst.fired && now_s - self.since_s < f64::from(self.burst.periods) / self.freq_hz
    }

    pub(super) fn restarts_from(&self, old: &Self) -> bool {
        let key = |channel: &Self| {
            (
                channel.constant,
                channel.arbitrary,
                channel.freq_hz,
                channel.phase_deg,
                channel.output_on,
                channel.burst.on,
            )
        };
        key(self) != key(old)
    }

    pub(super) fn state(&self) -> GeneratorState {
        if !self.output_on {
            return GeneratorState::default();
        }
        let sign = if self.inverted { -1.0 } else { 1.0 };
        let offset_v = sign * self.offset_v;
        if self.constant {
            return GeneratorState {
                offset_v,
                ..GeneratorState::default()
            };
        }
        GeneratorState {
            offset_v,
            amplitude_v: self.amplitude_vpp / 2.0,
            freq_hz: self.freq_hz,
            phase_rad: if self.burst.on {
                self.burst.start_deg
            } else {
                self.phase_deg
            }
            .to_radians()
                + if self.inverted {
                    std::f64::consts::PI
                } else {
                    0.0
                },
            since_s: self.since_s,
            periods: self.burst.on.then_some(if self.burst.fired {
                self.burst.periods
            } else {
                0
            }),
        }
    }
}

fn step(volts: f64) -> f64 {
    (volts * 1e4).round() / 1e4
}

fn on_off(on: bool) -> &'static str {
    if on { "ON" } else { "OFF" }
}

pub(super) const SHORT_KEY: &[u8] = b"MAXOUTPUTAMP";
