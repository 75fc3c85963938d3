//! The command tree of the oscilloscope.

use instruments_scpi::decode::Terminator;
use scpi::{Branch, Leaf, Root, error::Error, tree::Node};

use super::{Dho, Transfer, bare, real};
use crate::{
    Device,
    acquisition::Mode,
    tree::{Fallible, bit, both, common, exchange, get, set, text},
};

fn settle(scope: &mut Dho, action: fn(&mut Dho)) -> Fallible {
    action(scope);
    Ok(())
}

macro_rules! switch {
    ($index:literal, $field:ident) => {
        &both(
            |s: &mut Dho, a| s.set_switch($index, |channel| &mut channel.$field, a),
            |s, _| bit(s.panel.channels[$index].$field),
        )
    };
}

macro_rules! channel {
    ($name:literal, $index:literal) => {
        Branch! {$name;
            Leaf! {b"DISPlay" => switch!($index, on)},
            Leaf! {b"SCALe" => &both(
                |s: &mut Dho, a| s.set_number($index, |channel| &mut channel.scale, a),
                |s, _| real(s.panel.channels[$index].scale),
            )},
            Leaf! {b"OFFSet" => &both(
                |s: &mut Dho, a| s.set_number($index, |channel| &mut channel.offset, a),
                |s, _| real(s.panel.channels[$index].offset),
            )},
            Leaf! {b"COUPling" => &both(
                |s: &mut Dho, a| s.set_coupling($index, a),
                |s, _| text(s.panel.channels[$index].coupling),
            )},
            Leaf! {b"BWLimit" => &both(
                |s: &mut Dho, a| s.set_limit($index, a),
                |s, _| text(if s.panel.channels[$index].limited { "20M" } else { "OFF" }),
            )},
            Leaf! {b"INVert" => switch!($index, inverted)},
            Leaf! {b"VERNier" => switch!($index, vernier)},
            Leaf! {b"PROBe" => &both(
                |s: &mut Dho, a| s.set_probe($index, a),
                |s, _| real(s.panel.channels[$index].probe),
            )},
            Leaf! {b"UNITs" => &both(
                |s: &mut Dho, a| s.set_unit($index, a),
                |s, _| text(s.panel.channels[$index].unit),
            )}
        }
    };
}

const TIMEBASE: Node<'static, Dho> = Branch! {b"TIMebase";
    // Only the main time base is simulated.
    Leaf! {b"MODE" => &both(|_: &mut Dho, a| a.word(&["MAIN"]).map(|_| ()), |_, _| text("MAIN"))},
    Branch! {b"MAIN";
        Leaf! {b"SCALe" => &both(Dho::set_time_scale, |s, _| real(s.panel.time_scale))},
        Leaf! {b"OFFSet" => &both(Dho::set_time_offset, |s, _| real(s.panel.time_offset_s))}
    }
};

const ACQUIRE: Node<'static, Dho> = Branch! {b"ACQuire";
    // Only the plain type is simulated.
    Leaf! {b"TYPE" => &both(|_: &mut Dho, a| a.word(&["NORMal"]).map(|_| ()), |_, _| text("NORM"))},
    Leaf! {b"MDEPth" => &both(Dho::set_depth, |s, _| s.depth())},
    Leaf! {b"SRATe" => &get(|s: &mut Dho, _| real(s.panel.sampling().1.recip()))}
};

const TRIGGER: Node<'static, Dho> = Branch! {b"TRIGger";
    Leaf! {b"MODE" => &both(|_: &mut Dho, a| a.word(&["EDGE"]).map(|_| ()), |_, _| text("EDGE"))},
    Branch! {b"EDGE";
        Leaf! {b"SOURce" => &both(Dho::set_trigger_source, |s, _| text(format!("CHAN{}", s.panel.source + 1)))},
        Leaf! {b"SLOPe" => &both(Dho::set_slope, |s, _| text(s.panel.slope.trim_end_matches(char::is_lowercase)))},
        Leaf! {b"LEVel" => &both(Dho::set_level, |s, _| real(s.panel.level))}
    },
    Leaf! {b"SWEep" => &both(Dho::set_sweep, Dho::sweep)},
    Leaf! {b"STATus" => &get(Dho::trigger_status)}
};

const WAVEFORM: Node<'static, Dho> = Branch! {b"WAVeform";
    Leaf! {b"SOURce" => &both(
        |s: &mut Dho, a| { s.transfer.source = Dho::source(a)?; Ok(()) },
        |s, _| text(format!("CHAN{}", s.transfer.source + 1)),
    )},
    Leaf! {b"MODE" => &both(
        |s: &mut Dho, a| { s.transfer.raw = matches!(a.word(&["NORMal", "MAXimum", "RAW"])?, "RAW"); Ok(()) },
        |s, _| text(if s.transfer.raw { "RAW" } else { "NORM" }),
    )},
    Leaf! {b"FORMat" => &both(
        |s: &mut Dho, a| { s.transfer.words = a.word(&["BYTE", "WORD"])? == "WORD"; Ok(()) },
        |s, _| text(if s.transfer.words { "WORD" } else { "BYTE" }),
    )},
    Leaf! {b"STARt" => &both(
        |s: &mut Dho, a| { s.transfer.start = point(bare(a)?); Ok(()) },
        |s, _| text(s.transfer.start.to_string()),
    )},
    Leaf! {b"STOP" => &both(
        |s: &mut Dho, a| { s.transfer.stop = point(bare(a)?); Ok(()) },
        |s, _| text(s.transfer.stop.to_string()),
    )},
    Leaf! {b"PREamble" => &get(|s: &mut Dho, _| s.preamble())},
    Leaf! {b"DATA" => &get(|s: &mut Dho, _| Ok(s.data()))}
};

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped before"
)]
fn point(value: f64) -> u64 {
    value.round().clamp(1.0, 1e9) as u64
}

pub(super) const TREE: Node<'static, Dho> = Root! {
    Leaf! {b"*IDN" => &get(|s: &mut Dho, _| text(format!("RIGOL TECHNOLOGIES,DHO824,{},00.01.03", s.serial_number)))},
    Leaf! {b"*RST" => &set(Dho::reset)},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Branch! {b"SYSTem";
        Branch! {b"ERRor" => &get(common::error_query); Leaf! {b"NEXT" => &get(common::error_query)}},
        Leaf! {b"VERSion" => &get(|_: &mut Dho, _| text("1999.0"))}
    },
    Leaf! {b"RUN" => &set(|s, _| settle(s, |s| s.acquisition.run(s.world.now_s)))},
    Leaf! {b"STOP" => &set(|s, _| settle(s, |s| s.acquisition.stop(s.world.now_s)))},
    Leaf! {b"SINGle" => &set(|s, _| settle(s, |s| s.acquisition.set_mode(Mode::Single, s.world.now_s)))},
    Leaf! {b"TFORce" => &set(|s, _| settle(s, |s| s.acquisition.force_trigger(s.world.now_s)))},
    channel! {b"CHANnel1", 0},
    channel! {b"CHANnel2", 1},
    channel! {b"CHANnel3", 2},
    channel! {b"CHANnel4", 3},
    TIMEBASE,
    ACQUIRE,
    TRIGGER,
    WAVEFORM
};

impl scpi::Device for Dho {
    fn handle_error(&mut self, error: Error) {
        // Only the number and its text are queued, without the detail that the parser adds.
        self.status
            .push(Error::custom(error.get_code(), error.get_message()));
    }
}

impl Device for Dho {
    fn terminator(&self) -> Terminator {
        Terminator::Lf
    }

    fn connected(&mut self, _: f64) {
        if !self.quirks.is("sticky_transfer") {
            self.transfer = Transfer::default();
        }
    }

    fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
        self.world.now_s = now_s;
        self.acquisition
            .refresh(&self.world, self.panel, &self.panel.view());
        if self.quirks.is("busy_opc") && self.acquisition.keeps_waiting(message) {
            return Vec::new();
        }
        exchange(&TREE, self, message)
    }
}
