//! Siglent SPD3303X three-channel supply. Its output can be switched but not queried: the state is
//! a bit of `SYST:STAT?`.
//!
//! Only channel 1 is wired to the bench; channel 2 is an open circuit, channel 3 can only be
//! switched. Assumed: out-of-range values are clamped, and the error reply has the form of its
//! `0 No Error` with the numbers of the standard.

use scpi::{Branch, Leaf, Root, error::ErrorCode, tree::Node};

use super::{
    MockOptions,
    machine::scpi_device,
    plant::{Action, Meter, SharedPlant, SupplyState},
    tree::{Answer, Arguments, Fallible, Span, Status, both, common, fail, get, set, text},
    world::World,
};

const VOLT_SPAN: Span = Span {
    min: 0.0,
    max: 32.0,
    default: 0.0,
};
const AMP_SPAN: Span = Span {
    min: 0.0,
    max: 3.2,
    default: 0.0,
};
const QUEUE_DEPTH: usize = 10;
/// How near to its limit the current counts as limited, A.
const CC_MARGIN_A: f64 = 5e-3;

/// The supply.
pub(super) struct Spd {
    world: World,
    status: Status,
    serial_number: String,
    channels: [SupplyState; 2],
    selected: usize,
    tracking: u16,
    /// Smallest step of voltage and current, V and A.
    step: f64,
}

impl Spd {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let spd = Self {
            world: World::new(plant, options.since_s),
            status: Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            serial_number: options.serial_number.clone(),
            channels: [SupplyState::default(); 2],
            selected: 0,
            tracking: 0,
            step: options.quirks.number("step"),
        };
        spd.act();
        spd
    }

    fn act(&self) {
        self.world.act(Action::Supply(self.channels[0]));
    }

    /// Returns the channel named by the next argument, 0 to 2.
    fn channel(arguments: &mut Arguments) -> Fallible<usize> {
        Ok(match arguments.word(&["CH1", "CH2", "CH3"])? {
            "CH1" => 0,
            "CH2" => 1,
            _ => 2,
        })
    }

    /// One of the two adjustable channels; the selected one without an argument.
    fn measured_channel(&self, arguments: &mut Arguments) -> Fallible<usize> {
        if arguments.is_empty() {
            return Ok(self.selected);
        }
        match Self::channel(arguments)? {
            2 => fail(ErrorCode::IllegalParameterValue),
            index => Ok(index),
        }
    }

    fn set_volts(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.channels[index].voltage_v = self.status.bounded(
            arguments.number_in("V", VOLT_SPAN)?,
            VOLT_SPAN.min..=VOLT_SPAN.max,
        )?;
        self.channels[index].voltage_v = nearest(self.channels[index].voltage_v, self.step);
        self.act();
        Ok(())
    }

    fn set_amps(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.channels[index].current_a = self.status.bounded(
            arguments.number_in("A", AMP_SPAN)?,
            AMP_SPAN.min..=AMP_SPAN.max,
        )?;
        self.channels[index].current_a = nearest(self.channels[index].current_a, self.step);
        self.act();
        Ok(())
    }

    fn set_output(&mut self, arguments: &mut Arguments) -> Fallible {
        let index = Self::channel(arguments)?;
        let on = arguments.switch()?;
        if let Some(channel) = self.channels.get_mut(index) {
            channel.output_on = on;
        }
        self.act();
        Ok(())
    }

    fn select(&mut self, arguments: &mut Arguments) -> Fallible {
        self.selected = Self::channel(arguments)?.min(1);
        Ok(())
    }

    fn set_tracking(&mut self, arguments: &mut Arguments) -> Fallible {
        self.tracking = match arguments.word(&["0", "1", "2"])? {
            "0" => 0,
            "1" => 1,
            _ => 2,
        };
        Ok(())
    }

    fn reading(&self, index: usize) -> (f64, f64) {
        match index {
            0 => (
                self.world.read(Meter::SupplyVolts),
                self.world.read(Meter::SupplyAmps),
            ),
            _ if self.channels[1].output_on => (self.channels[1].voltage_v, 0.0),
            _ => (0.0, 0.0),
        }
    }

    fn measure_volts(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        let index = self.measured_channel(arguments)?;
        fixed(self.reading(index).0)
    }

    fn measure_amps(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        let index = self.measured_channel(arguments)?;
        fixed(self.reading(index).1)
    }

    fn measure_watts(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        let index = self.measured_channel(arguments)?;
        let (volts, amps) = self.reading(index);
        fixed(volts * amps)
    }

    /// Returns the hexadecimal status word: constant current in bits 0 and 1, tracking in 2 and 3,
    /// outputs in 4 and 5.
    fn state(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        let mut word = match self.tracking {
            0 => 0b01 << 2,
            1 => 0b11 << 2,
            _ => 0b10 << 2,
        };
        for (index, channel) in self.channels.iter().enumerate() {
            let limited =
                self.reading(index).1 >= channel.current_a - CC_MARGIN_A && channel.current_a > 0.0;
            if channel.output_on {
                word |= 1 << (4 + index);
            }
            if channel.output_on && limited {
                word |= 1 << index;
            }
        }
        text(format!("0x{word:04x}"))
    }

    fn error(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        text(self.status.pop().map_or_else(
            || "0  No Error".to_owned(),
            |error| {
                format!(
                    "{}  {}",
                    error.get_code(),
                    String::from_utf8_lossy(error.get_message())
                )
            },
        ))
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        self.channels = [SupplyState::default(); 2];
        self.act();
        Ok(())
    }
}

/// Rounds to the nearest step.
pub(super) fn nearest(value: f64, step: f64) -> f64 {
    if step > 0.0 {
        (value / step).round() * step
    } else {
        value
    }
}

fn fixed(value: f64) -> Fallible<Answer> {
    text(format!("{value:.3}"))
}

macro_rules! channel {
    ($name:literal, $index:literal) => {
        Branch! {$name;
            Leaf! {b"VOLTage" => &both(
                |spd: &mut Spd, arguments| spd.set_volts($index, arguments),
                |spd, _| fixed(spd.channels[$index].voltage_v),
            )},
            Leaf! {b"CURRent" => &both(
                |spd: &mut Spd, arguments| spd.set_amps($index, arguments),
                |spd, _| fixed(spd.channels[$index].current_a),
            )}
        }
    };
}

const TREE: Node<'static, Spd> = Root! {
    Leaf! {b"*IDN" => &get(|spd: &mut Spd, _| {
        text(format!("Siglent Technologies,SPD3303X,{},1.01.01.02.07R2,V3.0", spd.serial_number))
    })},
    Leaf! {b"*RST" => &set(Spd::reset)},
    Leaf! {b"*LOCK" => &set(common::ignore)},
    Leaf! {b"*UNLOCK" => &set(common::ignore)},
    channel! {b"CH1", 0},
    channel! {b"CH2", 1},
    Leaf! {b"INSTrument" => &both(Spd::select, |spd, _| text(if spd.selected == 0 { "CH1" } else { "CH2" }))},
    Branch! {b"OUTPut" => &set(Spd::set_output); Leaf! {b"TRACK" => &set(Spd::set_tracking)}},
    Branch! {b"MEASure";
        Leaf! {b"VOLTage" => &get(Spd::measure_volts)},
        Leaf! {b"CURRent" => &get(Spd::measure_amps)},
        Leaf! {b"POWEr" => &get(Spd::measure_watts)}
    },
    Branch! {b"SYSTem";
        Leaf! {b"STATus" => &get(Spd::state)},
        Leaf! {b"ERRor" => &get(Spd::error)},
        Leaf! {b"VERSion" => &get(|_: &mut Spd, _| text("1.01.01.02.07R2"))}
    }
};

scpi_device!(Spd, TREE);
