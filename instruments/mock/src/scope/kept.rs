//! Settings of the guide (EN11) that the simulation stores and answers, but that change nothing in it:
//! the queries of common clients get the answers that the guide states.

use scpi::{Branch, Leaf, tree::Node};

use super::Scope;
use crate::tree::{Answer, Arguments, Fallible, both, get, set, text};

/// The value of a measurement that nothing measures; assumed.
const NO_VALUE: &str = "****";

impl Scope {
    /// Stores one of the words of a setting.
    fn keep(&mut self, name: &'static str, words: &[&'static str], a: &mut Arguments) -> Fallible {
        let word = a.word(words)?;
        self.kept.insert(name, word.to_owned());
        Ok(())
    }

    /// Stores a number.
    fn keep_number(&mut self, name: &'static str, unit: &str, a: &mut Arguments) -> Fallible {
        let value = a.number(unit)?;
        self.kept.insert(name, value.to_string());
        Ok(())
    }

    /// Returns a stored setting, or its value after power-on.
    fn kept(&self, name: &str, usual: &str) -> Fallible<Answer> {
        text(self.kept.get(name).map_or(usual, String::as_str))
    }
}

macro_rules! kept {
    ($node:literal, $name:literal, [$usual:literal $(, $word:literal)*]) => {
        Leaf! {$node => &both(
            |s: &mut Scope, a| s.keep($name, &[$usual $(, $word)*], a),
            |s, _| s.kept($name, $usual),
        )}
    };
    ($node:literal, $name:literal, $usual:literal, $unit:literal) => {
        Leaf! {$node => &both(
            |s: &mut Scope, a| s.keep_number($name, $unit, a),
            |s, _| s.kept($name, $usual),
        )}
    };
}

pub(super) const FAST: Node<'static, Scope> = kept!(b"AMODe", "amode", ["FAST", "SLOW"]);
// Mnemonics have at most 12 characters (SCPI-99), so the parser takes only the short form.
pub(super) const INTERPOLATION: Node<'static, Scope> =
    kept!(b"INTerpolation", "interpolation", ["ON", "OFF"]);
pub(super) const PLOT: Node<'static, Scope> = kept!(b"MODE", "plot", ["YT", "XY", "ROLL"]);
pub(super) const RESOLUTION: Node<'static, Scope> =
    kept!(b"RESolution", "resolution", ["10Bits", "8Bits"]);
pub(super) const SEQUENCE: Node<'static, Scope> = kept!(b"SEQuence", "sequence", ["OFF"]);
pub(super) const WINDOW: Node<'static, Scope> = Branch! {b"WINDow" => &both(
        |s: &mut Scope, a| s.keep("window", &["OFF", "ON"], a),
        |s, _| s.kept("window", "OFF"),
    );
    kept!(b"DELay", "window_delay", "0.00E+00", "S"),
    kept!(b"SCALe", "window_scale", "1.00E-07", "S")
};
pub(super) const EDGE_COUPLING: Node<'static, Scope> = kept!(
    b"COUPling",
    "edge_coupling",
    ["DC", "AC", "LFREJect", "HFREJect"]
);
pub(super) const EDGE_NOISE: Node<'static, Scope> = kept!(b"NREJect", "edge_noise", ["OFF", "ON"]);
pub(super) const EDGE_IMPEDANCE: Node<'static, Scope> =
    kept!(b"IMPedance", "edge_impedance", ["ONEMeg", "FIFTy"]);
pub(super) const EDGE_EVENTS: Node<'static, Scope> = kept!(b"HLDEVent", "edge_events", "1", "");
pub(super) const EDGE_TIME: Node<'static, Scope> = kept!(b"HLDTime", "edge_time", "8.00E-09", "S");
pub(super) const EDGE_HOLDOFF: Node<'static, Scope> =
    kept!(b"HOLDoff", "edge_holdoff", ["OFF", "EVENts", "TIME"]);
pub(super) const EDGE_START: Node<'static, Scope> =
    kept!(b"HSTart", "edge_start", ["LAST_TRIG", "ACQ_START"]);

macro_rules! item {
    ($node:literal, $on:literal, $one:literal, $two:literal, $kind:literal) => {
        Branch! {$node => &both(
                |s: &mut Scope, a| s.keep($on, &["OFF", "ON"], a),
                |s, _| s.kept($on, "OFF"),
            );
            kept!(b"SOURce1", $one, ["C1", "C2", "C3", "C4"]),
            kept!(b"SOURce2", $two, ["C1", "C2", "C3", "C4"]),
            kept!(b"TYPE", $kind, ["PKPK", "MAX", "MIN", "AMPL", "MEAN", "RMS", "FREQ", "PERiod"]),
            Leaf! {b"VALue" => &get(|_: &mut Scope, _| text(NO_VALUE))},
            // Without statistics the query answers that they are off.
            Leaf! {b"STATistics" => &get(|_: &mut Scope, a| { a.next(); text("OFF") })}
        }
    };
}

pub(super) const MEASURE: Node<'static, Scope> = Branch! {b"MEASure" => &both(
        |s: &mut Scope, a| s.keep("measure", &["OFF", "ON"], a),
        |s, _| s.kept("measure", "OFF"),
    );
    kept!(b"MODE", "measure_mode", ["SIMPle", "ADVanced"]),
    Branch! {b"SIMPle";
        kept!(b"SOURce", "simple_source", ["C1", "C2", "C3", "C4"]),
        Leaf! {b"VALue" => &get(|_: &mut Scope, a| { a.next(); text(NO_VALUE) })},
        Leaf! {b"CLEar" => &set(|_: &mut Scope, _| Ok(()))}
    },
    Branch! {b"ADVanced";
        kept!(b"LINenumber", "line_number", "1", ""),
        Branch! {b"STATistics" => &both(
                |s: &mut Scope, a| s.keep("statistics", &["OFF", "ON"], a),
                |s, _| s.kept("statistics", "OFF"),
            ); Leaf! {b"RESet" => &set(|_: &mut Scope, _| Ok(()))}
        },
        Leaf! {b"CLEar" => &set(|_: &mut Scope, _| Ok(()))},
        item!(b"P1", "p1", "p1_one", "p1_two", "p1_type"),
        item!(b"P2", "p2", "p2_one", "p2_two", "p2_type"),
        item!(b"P3", "p3", "p3_one", "p3_two", "p3_type"),
        item!(b"P4", "p4", "p4_one", "p4_two", "p4_type"),
        item!(b"P5", "p5", "p5_one", "p5_two", "p5_type"),
        item!(b"P12", "p12", "p12_one", "p12_two", "p12_type")
    }
};
