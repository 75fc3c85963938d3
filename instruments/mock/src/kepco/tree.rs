//! The command tree of a Kepco BOP.

use instruments_scpi::decode::Terminator;
use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{Bounds, Channel, Kepco, LONGEST_MESSAGE, Side, Which, truncated};
use crate::{
    Device,
    number::short_nr3,
    plant::Meter,
    tree::{
        Answer, Argument, Arguments, Fallible, Span, bit, both, common, exchange, fail, get, set,
        text, to_number,
    },
};

const UNIT: [&str; 2] = ["V", "A"];

/// Returns a number that first loses digits as the unit's own reader does it.
fn number(arguments: &mut Arguments, channel: Channel, span: Span) -> Fallible<f64> {
    match arguments.next() {
        None => fail(ErrorCode::MissingParameter),
        Some(Argument::Number { digits, suffix }) => to_number(
            &Argument::Number {
                digits: truncated(&digits),
                suffix,
            },
            UNIT[channel as usize],
        ),
        Some(Argument::Word(word))
            if word.eq_ignore_ascii_case("MAX") || word.eq_ignore_ascii_case("MAXIMUM") =>
        {
            Ok(span.max)
        }
        Some(Argument::Word(word))
            if word.eq_ignore_ascii_case("MIN") || word.eq_ignore_ascii_case("MINIMUM") =>
        {
            Ok(span.min)
        }
        Some(_) => fail(ErrorCode::NumericDataError),
    }
}

fn set_level(kepco: &mut Kepco, arguments: &mut Arguments, channel: Channel) -> Fallible {
    let value = number(arguments, channel, kepco.span(channel))?;
    kepco.set_level(channel, value)
}

fn get_level(kepco: &Kepco, arguments: &mut Arguments, channel: Channel) -> Fallible<Answer> {
    text(short_nr3(arguments.value_or_named(
        kepco.settings.level[channel as usize],
        kepco.span(channel),
    )?))
}

fn set_bounds(kepco: &mut Kepco, arguments: &mut Arguments, which: Which, side: Side) -> Fallible {
    let rated = super::rated(kepco.family)[which.channel() as usize];
    let value = number(
        arguments,
        which.channel(),
        Span {
            min: 0.0,
            max: rated,
            default: rated,
        },
    )?;
    kepco.set_bounds(which, side, value)
}

fn get_bounds(kepco: &mut Kepco, which: Which, side: Side) -> Fallible<Answer> {
    let Bounds { positive, negative } = *kepco.bounds_mut(which);
    text(match side {
        Side::Both => format!("{}, {}", short_nr3(positive), short_nr3(-negative)),
        Side::Positive => short_nr3(positive),
        Side::Negative => short_nr3(-negative),
    })
}

/// The source of the main channel's command.
fn set_source(kepco: &mut Kepco, arguments: &mut Arguments) -> Fallible {
    kepco.switching_only()?;
    match arguments.word(&["FIXed", "EXTernal", "GAIN", "LIST", "TRANsient"])? {
        "FIXed" => kepco.settings.external = false,
        "EXTernal" => kepco.settings.external = true,
        // No list or transient can be loaded here, and the analog gain is not simulated.
        _ => return fail(ErrorCode::SettingsConflict),
    }
    kepco.act();
    Ok(())
}

fn get_source(kepco: &mut Kepco, _: &mut Arguments) -> Fallible<Answer> {
    kepco.switching_only()?;
    text(if kepco.settings.external {
        "EXT"
    } else {
        "FIX"
    })
}

fn set_protection_mode(kepco: &mut Kepco, arguments: &mut Arguments, channel: Channel) -> Fallible {
    kepco.switching_only()?;
    kepco.settings.protection_modes[channel as usize] =
        match arguments.word(&["FIXed", "EXTernal", "LESS"])? {
            "EXTernal" => "EXTERNAL",
            "LESS" => "LESS",
            _ => "FIXED",
        };
    Ok(())
}

fn set_mode(kepco: &mut Kepco, arguments: &mut Arguments) -> Fallible {
    kepco.settings.mode = match arguments.word(&["VOLTage", "CURRent"])? {
        "VOLTage" => Channel::Voltage,
        _ => Channel::Current,
    };
    kepco.act();
    Ok(())
}

/// `1` for a current, where `CURR` sets it.
fn get_mode(kepco: &mut Kepco, _: &mut Arguments) -> Fallible<Answer> {
    text(match (kepco.settings.mode, kepco.function_word) {
        (Channel::Current, true) => "1",
        (Channel::Voltage, true) => "0",
        (Channel::Current, false) => "CURR",
        (Channel::Voltage, false) => "VOLT",
    })
}

fn set_output(kepco: &mut Kepco, arguments: &mut Arguments) -> Fallible {
    let on = arguments.switch()?;
    if matches!(kepco.settings.pin_mode, "HIGH" | "LOW") {
        // The remote pin takes precedence.
        return fail(ErrorCode::SettingsConflict);
    }
    kepco.settings.output_on = on;
    kepco.act();
    Ok(())
}

fn set_off_mode(kepco: &mut Kepco, arguments: &mut Arguments) -> Fallible {
    kepco.switching_only()?;
    kepco.settings.off_mode = match arguments.word(&["ACTive", "RESistive", "BATTery"])? {
        "ACTive" => "ACTIVE",
        "RESistive" => "RESISTIVE",
        _ => "BATTERY",
    };
    kepco.act();
    Ok(())
}

fn set_pin_mode(kepco: &mut Kepco, arguments: &mut Arguments) -> Fallible {
    kepco.switching_only()?;
    kepco.settings.pin_mode = match arguments.word(&["HIGH", "LOW", "STANdby", "OFF"])? {
        "HIGH" => "HIGH",
        "LOW" => "LOW",
        "STANdby" => "STAN",
        _ => "OFF",
    };
    Ok(())
}

fn measure(kepco: &Kepco, meter: Meter) -> Fallible<Answer> {
    text(short_nr3(kepco.world.read(meter)))
}

fn reset(kepco: &mut Kepco, _: &mut Arguments) -> Fallible {
    kepco.reset();
    Ok(())
}

fn set_remote(k: &mut Kepco, arguments: &mut Arguments) -> Fallible {
    k.settings.remote = arguments.switch()?;
    Ok(())
}

/// The only supported operation of this memory is to store the limits.
fn update_memory(_: &mut Kepco, arguments: &mut Arguments) -> Fallible {
    arguments
        .word(&["LIMit"])
        .map(|_| ())
        .map_err(|_| Error::new(ErrorCode::IllegalParameterValue))
}

/// `LIMit` or `PROTection` with its sides; a default leaf comes first.
macro_rules! bounds {
    ($name:literal, $which:expr; $($more:expr),*) => {
        Branch! {$name => &both(|k, a| set_bounds(k, a, $which, Side::Both), |k, _| get_bounds(k, $which, Side::Both));
            Leaf! {b"BOTH" => &both(
                |k, a| set_bounds(k, a, $which, Side::Both),
                |k, _| get_bounds(k, $which, Side::Both),
            )},
            Leaf! {b"POSitive" => &both(
                |k, a| set_bounds(k, a, $which, Side::Positive),
                |k, _| get_bounds(k, $which, Side::Positive),
            )},
            Leaf! {b"NEGative" => &both(
                |k, a| set_bounds(k, a, $which, Side::Negative),
                |k, _| get_bounds(k, $which, Side::Negative),
            )}
            $(, $more)*
        }
    };
}

macro_rules! level {
    ($name:literal, $channel:expr) => {
        Branch! {$name => &both(|k, a| set_level(k, a, $channel), |k, a| get_level(k, a, $channel));
            Branch! {b"LEVel" => &both(|k, a| set_level(k, a, $channel), |k, a| get_level(k, a, $channel));
                Branch! {b"IMMediate" => &both(|k, a| set_level(k, a, $channel), |k, a| get_level(k, a, $channel));
                    Leaf! {b"AMPLitude" => &both(|k, a| set_level(k, a, $channel), |k, a| get_level(k, a, $channel))}
                }
            },
            Leaf! {b"MODE" => &both(set_source, get_source)},
            bounds! {b"LIMit", Which::Limit($channel);},
            bounds! {b"PROTection", Which::Protection($channel);
                Leaf! {b"MODE" => &both(
                    |k, a| set_protection_mode(k, a, $channel),
                    |k, _| text(k.settings.protection_modes[$channel as usize]),
                )}
            }
        }
    };
}

const VOLTAGE: Node<'static, Kepco> = level!(b"VOLTage", Channel::Voltage);
const CURRENT: Node<'static, Kepco> = level!(b"CURRent", Channel::Current);
const FUNCTION: Node<'static, Kepco> =
    Branch! {b"FUNCtion"; Leaf! {b"MODE" => &both(set_mode, get_mode)}};

const MEASURE_VOLTAGE: Node<'static, Kepco> = Branch! {b"VOLTage" => &get(|k, _| measure(k, Meter::BipolarVolts));
Leaf! {b"DC" => &get(|k, _| measure(k, Meter::BipolarVolts))}};
const MEASURE_CURRENT: Node<'static, Kepco> = Branch! {b"CURRent" => &get(|k, _| measure(k, Meter::BipolarAmps));
Leaf! {b"DC" => &get(|k, _| measure(k, Meter::BipolarAmps))}};

const REGISTER: &[Node<'static, Kepco>] = &[
    Leaf! {default b"EVENt" => &get(|_, _| text("0"))},
    Leaf! {b"CONDition" => &get(|_, _| text("0"))},
    Leaf! {b"ENABle" => &both(common::ignore, |_: &mut Kepco, _| text("0"))},
];

pub(super) const TREE: Node<'static, Kepco> = Root! {
    Leaf! {b"*IDN" => &get(|k: &mut Kepco, _| text(k.identity()))},
    Leaf! {b"*RST" => &set(reset)},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*WAI" => &set(common::ignore)},
    Leaf! {b"*TST" => &get(|_, _| text("0"))},
    VOLTAGE,
    CURRENT,
    FUNCTION,
    Branch! {b"SOURce"; VOLTAGE, CURRENT, FUNCTION},
    Branch! {b"OUTPut" => &both(set_output, |k, _| text(if k.settings.output_on { "1" } else { "0" }));
        Leaf! {b"STATe" => &both(set_output, |k, _| text(if k.settings.output_on { "1" } else { "0" }))},
        Leaf! {b"MODE" => &both(set_off_mode, |k, _| { k.switching_only()?; text(k.settings.off_mode) })},
        Leaf! {b"CONTrol" => &both(set_pin_mode, |k, _| { k.switching_only()?; text(k.settings.pin_mode) })}
    },
    Branch! {b"MEASure"; MEASURE_VOLTAGE, MEASURE_CURRENT, Branch! {b"SCALar"; MEASURE_VOLTAGE, MEASURE_CURRENT}},
    Branch! {b"MEMory"; Leaf! {b"UPDate" => &set(update_memory)}},
    Branch! {b"STATus";
        Leaf! {b"PRESet" => &set(common::ignore)},
        Node::Branch { name: b"OPERation", default: false, sub: REGISTER },
        Node::Branch { name: b"QUEStionable", default: false, sub: REGISTER }
    },
    Branch! {b"SYSTem";
        Branch! {b"ERRor" => &get(common::error_query); Leaf! {b"NEXT" => &get(common::error_query)}},
        Leaf! {b"VERSion" => &get(|_: &mut Kepco, _| text("1997.0"))},
        Branch! {b"REMote" => &both(set_remote, |k, _| bit(k.settings.remote));
            Leaf! {b"STATe" => &both(set_remote, |k, _| bit(k.settings.remote))}
        }
    }
};

impl scpi::Device for Kepco {
    fn handle_error(&mut self, error: Error) {
        // Only the number and its text are queued, without the detail that the parser adds.
        self.status
            .push(Error::custom(error.get_code(), error.get_message()));
    }
}

impl Device for Kepco {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        if message.len() > LONGEST_MESSAGE {
            self.status.push(Error::new(ErrorCode::InputBufferOverrun));
            return Vec::new();
        }
        exchange(&TREE, self, message)
    }
}
