//! The command tree of the 33500B.

use instruments_scpi::decode::Terminator;
use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{
    super::{
        Device,
        tree::{Arguments, Fallible, both, common, exchange, fail, get, set, text},
    },
    Channel, Keysight, number,
};

/// Only `VPP` is simulated.
fn only_vpp(_: &mut Keysight, arguments: &mut Arguments) -> Fallible {
    arguments.word(&["VPP"]).map(|_| ())
}

/// Sweep and modulation can be switched off.
fn only_off(_: &mut Keysight, arguments: &mut Arguments) -> Fallible {
    if arguments.switch()? {
        fail(ErrorCode::SettingsConflict)
    } else {
        Ok(())
    }
}

macro_rules! modifier {
    ($name:literal) => {
        Branch! {$name; Leaf! {b"STATe" => &both(only_off, |_, _| text("0"))}}
    };
}

macro_rules! node_function {
    ($index:literal) => {
        Branch! {b"FUNCtion" => &both(
                |device: &mut Keysight, arguments| device.set_function($index, arguments),
                |device, _| text(match &device.channels[$index] {
                    Channel { constant: true, .. } => "DC",
                    Channel { arbitrary: true, .. } => "ARB",
                    _ => "SIN",
                }),
            );
                Branch! {b"ARBitrary" => &both(
                    |device: &mut Keysight, arguments| device.choose_wave($index, arguments),
                    |device, _| text(format!("\"{}\"", device.chosen[$index].as_deref().unwrap_or("EXP_RISE"))),
                );
                    Leaf! {b"SRATe" => &both(
                        |device: &mut Keysight, arguments| device.set_rate($index, arguments),
                        |device, _| number(device.channels[$index].rate_hz),
                    )},
                    Leaf! {b"FILTer" => &both(
                        |device: &mut Keysight, arguments| device.set_filter($index, arguments),
                        |device, _| text(device.channels[$index].filter.trim_end_matches(char::is_lowercase)),
                    )}
                }
            }
    };
}

macro_rules! node_data {
    ($index:literal) => {
        Branch! {b"DATA"; Branch! {b"VOLatile";
                Leaf! {b"CLEar" => &set(|device: &mut Keysight, arguments| device.clear_waves($index, arguments))}
            }}
    };
}

macro_rules! node_frequency {
    ($index:literal) => {
        Leaf! {b"FREQuency" => &both(
            |device: &mut Keysight, arguments| device.set_frequency($index, arguments),
            |device, _| number(device.channels[$index].freq_hz),
        )}
    };
}

macro_rules! node_voltage {
    ($index:literal) => {
        Branch! {b"VOLTage" => &both(
            |device: &mut Keysight, arguments| device.set_amplitude($index, arguments),
            |device, _| device.at_load($index, |channel| channel.amplitude_vpp),
        );
            Leaf! {b"UNIT" => &both(only_vpp, |_, _| text("VPP"))},
            Leaf! {b"OFFSet" => &both(
                |device: &mut Keysight, arguments| device.set_offset($index, arguments),
                |device, _| device.at_load($index, |channel| channel.offset_v),
            )},
            Leaf! {b"HIGH" => &get(|device: &mut Keysight, _| {
                device.at_load($index, |channel| channel.offset_v + channel.amplitude_vpp / 2.0)
            })},
            Leaf! {b"LOW" => &get(|device: &mut Keysight, _| {
                device.at_load($index, |channel| channel.offset_v - channel.amplitude_vpp / 2.0)
            })}
        }
    };
}

macro_rules! node_phase {
    ($index:literal) => {
        Branch! {b"PHASe" => &both(
            |device: &mut Keysight, arguments| device.set_phase($index, arguments),
            |device, _| number(device.channels[$index].phase_deg),
        ); Leaf! {b"SYNChronize" => &set(Keysight::align_phases)}}
    };
}

macro_rules! node_apply {
    ($index:literal) => {
        Branch! {b"APPLy";
            Leaf! {b"SINusoid" => &set(|device: &mut Keysight, arguments| {
                device.apply($index, arguments)
            })}
        }
    };
}

macro_rules! node_burst {
    ($index:literal) => {
        Branch! {b"BURSt";
            Leaf! {b"STATe" => &both(
                |device: &mut Keysight, arguments| device.set_burst_state($index, arguments),
                |device, _| text(if device.channels[$index].burst.on { "1" } else { "0" }),
            )},
            Leaf! {b"MODE" => &both(
                |device: &mut Keysight, arguments| device.set_burst_mode($index, arguments),
                |_, _| text("TRIG"),
            )},
            Leaf! {b"NCYCles" => &both(
                |device: &mut Keysight, arguments| device.set_burst_periods($index, arguments),
                |device, _| number(f64::from(device.channels[$index].burst.periods)),
            )},
            Leaf! {b"PHASe" => &both(
                |device: &mut Keysight, arguments| device.set_burst_phase($index, arguments),
                |device, _| number(device.channels[$index].burst.start_deg),
            )}
        }
    };
}

macro_rules! node_sweep {
    ($index:literal) => {
        modifier! {b"SWEep"}
    };
}

macro_rules! node_am {
    ($index:literal) => {
        modifier! {b"AM"}
    };
}

macro_rules! node_fm {
    ($index:literal) => {
        modifier! {b"FM"}
    };
}

macro_rules! source {
    ($name:literal, $index:literal) => {
        Branch! {$name;
            node_function!($index),
            node_data!($index),
            node_frequency!($index),
            node_voltage!($index),
            node_phase!($index),
            node_apply!($index),
            node_burst!($index),
            node_sweep!($index),
            node_am!($index),
            node_fm!($index)
        }
    };
}

macro_rules! trigger {
    ($name:literal, $index:literal) => {
        Branch! {$name => &set(|device: &mut Keysight, arguments| device.trigger($index, arguments));
            Leaf! {b"SOURce" => &both(
                |device: &mut Keysight, arguments| device.set_trigger_source($index, arguments),
                |device, _| text(device.channels[$index].burst.source.trim_end_matches(char::is_lowercase)),
            )},
            Leaf! {b"DELay" => &both(
                |device: &mut Keysight, arguments| device.set_trigger_delay($index, arguments),
                |device, _| number(device.channels[$index].burst.delay_s),
            )}
        }
    };
}

macro_rules! output {
    ($name:literal, $index:literal) => {
        Branch! {$name => &both(
            |device: &mut Keysight, arguments| device.set_output($index, arguments),
            |device, _| text(if device.channels[$index].output_on { "1" } else { "0" }),
        );
            Leaf! {b"LOAD" => &both(
                |device: &mut Keysight, arguments| device.set_load($index, arguments),
                |device, _| match device.channels[$index].load_ohm {
                    // Infinity as the standard writes it.
                    f64::INFINITY => text("+9.900000000000000E+37"),
                    ohms => number(ohms),
                },
            )},
            Leaf! {b"POLarity" => &both(
                |device: &mut Keysight, arguments| device.set_polarity($index, arguments),
                |device, _| text(if device.channels[$index].inverted { "INV" } else { "NORM" }),
            )}
        }
    };
}

pub(super) const TREE: Node<'static, Keysight> = Root! {
    Leaf! {b"*IDN" => &get(|device: &mut Keysight, _| {
        text(format!("Agilent Technologies,33522B,{},5.00-1.19-2.00-58-00", device.serial_number))
    })},
    Leaf! {b"*RST" => &set(Keysight::reset)},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    // The node `SOURce` may be left out.
    node_function!(0),
    node_data!(0),
    node_frequency!(0),
    node_voltage!(0),
    node_phase!(0),
    node_apply!(0),
    node_burst!(0),
    node_sweep!(0),
    node_am!(0),
    node_fm!(0),
    source! {b"SOURce", 0},
    source! {b"SOURce1", 0},
    source! {b"SOURce2", 1},
    trigger! {b"TRIGger", 0},
    trigger! {b"TRIGger1", 0},
    trigger! {b"TRIGger2", 1},
    output! {b"OUTPut", 0},
    output! {b"OUTPut1", 0},
    output! {b"OUTPut2", 1},
    Leaf! {b"*WAI" => &set(common::ignore)},
    Branch! {b"SYSTem";
        Leaf! {b"VERSion" => &get(|_: &mut Keysight, _| text("1999.0"))},
        Branch! {b"ERRor" => &get(common::signed_error_query);
            Leaf! {b"NEXT" => &get(common::signed_error_query)}
        }
    }
};

impl scpi::Device for Keysight {
    fn handle_error(&mut self, error: Error) {
        self.status
            .push(Error::custom(error.get_code(), error.get_message()));
    }
}

impl Device for Keysight {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        if self.load_wave(message) {
            return Vec::new();
        }
        exchange(&TREE, self, message)
    }
}
