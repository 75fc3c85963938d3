//! The command tree of the oscilloscope.

use instruments_scpi::decode::Terminator;
use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{
    Scope, Transfer,
    control::points,
    kept::{
        EDGE_COUPLING, EDGE_EVENTS, EDGE_HOLDOFF, EDGE_IMPEDANCE, EDGE_NOISE, EDGE_START,
        EDGE_TIME, FAST, INTERPOLATION, MEASURE, PLOT, RESOLUTION, SEQUENCE, WINDOW,
    },
};
use crate::{
    Device,
    tree::{Answer, Fallible, WRONG_FORM, both, common, exchange, get, set, text},
};

fn on_off(on: bool) -> Fallible<Answer> {
    text(if on { "ON" } else { "OFF" })
}

fn settle(scope: &mut Scope, action: fn(&mut Scope)) -> Fallible {
    action(scope);
    Ok(())
}

macro_rules! channel {
    ($name:literal, $index:literal) => {
        Branch! {$name;
            Leaf! {b"SWITch" => &both(
                |s: &mut Scope, a| s.set_switch($index, a),
                |s, _| on_off(s.panel.channels[$index].on),
            )},
            Leaf! {b"SCALe" => &both(
                |s: &mut Scope, a| s.set_scale($index, a),
                |s, _| s.real(s.panel.channels[$index].scale),
            )},
            Leaf! {b"OFFSet" => &both(
                |s: &mut Scope, a| s.set_offset($index, a),
                |s, _| s.real(s.panel.channels[$index].offset),
            )},
            Leaf! {b"COUPling" => &both(
                |s: &mut Scope, a| s.set_coupling($index, a),
                |s, _| text(s.panel.channels[$index].coupling),
            )},
            Leaf! {b"IMPedance" => &both(
                |_: &mut Scope, a| a.word(&["ONEMeg", "FIFTy"]).map(|_| ()),
                |_, _| text("ONEMeg"),
            )},
            Leaf! {b"BWLimit" => &both(
                |s: &mut Scope, a| s.set_bandwidth($index, a),
                |s, _| text(s.panel.channels[$index].bandwidth),
            )},
            Leaf! {b"PROBe" => &both(
                |s: &mut Scope, a| s.set_probe($index, a),
                |s, _| s.real(s.panel.channels[$index].probe),
            )},
            Leaf! {b"UNIT" => &both(
                |s: &mut Scope, a| s.set_unit($index, a),
                |s, _| text(s.panel.channels[$index].unit),
            )},
            // Stored nowhere: what is on is shown, and nothing is inverted.
            Leaf! {b"VISible" => &both(
                |_: &mut Scope, a| a.switch().map(|_| ()),
                |s, _| on_off(s.panel.channels[$index].on),
            )},
            Leaf! {b"INVert" => &both(|_: &mut Scope, a| a.word(&["OFF"]).map(|_| ()), |_, _| text("OFF"))}
        }
    };
}

const TIMEBASE: Node<'static, Scope> = Branch! {b"TIMebase";
    Leaf! {b"SCALe" => &both(Scope::set_time_scale, |s, _| s.real(s.panel.time_scale))},
    Leaf! {b"DELay" => &both(Scope::set_delay, |s, _| s.real(s.panel.delay_s))},
    Branch! {b"REFerence" => &both(
            Scope::set_reference,
            |s, _| text(if s.panel.keep_position { "POSition" } else { "DELay" }),
        );
        Leaf! {b"POSition" => &both(
            Scope::set_reference_position,
            |s, _| text(format!("{}", s.panel.reference_percent)),
        )}
    },
    WINDOW
};

const ACQUIRE: Node<'static, Scope> = Branch! {b"ACQuire";
    // Only the fixed memory depth is simulated, in which the rate follows the time base.
    Leaf! {b"MMANagement" => &both(|_: &mut Scope, a| a.word(&["AUTO", "FMDepth"]).map(|_| ()), |_, _| text("AUTO"))},
    Leaf! {b"MDEPth" => &both(Scope::set_depth, |s, _| text(s.panel.depth))},
    Leaf! {b"POINts" => &get(|s: &mut Scope, _| s.real(s.panel.sampling().0))},
    Leaf! {b"SRATe" => &get(|s: &mut Scope, _| s.real(s.sample_rate()))},
    Leaf! {b"TYPE" => &both(Scope::set_acquisition_type, |_, _| text("NORMal"))},
    FAST, INTERPOLATION, PLOT, RESOLUTION, SEQUENCE
};

const TRIGGER: Node<'static, Scope> = Branch! {b"TRIGger";
    Leaf! {b"TYPE" => &both(|_: &mut Scope, a| a.word(&["EDGE"]).map(|_| ()), |_, _| text("EDGE"))},
    Branch! {b"EDGE";
        Leaf! {b"SOURce" => &both(Scope::set_trigger_source, |s, _| text(s.panel.trigger.source))},
        Leaf! {b"SLOPe" => &both(Scope::set_slope, |s, _| text(s.panel.trigger.slope))},
        Leaf! {b"LEVel" => &both(Scope::set_level, |s, _| s.real(s.panel.trigger.level))},
        EDGE_COUPLING, EDGE_NOISE, EDGE_IMPEDANCE, EDGE_EVENTS, EDGE_TIME, EDGE_HOLDOFF, EDGE_START
    },
    // Nothing counts the triggers; the guide shows three digits.
    Leaf! {b"FREQuency" => &get(|_: &mut Scope, _| text("0.00E+00"))},
    Leaf! {b"MODE" => &both(Scope::set_trigger_mode, Scope::trigger_mode)},
    Leaf! {b"RUN" => &set(|s, _| settle(s, |s| s.acquisition.run(s.world.now_s)))},
    Leaf! {b"STOP" => &set(|s, _| settle(s, |s| s.acquisition.stop(s.world.now_s)))},
    Leaf! {b"STATus" => &get(|s: &mut Scope, _| text(s.trigger_status()))}
};

const WAVEFORM: Node<'static, Scope> = Branch! {b"WAVeform";
    Leaf! {b"SOURce" => &both(Scope::set_source, |s, _| text(format!("C{}", s.transfer.source + 1)))},
    Leaf! {b"STARt" => &both(
        |s: &mut Scope, a| { s.transfer.start = points(a, 0.0)?; Ok(()) },
        |s, _| text(s.transfer.start.to_string()),
    )},
    Leaf! {b"POINt" => &both(
        |s: &mut Scope, a| { s.transfer.points = points(a, 0.0)?; Ok(()) },
        |s, _| text(s.transfer.points.to_string()),
    )},
    Leaf! {b"INTerval" => &both(
        |s: &mut Scope, a| { s.transfer.interval = points(a, 1.0)?; Ok(()) },
        |s, _| text(s.transfer.interval.to_string()),
    )},
    Leaf! {b"WIDTh" => &both(
        |s: &mut Scope, a| { s.transfer.words = a.word(&["BYTE", "WORD"])? == "WORD"; Ok(()) },
        |s, _| text(if s.transfer.words { "WORD" } else { "BYTE" }),
    )},
    Leaf! {b"BYTeorder" => &both(
        |s: &mut Scope, a| { s.transfer.big_endian = a.word(&["LSB", "MSB"])? == "MSB"; Ok(()) },
        |s, _| text(if s.transfer.big_endian { "MSB" } else { "LSB" }),
    )},
    Leaf! {b"MAXPoint" => &get(|s: &mut Scope, _| text(s.announced_points().to_string()))},
    Leaf! {b"PREamble" => &get(|s: &mut Scope, _| s.preamble())},
    Leaf! {b"DATA" => &get(|s: &mut Scope, _| Ok(s.data()))}
};

pub(super) const TREE: Node<'static, Scope> = Root! {
    Leaf! {b"*IDN" => &get(|s: &mut Scope, _| text(format!("Siglent Technologies,SDS824X \
    HD,{},4.8.12.1.1.6.5", s.serial_number)))},
    Leaf! {b"*RST" => &set(|s, _| settle(s, Scope::reset))},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Leaf! {b"*ESR" => &get(common::esr_query)},
    Leaf! {b"*ESE" => &both(common::ese, common::ese_query)},
    Leaf! {b"*SRE" => &both(common::sre, common::sre_query)},
    Leaf! {b"*STB" => &get(common::stb_query)},
    MEASURE,
    Leaf! {b"INR" => &get(|s: &mut Scope, _| text(if s.acquisition.take_new() { "1" } else { "0" }))},
    channel! {b"CHANnel1", 0},
    channel! {b"CHANnel2", 1},
    channel! {b"CHANnel3", 2},
    channel! {b"CHANnel4", 3},
    TIMEBASE,
    ACQUIRE,
    TRIGGER,
    WAVEFORM,
    Branch! {b"FORMat"; Leaf! {b"DATA" => &both(Scope::set_number_format, |s, _| text(s.number_format.clone()))}},
    Branch! {b"SYSTem";
        Branch! {b"ERRor" => &get(common::error_query); Leaf! {b"NEXT" => &get(common::error_query)}},
        Leaf! {b"REMote" => &both(|s: &mut Scope, a| { s.remote = a.switch()?; Ok(()) }, |s, _| on_off(s.remote))}
    }
};

impl scpi::Device for Scope {
    fn handle_error(&mut self, error: Error) {
        // As reported of firmware 4.8: a path that leads nowhere, a header in the form that it does
        // not have, and a missing argument.
        let own = if error == ErrorCode::UndefinedHeader && error.get_extended() == Some(WRONG_FORM)
        {
            Error::new(ErrorCode::UndefinedHeader)
        } else if error == ErrorCode::UndefinedHeader {
            Error::new(ErrorCode::InvalidCharacter)
        } else if error == ErrorCode::MissingParameter {
            Error::new(ErrorCode::ExecutionError)
        } else {
            Error::custom(error.get_code(), error.get_message())
        };
        self.status.push(own);
    }
}

impl Device for Scope {
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
        self.refresh();
        if self.quirks.is("busy_opc") && self.acquisition.keeps_waiting(message) {
            return Vec::new();
        }
        exchange(&TREE, self, message)
    }
}
