//! Keysight E36312A three-channel supply: channel lists, an error queue, protections that latch
//! until they are cleared.
//!
//! Only channel 1 is wired to the bench; the others are open circuits. Assumed: the protections are
//! looked at at its next message; their delays are not simulated.

use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{
    MockOptions,
    machine::scpi_device,
    number::signed_nr3,
    plant::{Action, Meter, SharedPlant, SupplyState},
    tree::{Answer, Arguments, Fallible, Span, Status, both, common, get, set, text},
    world::World,
};

const QUEUE_DEPTH: usize = 20;
const CHANNELS: usize = 3;
/// Greatest voltage, current and over-voltage level of each channel.
const MAX_VOLTS: [f64; CHANNELS] = [6.18, 25.75, 25.75];
const MAX_AMPS: [f64; CHANNELS] = [5.15, 1.03, 1.03];
const MAX_PROTECTION_V: [f64; CHANNELS] = [6.6, 27.5, 27.5];
/// How near to its limit the current counts as limited, A.
const CC_MARGIN_A: f64 = 5e-3;

#[derive(Debug, Clone, Copy)]
struct Channel {
    state: SupplyState,
    protection_v: f64,
    protects_current: bool,
    external_sense: bool,
    over_voltage: bool,
    over_current: bool,
}

impl Channel {
    fn new(index: usize) -> Self {
        Self {
            state: SupplyState {
                output_on: false,
                voltage_v: 0.0,
                current_a: MAX_AMPS[index],
            },
            protection_v: MAX_PROTECTION_V[index],
            protects_current: false,
            external_sense: false,
            over_voltage: false,
            over_current: false,
        }
    }
}

/// The supply.
pub(super) struct Keysight {
    world: World,
    status: Status,
    serial_number: String,
    channels: [Channel; CHANNELS],
    selected: usize,
}

impl Keysight {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        let supply = Self {
            world: World::new(plant, options.since_s),
            status: Status::new(QUEUE_DEPTH).quirky(&options.quirks),
            serial_number: options.serial_number.clone(),
            channels: std::array::from_fn(Channel::new),
            selected: 0,
        };
        supply.act();
        supply
    }

    fn act(&self) {
        self.world.act(Action::Supply(self.channels[0].state));
    }

    /// Returns the channels of the list that comes next; the selected one without a list.
    fn list(&self, arguments: &mut Arguments) -> Fallible<Vec<usize>> {
        if arguments.is_empty() {
            return Ok(vec![self.selected]);
        }
        let listed = arguments.channels()?;
        let index = |channel: &u16| {
            usize::from(*channel)
                .checked_sub(1)
                .filter(|index| *index < CHANNELS)
        };
        listed
            .iter()
            .map(index)
            .collect::<Option<_>>()
            .ok_or_else(|| Error::new(ErrorCode::DataOutOfRange))
    }

    fn set_number(
        &mut self,
        arguments: &mut Arguments,
        unit: &str,
        max: [f64; CHANNELS],
        field: fn(&mut Channel) -> &mut f64,
    ) -> Fallible {
        // The keyword MAX depends on the channel, which comes behind it.
        let value = arguments.number_in(
            unit,
            Span {
                min: 0.0,
                max: f64::INFINITY,
                default: 0.0,
            },
        )?;
        for index in self.list(arguments)? {
            let value = if value == f64::INFINITY {
                max[index]
            } else {
                value
            };
            *field(&mut self.channels[index]) = self.status.bounded(value, 0.0..=max[index])?;
        }
        self.act();
        Ok(())
    }

    fn set_switch(
        &mut self,
        arguments: &mut Arguments,
        field: fn(&mut Channel) -> &mut bool,
    ) -> Fallible {
        let on = arguments.switch()?;
        for index in self.list(arguments)? {
            *field(&mut self.channels[index]) = on;
        }
        self.act();
        Ok(())
    }

    fn set_output(&mut self, arguments: &mut Arguments) -> Fallible {
        let on = arguments.switch()?;
        for index in self.list(arguments)? {
            let channel = &mut self.channels[index];
            // A protection that has tripped keeps the output off until it is cleared.
            channel.state.output_on = on && !channel.over_voltage && !channel.over_current;
        }
        self.act();
        Ok(())
    }

    fn set_sense(&mut self, arguments: &mut Arguments) -> Fallible {
        let external = arguments.word(&["INTernal", "EXTernal"])? == "EXTernal";
        for index in self.list(arguments)? {
            self.channels[index].external_sense = external;
        }
        Ok(())
    }

    fn clear(&mut self, arguments: &mut Arguments) -> Fallible {
        for index in self.list(arguments)? {
            (
                self.channels[index].over_voltage,
                self.channels[index].over_current,
            ) = (false, false);
        }
        Ok(())
    }

    fn select(&mut self, arguments: &mut Arguments) -> Fallible {
        self.selected = arguments.one_of_three()?;
        Ok(())
    }

    /// One field for each channel of the list.
    fn each(
        &self,
        arguments: &mut Arguments,
        field: impl Fn(usize, &Channel) -> String,
    ) -> Fallible<Answer> {
        let fields: Vec<String> = self
            .list(arguments)?
            .into_iter()
            .map(|index| field(index, &self.channels[index]))
            .collect();
        text(fields.join(","))
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

    fn limited(&self, index: usize) -> bool {
        let state = self.channels[index].state;
        state.output_on && self.reading(index).1 >= state.current_a - CC_MARGIN_A
    }

    fn protect(&mut self) {
        let (over_voltage, limited) = (
            self.reading(0).0 > self.channels[0].protection_v,
            self.limited(0),
        );
        let channel = &mut self.channels[0];
        if !channel.state.output_on {
            return;
        }
        channel.over_voltage |= over_voltage;
        channel.over_current |= limited && channel.protects_current;
        if channel.over_voltage || channel.over_current {
            channel.state.output_on = false;
            self.act();
        }
    }

    /// Bits 0 and 1: 01 constant current, 10 constant voltage, 00 off.
    fn condition(&self, index: usize) -> Fallible<Answer> {
        text(
            match (self.channels[index].state.output_on, self.limited(index)) {
                (false, _) => "0",
                (true, true) => "1",
                (true, false) => "2",
            },
        )
    }

    fn reset(&mut self, _: &mut Arguments) -> Fallible {
        self.channels = std::array::from_fn(Channel::new);
        self.act();
        Ok(())
    }
}

fn bit(on: bool) -> String {
    u8::from(on).to_string()
}

macro_rules! number {
    ($unit:literal, $max:ident, $($field:ident).+) => {
        &both(
            |supply: &mut Keysight, arguments| {
                supply.set_number(arguments, $unit, $max, |channel| &mut channel.$($field).+)
            },
            |supply, arguments| supply.each(arguments, |_, channel| signed_nr3(channel.$($field).+)),
        )
    };
}

macro_rules! tripped {
    ($field:ident) => {
        &get(|supply: &mut Keysight, arguments| {
            supply.each(arguments, |_, channel| bit(channel.$field))
        })
    };
}

const VOLTAGE: Node<'static, Keysight> = Branch! {
    b"VOLTage" => number!("V", MAX_VOLTS, state.voltage_v);
    Branch! {b"PROTection" => number!("V", MAX_PROTECTION_V, protection_v);
        Leaf! {b"TRIPped" => tripped!(over_voltage)}
    },
    Branch! {b"SENSe"; Leaf! {b"SOURce" => &both(
        Keysight::set_sense,
        |supply, arguments| supply.each(arguments, |_, channel| {
            (if channel.external_sense { "EXT" } else { "INT" }).to_owned()
        }),
    )}}
};

const CURRENT: Node<'static, Keysight> = Branch! {
    b"CURRent" => number!("A", MAX_AMPS, state.current_a);
    Branch! {b"PROTection";
        Leaf! {b"STATe" => &both(
            |supply: &mut Keysight, arguments| supply.set_switch(arguments, |channel| &mut channel.protects_current),
            |supply, arguments| supply.each(arguments, |_, channel| bit(channel.protects_current)),
        )},
        Leaf! {b"TRIPped" => tripped!(over_current)}
    }
};

const TREE: Node<'static, Keysight> = Root! {
    Leaf! {b"*IDN" => &get(|supply: &mut Keysight, _| text(format!("Keysight \
    Technologies,E36312A,{},1.0.3-1.0.0-1.02", supply.serial_number)))},
    Leaf! {b"*RST" => &set(Keysight::reset)},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    VOLTAGE, CURRENT,
    Branch! {b"SOURce"; VOLTAGE, CURRENT},
    Branch! {b"OUTPut" => &both(
            Keysight::set_output,
            |supply, arguments| supply.each(arguments, |_, channel| bit(channel.state.output_on)),
        );
        Branch! {b"PROTection"; Leaf! {b"CLEar" => &set(Keysight::clear)}}
    },
    Branch! {b"INSTrument";
        Leaf! {b"NSELect" => &both(Keysight::select, |supply, _| text((supply.selected + 1).to_string()))},
        Leaf! {b"SELect" => &both(Keysight::select, |supply, _| text(format!("CH{}", supply.selected + 1)))}
    },
    Branch! {b"MEASure";
        Leaf! {b"VOLTage" => &get(|supply: &mut Keysight, arguments| {
            supply.each(arguments, |index, _| signed_nr3(supply.reading(index).0))
        })},
        Leaf! {b"CURRent" => &get(|supply: &mut Keysight, arguments| {
            supply.each(arguments, |index, _| signed_nr3(supply.reading(index).1))
        })}
    },
    Branch! {b"STATus"; Branch! {b"QUEStionable"; Branch! {b"INSTrument";
        Branch! {b"ISUMmary1"; Leaf! {b"CONDition" => &get(|supply: &mut Keysight, _| supply.condition(0))}},
        Branch! {b"ISUMmary2"; Leaf! {b"CONDition" => &get(|supply: &mut Keysight, _| supply.condition(1))}},
        Branch! {b"ISUMmary3"; Leaf! {b"CONDition" => &get(|supply: &mut Keysight, _| supply.condition(2))}}
    }}},
    Branch! {b"SYSTem";
        Branch! {b"ERRor" => &get(common::signed_error_query); Leaf! {b"NEXT" => &get(common::signed_error_query)}},
        Leaf! {b"VERSion" => &get(|_: &mut Keysight, _| text("1999.0"))},
        Leaf! {b"REMote" => &set(common::ignore)},
        Leaf! {b"LOCal" => &set(common::ignore)}
    }
};

scpi_device!(Keysight, TREE, before protect);
