//! Rigol DL3021 electronic load. The function is set as `CURR` and answered as `CC`; it has an
//! error queue; two line ends follow a measurement.
//!
//! Only constant current and constant power draw from the cell; the other functions and regulation
//! modes can be selected and read back, but draw nothing. `[:SOURce]` is optional. Assumed:
//! out-of-range values are refused with −222; below `VON`, the "starting voltage", the input sinks
//! nothing, regardless of the function and even after it has started; `ILIM` bounds the current and
//! does not switch off; both limits are at their ends when it is switched on.

use instruments_scpi::decode::Terminator;
use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{
    Device, MockOptions,
    plant::{Action, LoadState, Meter, SharedPlant},
    tree::{
        Answer, Arguments, Fallible, HasStatus, Span, Status, bit, both, common, exchange, fail,
        get, set, text,
    },
    world::World,
};

const QUEUE_DEPTH: usize = 20;
const FUNCTIONS: [(&str, &str); 4] = [
    ("CURRent", "CC"),
    ("VOLTage", "CV"),
    ("RESistance", "CR"),
    ("POWer", "CP"),
];
const MODES: [&str; 6] = ["FIXed", "LIST", "WAVe", "BATTery", "OCP", "OPP"];
const MAX_AMPS: f64 = 40.0;
const MAX_VOLTS: f64 = 150.0;
/// As an owner of a smaller and of a larger one found it: beyond the rating.
const MAX_AMPS_LIMIT: f64 = 70.0;

#[derive(Debug, Clone, Copy)]
struct Settings {
    function: usize,
    mode: usize,
    amps: f64,
    volts: f64,
    ohms: f64,
    watts: f64,
    current_range: f64,
    voltage_range: f64,
    slew: f64,
    start_volts: f64,
    volts_limit: f64,
    amps_limit: f64,
    input_on: bool,
    sense: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            function: 0,
            mode: 0,
            amps: 0.0,
            volts: MAX_VOLTS,
            ohms: 15_000.0,
            watts: 0.0,
            current_range: MAX_AMPS,
            voltage_range: MAX_VOLTS,
            slew: 0.5,
            start_volts: 0.0,
            volts_limit: 155.0,
            amps_limit: MAX_AMPS_LIMIT,
            input_on: false,
            sense: false,
        }
    }
}

/// The load.
pub(super) struct Dl3000 {
    world: World,
    status: Status,
    serial_number: String,
    settings: Settings,
    measured_end: bool,
    /// The function query returns another keyword than the one that sets it.
    function_word: bool,
    /// Resistance of the leads, Ω.
    lead_ohm: f64,
}

impl Dl3000 {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let (status, serial_number) = (
            Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            options.serial_number.clone(),
        );
        let load = Self {
            world: World::new(plant, options.since_s),
            status,
            serial_number,
            settings: Settings::default(),
            measured_end: options.quirks.is("measured_end"),
            lead_ohm: options.quirks.number("lead_ohm"),
            function_word: options.quirks.is("function_word"),
        };
        load.act();
        load
    }

    fn act(&self) {
        let settings = &self.settings;
        let draws = settings.function == 0 && settings.mode == 0;
        self.world.act(Action::Load(LoadState {
            input_on: settings.input_on,
            current_a: if draws {
                settings.amps.min(settings.amps_limit)
            } else {
                0.0
            },
            power_w: (settings.function == 3 && settings.mode == 0).then_some(settings.watts),
            min_voltage_v: settings.start_volts,
        }));
    }

    fn set_number(
        &mut self,
        arguments: &mut Arguments,
        unit: &str,
        max: f64,
        field: fn(&mut Settings) -> &mut f64,
    ) -> Fallible {
        let value = arguments.number_in(
            unit,
            Span {
                min: 0.0,
                max,
                default: 0.0,
            },
        )?;
        *field(&mut self.settings) = self.status.bounded(value, 0.0..=max)?;
        self.act();
        Ok(())
    }

    fn set_amps(&mut self, arguments: &mut Arguments) -> Fallible {
        let max = self.settings.current_range;
        self.set_number(arguments, "A", max, |settings| &mut settings.amps)
    }

    /// Selects the smaller range if the value fits into it. The input must be off.
    fn set_range(
        &mut self,
        arguments: &mut Arguments,
        unit: &str,
        low: f64,
        high: f64,
        field: fn(&mut Settings) -> &mut f64,
    ) -> Fallible {
        let value = arguments.number_in(
            unit,
            Span {
                min: low,
                max: high,
                default: high,
            },
        )?;
        if self.settings.input_on {
            return fail(ErrorCode::SettingsConflict);
        }
        *field(&mut self.settings) = if value > low { high } else { low };
        self.settings.amps = self.settings.amps.min(self.settings.current_range);
        self.act();
        Ok(())
    }

    fn function(&self) -> &'static str {
        let (word, answer) = FUNCTIONS[self.settings.function];
        if self.function_word {
            answer
        } else {
            word.trim_end_matches(char::is_lowercase)
        }
    }

    fn set_function(&mut self, arguments: &mut Arguments) -> Fallible {
        let word = arguments.word(&FUNCTIONS.map(|(word, _)| word))?;
        self.settings.function = FUNCTIONS
            .iter()
            .position(|(known, _)| *known == word)
            .unwrap_or(0);
        self.act();
        Ok(())
    }

    fn set_mode(&mut self, arguments: &mut Arguments) -> Fallible {
        let word = arguments.word(&MODES)?;
        self.settings.mode = MODES.iter().position(|known| *known == word).unwrap_or(0);
        self.act();
        Ok(())
    }

    fn set_input(&mut self, arguments: &mut Arguments) -> Fallible {
        self.settings.input_on = arguments.switch()?;
        self.act();
        Ok(())
    }

    fn set_sense(&mut self, arguments: &mut Arguments) -> Fallible {
        self.settings.sense = arguments.switch()?;
        Ok(())
    }

    fn measure(&self, show: fn(f64, f64) -> f64) -> Fallible<Answer> {
        let amps = self.world.read(Meter::LoadAmps);
        // Only remote sense leaves out the drop of the leads.
        let drop_v = if self.settings.sense {
            0.0
        } else {
            self.lead_ohm * amps
        };
        decimals(show(self.world.read(Meter::LoadVolts) - drop_v, amps))
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        self.settings = Settings::default();
        self.act();
        Ok(())
    }
}

fn decimals(value: f64) -> Fallible<Answer> {
    text(format!("{value:.4}"))
}

macro_rules! number {
    ($unit:literal, $max:expr, $field:ident) => {
        &both(
            |load: &mut Dl3000, arguments| {
                load.set_number(arguments, $unit, $max, |settings| &mut settings.$field)
            },
            |load, _| decimals(load.settings.$field),
        )
    };
}

macro_rules! level {
    ($verb:expr) => {
        Branch! {b"LEVel" => $verb; Leaf! {b"IMMediate" => $verb}}
    };
}

macro_rules! range {
    ($unit:literal, $low:expr, $high:expr, $field:ident) => {
        Leaf! {b"RANGe" => &both(
            |load: &mut Dl3000, arguments| {
                load.set_range(arguments, $unit, $low, $high, |settings| &mut settings.$field)
            },
            |load, _| text(format!("{}", load.settings.$field)),
        )}
    };
}

macro_rules! measured {
    ($name:literal, $show:expr) => {
        Branch! {$name => &get(|load: &mut Dl3000, _| load.measure($show));
            Leaf! {b"DC" => &get(|load: &mut Dl3000, _| load.measure($show))}
        }
    };
}

const CURRENT: Node<'static, Dl3000> = Branch! {b"CURRent";
    level!(&both(Dl3000::set_amps, |load, _| decimals(load.settings.amps))),
    range!("A", 4.0, MAX_AMPS, current_range),
    Leaf! {b"SLEW" => number!("A", 5.0, slew)},
    Leaf! {b"VON" => number!("V", MAX_VOLTS, start_volts)},
    Leaf! {b"VLIMt" => &both(
        |load: &mut Dl3000, arguments| load.set_number(arguments, "V", 155.0, |settings| &mut settings.volts_limit),
        |load, _| text(format!("{:.3}", load.settings.volts_limit)),
    )},
    Leaf! {b"ILIMt" => number!("A", MAX_AMPS_LIMIT, amps_limit)}
};
const VOLTAGE: Node<'static, Dl3000> = Branch! {b"VOLTage";
    level!(number!("V", MAX_VOLTS, volts)),
    range!("V", 15.0, MAX_VOLTS, voltage_range)
};
const RESISTANCE: Node<'static, Dl3000> =
    Branch! {b"RESistance"; level!(number!("OHM", 15_000.0, ohms))};
const POWER: Node<'static, Dl3000> = Branch! {b"POWer"; level!(number!("W", 200.0, watts))};
const FUNCTION: Node<'static, Dl3000> = Branch! {
    b"FUNCtion" => &both(Dl3000::set_function, |load, _| text(load.function()));
    Leaf! {b"MODE" => &both(
        Dl3000::set_mode,
        |load, _| text(MODES[load.settings.mode].trim_end_matches(char::is_lowercase)),
    )}
};
const INPUT: Node<'static, Dl3000> = Branch! {
    b"INPut" => &both(Dl3000::set_input, |load, _| bit(load.settings.input_on));
    Leaf! {b"STATe" => &both(Dl3000::set_input, |load, _| bit(load.settings.input_on))}
};
const SENSE: Node<'static, Dl3000> =
    Leaf! {b"SENSe" => &both(Dl3000::set_sense, |load, _| bit(load.settings.sense))};

const TREE: Node<'static, Dl3000> = Root! {
    Leaf! {b"*IDN" => &get(|load: &mut Dl3000, _| {
        text(format!("RIGOL TECHNOLOGIES,DL3021,{},00.01.05.00.01", load.serial_number))
    })},
    Leaf! {b"*RST" => &set(Dl3000::reset)},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    Leaf! {b"*WAI" => &set(common::ignore)},
    CURRENT, VOLTAGE, RESISTANCE, POWER, FUNCTION, INPUT, SENSE,
    Branch! {b"SOURce"; CURRENT, VOLTAGE, RESISTANCE, POWER, FUNCTION, INPUT, SENSE},
    Branch! {b"MEASure";
        measured!(b"VOLTage", |volts, _| volts),
        measured!(b"CURRent", |_, amps| amps),
        measured!(b"POWer", |volts, amps| volts * amps),
        measured!(b"RESistance", |volts, amps| if amps > 1e-3 { volts / amps } else { 15_000.0 })
    },
    Branch! {b"SYSTem";
        Leaf! {b"VERSion" => &get(|_: &mut Dl3000, _| text("1999.0"))},
        Branch! {b"ERRor" => &get(common::error_query); Leaf! {b"NEXT" => &get(common::error_query)}}
    }
};

impl HasStatus for Dl3000 {
    fn status(&mut self) -> &mut Status {
        &mut self.status
    }
}

impl scpi::Device for Dl3000 {
    fn handle_error(&mut self, error: Error) {
        self.status.push(error);
    }
}

impl Device for Dl3000 {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        let mut reply = exchange(&TREE, self, message);
        let measured = message
            .windows(4)
            .any(|word| word.eq_ignore_ascii_case(b"MEAS"));
        if measured && self.measured_end && !reply.is_empty() {
            reply.push(b'\n');
        }
        reply
    }
}
