//! Rigol DP832A three-channel supply: the channel is a keyword in the arguments, switches answer
//! `ON` and `OFF`, an error queue.
//!
//! Only channel 1 is wired to the bench; the others are open circuits. Assumed: the protections are
//! looked at at its next message, and the answers of `VAL?` and of the set-points have three
//! decimals, as `APPLy?` has.

use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{
    MockOptions,
    machine::scpi_device,
    plant::{Action, Meter, SharedPlant, SupplyState},
    spd::nearest,
    tree::{Answer, Arguments, Fallible, Span, Status, both, common, get, set, text},
    world::World,
};

const QUEUE_DEPTH: usize = 20;
const CHANNELS: usize = 3;
const NAMES: [&str; CHANNELS] = ["CH1", "CH2", "CH3"];
const RANGES: [&str; CHANNELS] = ["30V/3A", "30V/3A", "5V/3A"];
const MAX_VOLTS: [f64; CHANNELS] = [32.0, 32.0, 5.3];
const MAX_AMPS: [f64; CHANNELS] = [3.2, 3.2, 3.2];
const MAX_OVER_VOLTS: [f64; CHANNELS] = [33.0, 33.0, 5.5];
const MAX_OVER_AMPS: [f64; CHANNELS] = [3.3, 3.3, 3.3];
/// How near to its limit the current counts as limited, A.
const CC_MARGIN_A: f64 = 5e-3;

/// A protection.
#[derive(Debug, Clone, Copy)]
struct Protection {
    on: bool,
    level: f64,
    tripped: bool,
}

#[derive(Debug, Clone, Copy)]
struct Channel {
    state: SupplyState,
    over_voltage: Protection,
    over_current: Protection,
}

impl Channel {
    fn new(index: usize) -> Self {
        let idle = |level| Protection {
            on: false,
            level,
            tripped: false,
        };
        Self {
            state: SupplyState {
                output_on: false,
                voltage_v: 0.0,
                current_a: 1.0,
            },
            over_voltage: idle(MAX_OVER_VOLTS[index]),
            over_current: idle(MAX_OVER_AMPS[index]),
        }
    }
}

/// The supply.
pub(super) struct Dp832 {
    world: World,
    status: Status,
    serial_number: String,
    channels: [Channel; CHANNELS],
    selected: usize,
    /// Smallest step of voltage and current, V and A.
    step: f64,
}

impl Dp832 {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let supply = Self {
            world: World::new(plant, options.since_s),
            status: Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            serial_number: options.serial_number.clone(),
            channels: std::array::from_fn(Channel::new),
            selected: 0,
            step: options.quirks.number("step"),
        };
        supply.act();
        supply
    }

    fn act(&self) {
        self.world.act(Action::Supply(self.channels[0].state));
    }

    /// Returns the channel named by the next argument; the selected one without it.
    fn channel(&self, arguments: &mut Arguments) -> Fallible<usize> {
        if arguments.is_empty() {
            return Ok(self.selected);
        }
        // The channel may be left out (guide 2-35): then the state is the first argument.
        if arguments.begins_with(&["ON", "OFF"]) {
            return Ok(self.selected);
        }
        let name = arguments.word(&NAMES)?;
        NAMES
            .iter()
            .position(|known| *known == name)
            .ok_or_else(|| Error::new(ErrorCode::IllegalParameterValue))
    }

    fn number(&self, arguments: &mut Arguments, unit: &str, max: f64) -> Fallible<f64> {
        let value = arguments.number_in(
            unit,
            Span {
                min: 0.0,
                max,
                default: 0.0,
            },
        )?;
        Ok(nearest(self.status.bounded(value, 0.0..=max)?, self.step))
    }

    fn set_volts(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.channels[index].state.voltage_v = self.number(arguments, "V", MAX_VOLTS[index])?;
        self.act();
        Ok(())
    }

    fn set_amps(&mut self, index: usize, arguments: &mut Arguments) -> Fallible {
        self.channels[index].state.current_a = self.number(arguments, "A", MAX_AMPS[index])?;
        self.act();
        Ok(())
    }

    fn apply(&mut self, arguments: &mut Arguments) -> Fallible {
        let index = self.channel(arguments)?;
        self.selected = index;
        if !arguments.is_empty() {
            self.set_volts(index, arguments)?;
        }
        if !arguments.is_empty() {
            self.set_amps(index, arguments)?;
        }
        Ok(())
    }

    fn applied(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        let index = self.channel(arguments)?;
        let state = self.channels[index].state;
        text(format!(
            "{}:{},{:.3},{:.3}",
            NAMES[index], RANGES[index], state.voltage_v, state.current_a
        ))
    }

    fn set_output(&mut self, arguments: &mut Arguments) -> Fallible {
        let index = self.channel(arguments)?;
        let on = arguments.switch()?;
        let channel = &mut self.channels[index];
        channel.state.output_on =
            on && !channel.over_voltage.tripped && !channel.over_current.tripped;
        self.act();
        Ok(())
    }

    fn output(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        let index = self.channel(arguments)?;
        switch(self.channels[index].state.output_on)
    }

    fn set_protection(
        &mut self,
        arguments: &mut Arguments,
        of: fn(&mut Channel) -> &mut Protection,
    ) -> Fallible {
        let index = self.channel(arguments)?;
        of(&mut self.channels[index]).on = arguments.switch()?;
        Ok(())
    }

    fn protection(
        &mut self,
        arguments: &mut Arguments,
        of: fn(&mut Channel) -> &mut Protection,
    ) -> Fallible<Answer> {
        let index = self.channel(arguments)?;
        switch(of(&mut self.channels[index]).on)
    }

    fn set_level(
        &mut self,
        arguments: &mut Arguments,
        unit: &str,
        max: [f64; CHANNELS],
        of: fn(&mut Channel) -> &mut Protection,
    ) -> Fallible {
        let index = self.channel(arguments)?;
        of(&mut self.channels[index]).level = self.number(arguments, unit, max[index])?;
        Ok(())
    }

    fn level(
        &mut self,
        arguments: &mut Arguments,
        of: fn(&mut Channel) -> &mut Protection,
    ) -> Fallible<Answer> {
        let index = self.channel(arguments)?;
        text(format!("{:.3}", of(&mut self.channels[index]).level))
    }

    fn tripped(
        &mut self,
        arguments: &mut Arguments,
        of: fn(&mut Channel) -> &mut Protection,
    ) -> Fallible<Answer> {
        let index = self.channel(arguments)?;
        text(if of(&mut self.channels[index]).tripped {
            "YES"
        } else {
            "NO"
        })
    }

    fn clear(
        &mut self,
        arguments: &mut Arguments,
        of: fn(&mut Channel) -> &mut Protection,
    ) -> Fallible {
        let index = self.channel(arguments)?;
        of(&mut self.channels[index]).tripped = false;
        Ok(())
    }

    fn reading(&self, index: usize) -> (f64, f64) {
        match index {
            0 => (
                self.world.read(Meter::SupplyVolts),
                self.world.read(Meter::SupplyAmps),
            ),
            _ if self.channels[index].state.output_on => {
                (self.channels[index].state.voltage_v, 0.0)
            }
            _ => (0.0, 0.0),
        }
    }

    fn measure(
        &mut self,
        arguments: &mut Arguments,
        show: fn((f64, f64)) -> String,
    ) -> Fallible<Answer> {
        let index = self.channel(arguments)?;
        text(show(self.reading(index)))
    }

    fn mode(&mut self, arguments: &mut Arguments) -> Fallible<Answer> {
        let index = self.channel(arguments)?;
        let state = self.channels[index].state;
        text(
            if state.output_on && self.reading(index).1 >= state.current_a - CC_MARGIN_A {
                "CC"
            } else {
                "CV"
            },
        )
    }

    fn protect(&mut self) {
        let (volts, amps) = self.reading(0);
        let channel = &mut self.channels[0];
        if !channel.state.output_on {
            return;
        }
        channel.over_voltage.tripped |=
            channel.over_voltage.on && volts > channel.over_voltage.level;
        channel.over_current.tripped |=
            channel.over_current.on && amps > channel.over_current.level;
        if channel.over_voltage.tripped || channel.over_current.tripped {
            channel.state.output_on = false;
            self.act();
        }
    }

    fn select(&mut self, arguments: &mut Arguments) -> Fallible {
        self.selected = arguments.one_of_three()?;
        Ok(())
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        self.channels = std::array::from_fn(Channel::new);
        self.act();
        Ok(())
    }
}

fn switch(on: bool) -> Fallible<Answer> {
    text(if on { "ON" } else { "OFF" })
}

macro_rules! protection {
    ($name:literal, $field:ident, $unit:literal, $max:ident) => {
        Branch! {
            $name => &both(
                |supply: &mut Dp832, arguments| supply.set_protection(arguments, |channel| &mut channel.$field),
                |supply, arguments| supply.protection(arguments, |channel| &mut channel.$field),
            );
            Leaf! {b"VALue" => &both(
                |supply: &mut Dp832, arguments| supply.set_level(arguments, $unit, $max, |channel| &mut channel.$field),
                |supply, arguments| supply.level(arguments, |channel| &mut channel.$field),
            )},
            Leaf! {b"QUES" => &get(|supply: &mut Dp832, arguments| {
                supply.tripped(arguments, |channel| &mut channel.$field)
            })},
            Leaf! {b"CLEAR" => &set(|supply: &mut Dp832, arguments| {
                supply.clear(arguments, |channel| &mut channel.$field)
            })}
        }
    };
}

macro_rules! source {
    ($name:literal, $index:literal) => {
        Branch! {$name;
            Branch! {b"VOLTage" => &source!(volts $index);
                Branch! {b"LEVel" => &source!(volts $index);
                    Leaf! {b"IMMediate" => &source!(volts $index)}
                }
            },
            Branch! {b"CURRent" => &source!(amps $index);
                Branch! {b"LEVel" => &source!(amps $index);
                    Leaf! {b"IMMediate" => &source!(amps $index)}
                }
            }
        }
    };
    (volts $index:literal) => {
        both(
            |supply: &mut Dp832, arguments| supply.set_volts($index, arguments),
            |supply, arguments| {
                text(format!(
                    "{:.3}",
                    arguments.value_or_named(
                        supply.channels[$index].state.voltage_v,
                        Span {
                            min: 0.0,
                            max: MAX_VOLTS[$index],
                            default: 0.0
                        },
                    )?
                ))
            },
        )
    };
    (amps $index:literal) => {
        both(
            |supply: &mut Dp832, arguments| supply.set_amps($index, arguments),
            |supply, arguments| {
                text(format!(
                    "{:.3}",
                    arguments.value_or_named(
                        supply.channels[$index].state.current_a,
                        Span {
                            min: 0.0,
                            max: MAX_AMPS[$index],
                            default: 1.0
                        },
                    )?
                ))
            },
        )
    };
}

const TREE: Node<'static, Dp832> = Root! {
    Leaf! {b"*IDN" => &get(|supply: &mut Dp832, _| {
        text(format!("RIGOL TECHNOLOGIES,DP832,{},00.01.19", supply.serial_number))
    })},
    Leaf! {b"*RST" => &set(Dp832::reset)},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    Leaf! {b"*WAI" => &set(common::ignore)},
    source! {b"SOURce", 0},
    source! {b"SOURce1", 0},
    source! {b"SOURce2", 1},
    source! {b"SOURce3", 2},
    Leaf! {b"APPLy" => &both(Dp832::apply, Dp832::applied)},
    Branch! {b"INSTrument" => &both(Dp832::select, |supply, _| text(NAMES[supply.selected]));
        Leaf! {b"NSELect" => &both(Dp832::select, |supply, _| text((supply.selected + 1).to_string()))}
    },
    Branch! {b"OUTPut" => &both(Dp832::set_output, Dp832::output);
        Leaf! {b"STATe" => &both(Dp832::set_output, Dp832::output)},
        Leaf! {b"MODE" => &get(Dp832::mode)},
        protection! {b"OVP", over_voltage, "V", MAX_OVER_VOLTS},
        protection! {b"OCP", over_current, "A", MAX_OVER_AMPS}
    },
    Branch! {b"MEASure";
        Leaf! {b"VOLTage" => &get(|supply: &mut Dp832, arguments| {
            supply.measure(arguments, |(volts, _)| format!("{volts:.4}"))
        })},
        Leaf! {b"CURRent" => &get(|supply: &mut Dp832, arguments| {
            supply.measure(arguments, |(_, amps)| format!("{amps:.4}"))
        })},
        Leaf! {b"ALL" => &get(|supply: &mut Dp832, arguments| {
            supply.measure(arguments, |(volts, amps)| format!("{volts:.4},{amps:.4},{:.3}", volts * amps))
        })}
    },
    Branch! {b"SYSTem";
        Branch! {b"ERRor" => &get(common::error_query); Leaf! {b"NEXT" => &get(common::error_query)}},
        Leaf! {b"VERSion" => &get(|_: &mut Dp832, _| text("1999.0"))},
        Leaf! {b"REMote" => &set(common::ignore)},
        Leaf! {b"LOCal" => &set(common::ignore)}
    }
};

scpi_device!(Dp832, TREE, before protect);
