//! Keysight 34970A data logger with one multiplexer card in slot 100: thermocouples on channels 101
//! (surface of the cell), 102 (ambient air) and 103 (bath); the other channels of the card, to 120,
//! are open and read +9.9E37.
//!
//! Not simulated: timed scans (`TRIG:SOUR TIM` and the count are kept, a scan is taken at once),
//! time stamps, alarms, other functions than temperature: a channel that was not configured shows
//! the thermocouple's direct voltage, about 41 µV/K.

use scpi::{Branch, Leaf, Root, error::ErrorCode, tree::Node};

use super::{
    MockOptions,
    machine::scpi_device,
    number::signed_nr3,
    plant::{Meter, SharedPlant},
    tree::{Answer, Arguments, Fallible, Status, bit, both, common, fail, get, set, text},
    world::World,
};

const QUEUE_DEPTH: usize = 10;
const CHANNELS: std::ops::RangeInclusive<u16> = 101..=120;
const OVERLOAD: f64 = 9.9e37;
/// A type K thermocouple near room temperature, V/K, and its cold junction, °C.
const VOLTS_PER_KELVIN: f64 = 41e-6;
const JUNCTION_C: f64 = 23.0;
/// The most readings kept, oldest dropped first.
const MEMORY: usize = 50_000;

/// The logger.
pub(super) struct Scanner {
    world: World,
    status: Status,
    settings: Settings,
    readings: Vec<(u16, f64)>,
    /// Nothing is connected.
    open: bool,
}

#[derive(Debug, Clone, PartialEq)]
struct Settings {
    scan: Vec<u16>,
    temperature: Vec<u16>,
    unit: &'static str,
    source: &'static str,
    timer_s: f64,
    count: usize,
    monitored: Option<u16>,
    with_channel: bool,
    with_unit: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            scan: Vec::new(),
            temperature: Vec::new(),
            unit: "C",
            source: "IMM",
            timer_s: 10.0,
            count: 1,
            monitored: None,
            with_channel: false,
            with_unit: false,
        }
    }
}

impl Scanner {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        Self {
            world: World::new(plant, options.since_s),
            status: Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            settings: Settings::default(),
            readings: Vec::new(),
            open: options.quirks.is("open_thermocouple"),
        }
    }

    fn list(arguments: &mut Arguments) -> Fallible<Vec<u16>> {
        let channels = arguments.channels()?;
        if channels.iter().all(|channel| CHANNELS.contains(channel)) {
            Ok(channels)
        } else {
            fail(ErrorCode::DataOutOfRange)
        }
    }

    fn configure_temperature(&mut self, arguments: &mut Arguments) -> Fallible {
        match arguments.word(&["TCouple", "TC", "RTD", "FRTD", "THERmistor", "THER"])? {
            "RTD" | "FRTD" | "THERmistor" | "THER" => {
                arguments.number("")?;
            }
            _ => {
                arguments.word(&["B", "E", "J", "K", "N", "R", "S", "T"])?;
            }
        }
        let channels = Self::list(arguments)?;
        self.settings.temperature.extend(
            channels
                .iter()
                .filter(|channel| !self.settings.temperature.contains(channel))
                .copied()
                .collect::<Vec<_>>(),
        );
        self.settings.scan = channels;
        self.readings.clear();
        Ok(())
    }

    fn set_unit(&mut self, arguments: &mut Arguments) -> Fallible {
        self.settings.unit = arguments.word(&["C", "F", "K"])?;
        if !arguments.is_empty() {
            Self::list(arguments)?;
        }
        Ok(())
    }

    fn set_scan(&mut self, arguments: &mut Arguments) -> Fallible {
        self.settings.scan = Self::list(arguments)?;
        self.readings.clear();
        Ok(())
    }

    /// Returns the scan list as a block.
    fn scan_list(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        let names: Vec<String> = self.settings.scan.iter().map(u16::to_string).collect();
        text(block(&format!("(@{})", names.join(","))))
    }

    fn read_channel(&self, channel: u16) -> f64 {
        let celsius = match channel {
            _ if self.open => return OVERLOAD,
            101 => self.world.read(Meter::CellCelsius),
            102 => self.world.read(Meter::AmbientCelsius),
            103 => self.world.read(Meter::BathCelsius),
            _ => return OVERLOAD,
        };
        // A broken wire.
        if celsius.is_nan() {
            return OVERLOAD;
        }
        match self.settings.unit {
            _ if !self.settings.temperature.contains(&channel) => {
                (celsius - JUNCTION_C) * VOLTS_PER_KELVIN
            }
            "F" => celsius * 1.8 + 32.0,
            "K" => celsius + 273.15,
            _ => celsius,
        }
    }

    fn initiate(&mut self, _: &mut Arguments) -> Fallible {
        if self.settings.scan.is_empty() {
            return fail(ErrorCode::SettingsConflict);
        }
        self.readings.clear();
        for _ in 0..self.settings.count {
            for channel in self.settings.scan.clone() {
                if self.readings.len() < MEMORY {
                    let value = self.read_channel(channel);
                    self.readings.push((channel, value));
                }
            }
        }
        Ok(())
    }

    fn format(&self, readings: &[(u16, f64)]) -> String {
        let entries: Vec<String> = readings
            .iter()
            .map(|(channel, value)| self.format_one(*channel, *value))
            .collect();
        entries.join(",")
    }

    fn format_one(&self, channel: u16, value: f64) -> String {
        let mut entry = signed_nr3(value);
        if self.settings.with_unit {
            entry += if self.settings.temperature.contains(&channel) {
                [" C", " F", " K"][unit_index(self.settings.unit)]
            } else {
                " VDC"
            };
        }
        if self.settings.with_channel {
            entry += &format!(",{channel}");
        }
        entry
    }

    fn fetch(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        if self.readings.is_empty() {
            return fail(ErrorCode::DataCorruptOrStale);
        }
        text(self.format(&self.readings))
    }

    fn read(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        self.initiate(arguments)?;
        self.fetch(arguments)
    }

    /// `R? n`: takes readings out of the memory, oldest first, as a block.
    fn remove(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        let wanted = if arguments.is_empty() {
            usize::MAX
        } else {
            count(arguments, MEMORY)?
        };
        let taken: Vec<_> = self
            .readings
            .drain(..wanted.min(self.readings.len()))
            .collect();
        text(block(&self.format(&taken)))
    }

    fn set_timer(&mut self, arguments: &mut Arguments) -> Fallible {
        let seconds = arguments.number("S")?;
        if !(0.0..=359_999.0).contains(&seconds) {
            return fail(ErrorCode::DataOutOfRange);
        }
        self.settings.timer_s = seconds;
        Ok(())
    }

    fn monitor(&mut self, arguments: &mut Arguments) -> Fallible {
        self.settings.monitored = Self::list(arguments)?.first().copied();
        Ok(())
    }

    fn monitored(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        match self.settings.monitored {
            Some(channel) => text(self.format_one(channel, self.read_channel(channel))),
            None => fail(ErrorCode::SettingsConflict),
        }
    }

    fn card(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        match arguments.word(&["100", "200", "300"])? {
            "100" => text("HEWLETT-PACKARD,34901A,0,2.3"),
            _ => text("HEWLETT-PACKARD,0,0,0"),
        }
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        self.settings = Settings::default();
        self.readings.clear();
        Ok(())
    }
}

fn unit_index(unit: &str) -> usize {
    match unit {
        "F" => 1,
        "K" => 2,
        _ => 0,
    }
}

fn count(arguments: &mut Arguments, most: usize) -> Fallible<usize> {
    let value = arguments.number("")?.round();
    #[expect(clippy::cast_precision_loss, reason = "at most 50000")]
    if !(1.0..=most as f64).contains(&value) {
        return fail(ErrorCode::DataOutOfRange);
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "checked above"
    )]
    Ok(value as usize)
}

/// Returns a definite block of text.
fn block(payload: &str) -> String {
    let length = payload.len().to_string();
    format!("#{}{length}{payload}", length.len())
}

/// Accepts only "off" for additions to a reading that this mock does not have.
fn only_off(_: &mut Scanner, arguments: &mut Arguments) -> Fallible {
    if arguments.switch()? {
        fail(ErrorCode::SettingsConflict)
    } else {
        Ok(())
    }
}

const TREE: Node<'static, Scanner> = Root! {
    Leaf! {b"*IDN" => &get(|_: &mut Scanner, _| text("HEWLETT-PACKARD,34970A,0,13-2-2"))},
    Leaf! {b"*RST" => &set(Scanner::reset)},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*WAI" => &set(common::ignore)},
    Branch! {b"CONFigure"; Leaf! {b"TEMPerature" => &set(Scanner::configure_temperature)}},
    Branch! {b"UNIT";
        Leaf! {b"TEMPerature" => &both(
            Scanner::set_unit,
            |scanner, arguments| { common::ignore(scanner, arguments)?; text(scanner.settings.unit) },
        )}
    },
    Branch! {b"ROUTe";
        Leaf! {b"SCAN" => &both(Scanner::set_scan, Scanner::scan_list)},
        Branch! {b"MONitor" => &set(Scanner::monitor); Leaf! {b"DATA" => &get(Scanner::monitored)}}
    },
    Branch! {b"TRIGger";
        Leaf! {b"SOURce" => &both(
            |scanner: &mut Scanner, arguments| {
                scanner.settings.source = match arguments.word(&["IMMediate", "TIMer", "BUS", "EXTernal"])? {
                    "TIMer" => "TIM",
                    "BUS" => "BUS",
                    "EXTernal" => "EXT",
                    _ => "IMM",
                };
                Ok(())
            },
            |scanner, _| text(scanner.settings.source),
        )},
        Leaf! {b"TIMer" => &both(Scanner::set_timer, |scanner, _| text(signed_nr3(scanner.settings.timer_s)))},
        Leaf! {b"COUNt" => &both(
            |scanner: &mut Scanner, arguments| { scanner.settings.count = count(arguments, MEMORY)?; Ok(()) },
            |scanner, _| text(scanner.settings.count.to_string()),
        )}
    },
    Branch! {b"INITiate" => &set(Scanner::initiate); Leaf! {b"IMMediate" => &set(Scanner::initiate)}},
    Leaf! {b"FETCh" => &get(Scanner::fetch)},
    Leaf! {b"READ" => &get(Scanner::read)},
    Leaf! {b"R" => &get(Scanner::remove)},
    Branch! {b"DATA"; Leaf! {b"POINts" => &get(|scanner: &mut Scanner, _| text(scanner.readings.len().to_string()))}},
    Branch! {b"FORMat"; Branch! {b"READing";
        Leaf! {b"CHANnel" => &both(
            |scanner: &mut Scanner, arguments| { scanner.settings.with_channel = arguments.switch()?; Ok(()) },
            |scanner, _| bit(scanner.settings.with_channel),
        )},
        Leaf! {b"UNIT" => &both(
            |scanner: &mut Scanner, arguments| { scanner.settings.with_unit = arguments.switch()?; Ok(()) },
            |scanner, _| bit(scanner.settings.with_unit),
        )},
        Leaf! {b"TIME" => &both(only_off, |_, _| bit(false))},
        Leaf! {b"ALARm" => &both(only_off, |_, _| bit(false))}
    }},
    Branch! {b"SYSTem";
        Branch! {b"ERRor" => &get(common::signed_error_query); Leaf! {b"NEXT" => &get(common::signed_error_query)}},
        Leaf! {b"VERSion" => &get(|_: &mut Scanner, _| text("1994.0"))},
        Leaf! {b"CTYPe" => &get(Scanner::card)},
        Leaf! {b"REMote" => &set(common::ignore)},
        Leaf! {b"LOCal" => &set(common::ignore)}
    }
};

scpi_device!(Scanner, TREE, coded);
