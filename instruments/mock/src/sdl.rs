//! Siglent SDL1000X DC electronic load. `[:SOURce]` is optional. The load has no error queue, so a
//! refused command is visible only in its read-back, and an unknown query gets no reply.
//!
//! Only constant current and constant power draw from the cell; the other functions can be chosen
//! and read back, but their input draws nothing. Transient, battery, list and program modes are
//! absent. Assumed: out-of-range values are clamped; over-current protection acts when its delay
//! has passed and the load gets its next message.

use std::ops::RangeInclusive;

use instruments_scpi::decode::Terminator;
use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{
    Device, MockOptions,
    plant::{Action, LoadState, Meter, SharedPlant},
    quirks::Quirks,
    tree::{Answer, Arguments, Fallible, Span, bit, both, common, exchange, fail, get, set, text},
    world::World,
};

const MAX_AMPS: f64 = 30.0;
const MAX_VOLTS: f64 = 150.0;
const FUNCTIONS: [&str; 5] = ["CURRent", "VOLTage", "POWer", "RESistance", "LED"];
/// Greatest level of constant current, voltage, power and resistance, in the order of
/// [`FUNCTIONS`].
const MAX_LEVELS: [f64; 4] = [MAX_AMPS, MAX_VOLTS, 200.0, 10e3];
const UNITS: [&str; 4] = ["A", "V", "W", "OHM"];

/// The load.
pub(super) struct Sdl {
    world: World,
    serial_number: String,
    quirks: Quirks,
    /// Something of the message in work is unknown.
    lost: bool,
    settings: Settings,
}

#[derive(Debug, Clone, Copy)]
struct Settings {
    function: &'static str,
    levels: [f64; 4],
    current_ranges: [f64; 4],
    voltage_ranges: [f64; 4],
    slew: f64,
    input_on: bool,
    on_since_s: f64,
    remote_sense: bool,
    start_volts: f64,
    latched: bool,
    /// The load may continue to sink below the start voltage, because it has started and latches.
    started: bool,
    protection_on: bool,
    protection_amps: f64,
    protection_delay_s: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            function: "CURRent",
            levels: [0.0, MAX_VOLTS, 0.0, MAX_LEVELS[3]],
            current_ranges: [MAX_AMPS; 4],
            voltage_ranges: [MAX_VOLTS; 4],
            slew: 0.5,
            input_on: false,
            on_since_s: 0.0,
            remote_sense: false,
            start_volts: 0.0,
            latched: false,
            started: false,
            protection_on: false,
            protection_amps: MAX_AMPS,
            protection_delay_s: 3.0,
        }
    }
}

impl Sdl {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let sdl = Self {
            world: World::new(plant, options.since_s),
            serial_number: options.serial_number.clone(),
            quirks: options.quirks.clone(),
            lost: false,
            settings: Settings::default(),
        };
        sdl.act();
        sdl
    }

    fn act(&self) {
        let settings = &self.settings;
        let draws = settings.function == "CURRent";
        self.world.act(Action::Load(LoadState {
            input_on: settings.input_on,
            current_a: if draws { settings.levels[0] } else { 0.0 },
            power_w: (settings.function == "POWer").then_some(settings.levels[2]),
            min_voltage_v: if settings.started {
                0.0
            } else {
                settings.start_volts
            },
        }));
    }

    fn span(&self, index: usize) -> Span {
        let max = if index == 0 {
            self.settings.current_ranges[0]
        } else {
            MAX_LEVELS[index]
        };
        Span {
            min: 0.0,
            max,
            default: Settings::default().levels[index],
        }
    }

    fn set_level(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        let span = self.span(index);
        let value = arguments.number_in(UNITS[index], span)?;
        self.settings.levels[index] = self.bounded(value, span.min..=span.max)?;
        self.act();
        Ok(())
    }

    /// The range in which `value` lies: above the lower one the upper one is taken. Only with the
    /// input off.
    fn choose_range(
        &self,
        arguments: &mut Arguments,
        unit: &str,
        lower: f64,
        upper: f64,
    ) -> Fallible<Option<f64>> {
        let value = arguments.number_in(
            unit,
            Span {
                min: lower,
                max: upper,
                default: upper,
            },
        )?;
        Ok((!self.settings.input_on).then_some(if value > lower { upper } else { lower }))
    }

    fn set_current_range(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        if let Some(range) = self.choose_range(arguments, "A", 5.0, MAX_AMPS)? {
            self.settings.current_ranges[index] = range;
            if index == 0 {
                self.settings.levels[0] = self.settings.levels[0].min(range);
                self.act();
            }
        }
        Ok(())
    }

    fn set_voltage_range(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        if let Some(range) = self.choose_range(arguments, "V", 36.0, MAX_VOLTS)? {
            self.settings.voltage_ranges[index] = range;
        }
        Ok(())
    }

    fn set_input(&mut self, arguments: &mut Arguments) -> Fallible {
        let on = arguments.switch()?;
        if on && !self.settings.input_on {
            self.settings.on_since_s = self.world.now_s;
            self.settings.started = self.settings.latched
                && self.world.read(Meter::LoadVolts) >= self.settings.start_volts;
        }
        self.settings.input_on = on;
        self.settings.started &= on;
        self.act();
        Ok(())
    }

    fn set_function(&mut self, arguments: &mut Arguments) -> Fallible {
        self.settings.function = arguments.word(&FUNCTIONS)?;
        self.act();
        Ok(())
    }

    fn set_start_volts(&mut self, arguments: &mut Arguments) -> Fallible {
        let volts = arguments.number_in(
            "V",
            Span {
                min: 0.0,
                max: MAX_VOLTS,
                default: 0.0,
            },
        )?;
        self.settings.start_volts = self.bounded(volts, 0.0..=MAX_VOLTS)?;
        self.act();
        Ok(())
    }

    fn set_latch(&mut self, arguments: &mut Arguments) -> Fallible {
        self.settings.latched = arguments.switch()?;
        self.settings.started &= self.settings.latched;
        self.act();
        Ok(())
    }

    /// Returns a plain setting between zero and `max`.
    fn clamped(&self, arguments: &mut Arguments, unit: &str, max: f64) -> Fallible<f64> {
        let value = arguments.number_in(
            unit,
            Span {
                min: 0.0,
                max,
                default: max,
            },
        )?;
        self.bounded(value, 0.0..=max)
    }

    /// Sets a number. A value out of range is clamped or leaves the setting unchanged; a value that
    /// is not a number leaves it unchanged.
    fn bounded(&self, value: f64, range: RangeInclusive<f64>) -> Fallible<f64> {
        match value {
            value if range.contains(&value) => Ok(value),
            value if value.is_finite() && self.quirks.is("clamps") => {
                Ok(value.clamp(*range.start(), *range.end()))
            }
            _ => fail(ErrorCode::DataOutOfRange),
        }
    }

    /// Long and in capitals, or short as it is set.
    fn function(&self) -> String {
        let function = self.settings.function;
        if self.quirks.is("function_word") {
            function.to_ascii_uppercase()
        } else {
            function.trim_end_matches(char::is_lowercase).to_owned()
        }
    }

    /// Switches off after an over-current that has lasted longer than the protection's delay.
    fn protect(&mut self) {
        let settings = &mut self.settings;
        let over = settings.protection_on
            && settings.function == "CURRent"
            && settings.levels[0] > settings.protection_amps;
        if over
            && settings.input_on
            && self.world.now_s - settings.on_since_s >= settings.protection_delay_s
        {
            settings.input_on = false;
            settings.started = false;
            self.act();
        }
    }

    fn measure(&self, what: Quantity) -> Fallible<Answer> {
        let amps = self.world.read(Meter::LoadAmps);
        let volts = self.world.read(Meter::LoadVolts) - self.drop_v(amps);
        text(fixed(match what {
            Quantity::Volts => volts,
            Quantity::Amps => amps,
            Quantity::Watts => volts * amps,
            Quantity::Ohms if amps > 1e-3 => volts / amps,
            Quantity::Ohms => MAX_LEVELS[3],
        }))
    }

    /// Returns the drop of the leads, which only remote sense leaves out, V.
    fn drop_v(&self, amps: f64) -> f64 {
        if self.settings.remote_sense {
            0.0
        } else {
            self.quirks.number("lead_ohm") * amps
        }
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        self.settings = Settings::default();
        self.act();
        Ok(())
    }
}

#[derive(Debug, Clone, Copy)]
enum Quantity {
    Volts,
    Amps,
    Watts,
    Ohms,
}

fn fixed(value: f64) -> String {
    format!("{value:.6}")
}

macro_rules! level {
    ($index:literal) => {
        &both(
            |sdl: &mut Sdl, arguments| sdl.set_level($index, arguments),
            |sdl, arguments| {
                text(fixed(arguments.value_or_named(
                    sdl.settings.levels[$index],
                    sdl.span($index),
                )?))
            },
        )
    };
}

macro_rules! function {
    ($name:literal, $index:literal $(, level $level:expr)? $(; $($more:expr),+)?) => {
        Branch! {$name => level!($index);
            Branch! {b"LEVel" => level!($index); Leaf! {b"IMMediate" => level!($index)} $(, $level)?},
            Leaf! {b"IRANGe" => &both(
                |sdl: &mut Sdl, arguments| sdl.set_current_range($index, arguments),
                |sdl, _| text(format!("{}", sdl.settings.current_ranges[$index])),
            )},
            Leaf! {b"VRANGe" => &both(
                |sdl: &mut Sdl, arguments| sdl.set_voltage_range($index, arguments),
                |sdl, _| text(format!("{}", sdl.settings.voltage_ranges[$index])),
            )}
            $($(, $more)+)?
        }
    };
}

macro_rules! clamped {
    ($field:ident, $unit:literal, $max:expr) => {
        &both(
            |sdl: &mut Sdl, arguments| {
                sdl.settings.$field = sdl.clamped(arguments, $unit, $max)?;
                Ok(())
            },
            |sdl, _| text(fixed(sdl.settings.$field)),
        )
    };
}

const CURRENT: Node<'static, Sdl> = function! {b"CURRent", 0;
    Branch! {b"SLEW" => clamped!(slew, "A/US", 2.5); Leaf! {b"BOTH" => clamped!(slew, "A/US", 2.5)}},
    Branch! {b"PROTection";
        Leaf! {b"STATe" => &both(
            |sdl: &mut Sdl, arguments| { sdl.settings.protection_on = arguments.switch()?; Ok(()) },
            |sdl, _| bit(sdl.settings.protection_on),
        )},
        Leaf! {b"LEVel" => clamped!(protection_amps, "A", MAX_AMPS)},
        Leaf! {b"DELay" => clamped!(protection_delay_s, "S", 60.0)}
    }
};
const VOLTAGE: Node<'static, Sdl> = function! {b"VOLTage", 1,
    level Leaf! {b"ON" => &both(Sdl::set_start_volts, |sdl, _| text(fixed(sdl.settings.start_volts)))};
    Leaf! {b"LATCh" => &both(Sdl::set_latch, |sdl, _| bit(sdl.settings.latched))}
};
const POWER: Node<'static, Sdl> = function! {b"POWer", 2};
const RESISTANCE: Node<'static, Sdl> = function! {b"RESistance", 3};
const FUNCTION: Node<'static, Sdl> = Branch! {
    b"FUNCtion" => &both(Sdl::set_function, |sdl, _| text(sdl.function()));
    Leaf! {b"MODE" => &get(|_: &mut Sdl, _| text("BASIC"))}
};
const INPUT: Node<'static, Sdl> = Branch! {
    b"INPut" => &both(Sdl::set_input, |sdl, _| bit(sdl.settings.input_on));
    Leaf! {b"STATe" => &both(Sdl::set_input, |sdl, _| bit(sdl.settings.input_on))}
};

const TREE: Node<'static, Sdl> = Root! {
    Leaf! {b"*IDN" => &get(|sdl: &mut Sdl, _| {
        text(format!("Siglent Technologies,SDL1020X-E,{},1.1.1.22", sdl.serial_number))
    })},
    Leaf! {b"*RST" => &set(Sdl::reset)},
    Leaf! {b"*CLS" => &set(common::ignore)},
    Leaf! {b"*OPC" => &both(common::ignore, common::opc_query)},
    Leaf! {b"*ESR" => &get(|_: &mut Sdl, _| text("0"))},
    CURRENT, VOLTAGE, POWER, RESISTANCE, FUNCTION, INPUT,
    Branch! {b"SOURce"; CURRENT, VOLTAGE, POWER, RESISTANCE, FUNCTION, INPUT},
    Branch! {b"MEASure";
        Branch! {b"VOLTage" => &get(|sdl: &mut Sdl, _| sdl.measure(Quantity::Volts));
            Leaf! {b"DC" => &get(|sdl: &mut Sdl, _| sdl.measure(Quantity::Volts))}
        },
        Branch! {b"CURRent" => &get(|sdl: &mut Sdl, _| sdl.measure(Quantity::Amps));
            Leaf! {b"DC" => &get(|sdl: &mut Sdl, _| sdl.measure(Quantity::Amps))}
        },
        Branch! {b"POWer" => &get(|sdl: &mut Sdl, _| sdl.measure(Quantity::Watts));
            Leaf! {b"DC" => &get(|sdl: &mut Sdl, _| sdl.measure(Quantity::Watts))}
        },
        Branch! {b"RESistance" => &get(|sdl: &mut Sdl, _| sdl.measure(Quantity::Ohms));
            Leaf! {b"DC" => &get(|sdl: &mut Sdl, _| sdl.measure(Quantity::Ohms))}
        }
    },
    Branch! {b"SYSTem";
        Branch! {b"SENSe" => &both(
            |sdl: &mut Sdl, arguments| { sdl.settings.remote_sense = arguments.switch()?; Ok(()) },
            |sdl, _| bit(sdl.settings.remote_sense),
        ); Leaf! {b"STATe" => &both(
            |sdl: &mut Sdl, arguments| { sdl.settings.remote_sense = arguments.switch()?; Ok(()) },
            |sdl, _| bit(sdl.settings.remote_sense),
        )}},
        Branch! {b"REMOTE"; Leaf! {b"STATe" => &set(|_: &mut Sdl, arguments| arguments.switch().map(|_| ()))}}
    }
};

impl scpi::Device for Sdl {
    fn handle_error(&mut self, error: Error) {
        self.lost |= error == ErrorCode::UndefinedHeader;
    }
}

impl Device for Sdl {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        self.protect();
        self.lost = false;
        let reply = exchange(&TREE, self, message);
        let stars = self.lost && message.contains(&b'?') && self.quirks.word("unknown") == "stars";
        if stars {
            b"**ERROR**\n".to_vec()
        } else {
            reply
        }
    }
}
