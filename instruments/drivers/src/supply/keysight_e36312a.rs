//! Keysight E36312A: channel lists, an error queue, over-voltage and over-current protection.
//! Channel 1 (6 V, 5 A) carries the cell.

use instruments_domain::units::{Amps, Volts};
use instruments_link::link::LinkProfile;

use super::{Capabilities, Charge, Dialect};
use crate::{
    exchange::{Bound, Exchange, Identity, ON_OFF, Says, Setting, Shows, Way},
    instrument::{Model, Unattended, ms},
};

/// Keysight E36312A and related models with the same first channel.
pub(super) const E36312A: Keysight = Keysight;

/// The channel that is wired to the cell.
const CHANNEL: u32 = 1;
/// So far above the limit of the charge the instrument switches itself off, V: beyond its
/// overshoot, below what harms a cell at once.
const OVER_VOLTAGE_V: f64 = 0.2;
/// Rounding of read-backs, V and A.
const READ_BACK: f64 = 2.0e-3;

pub(super) struct Keysight;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch("OUTP? (@1)", "output", ON_OFF),
    Setting::number("VOLT? (@1)", "voltage", "V"),
    Setting::number("CURR? (@1)", "current", "A"),
    Setting::number("VOLT:PROT? (@1)", "over-voltage protection", "V"),
    Setting::state("CURR:PROT:STAT? (@1)", "over-current protection", ON_OFF),
    Setting::state(
        "VOLT:SENS:SOUR? (@1)",
        "sense",
        Says::States(&[
            (Shows::Word("INT"), "at its terminals"),
            (Shows::Word("INTernal"), "at its terminals"),
            (Shows::Word("EXT"), "at its sense leads"),
            (Shows::Word("EXTernal"), "at its sense leads"),
        ]),
    ),
];

impl Model for Keysight {
    fn key(&self) -> &'static str {
        "keysight-e36312a"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            min_gap: ms(2),
            ..LinkProfile::scpi()
        }
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        let maker = &identity.maker;
        (maker.starts_with("KEYSIGHT") || maker.starts_with("AGILENT"))
            && identity.model.starts_with("E36312A")
    }
}

/// Returns the command `HEADER value,(@1)`, read back by `HEADER? (@1)`.
fn number(header: &str, value: f64) -> Exchange {
    match Exchange::command(header, |command| {
        command.fixed(value, 3).channels(&[CHANNEL])
    }) {
        Exchange::Send(message) => {
            Exchange::number(message, format!("{header}? (@{CHANNEL})"), value, READ_BACK)
        }
        refused => refused,
    }
}

/// Returns the command `HEADER word,(@1)`, read back by `HEADER? (@1)` as one of `words`.
fn word(header: &str, word: &str, words: &'static [&'static str]) -> Exchange {
    Exchange::word(
        format!("{header} {word},(@{CHANNEL})"),
        format!("{header}? (@{CHANNEL})"),
        words,
    )
}

impl Dialect for Keysight {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            max_current: Amps(5.0),
            max_voltage: Volts(6.0),
            unattended: Unattended::HoldsVoltage,
        }
    }

    fn output(&self, on: bool) -> Vec<Exchange> {
        vec![if on {
            word("OUTP", "ON", &["1", "ON"])
        } else {
            word("OUTP", "OFF", &["0", "OFF"])
        }]
    }

    fn zero(&self) -> Vec<Way> {
        vec![
            Way {
                name: "its current at 0",
                script: self.level(Amps(0.0)),
            },
            Way {
                name: "its voltage at 0",
                script: vec![number("VOLT", 0.0)],
            },
        ]
    }

    fn bounds(&self) -> &'static [Bound] {
        &[
            Bound {
                query: "CURR? (@1)",
                words: "it is limited to",
                unit: "A",
            },
            Bound {
                query: "VOLT? (@1)",
                words: "it is limited to",
                unit: "V",
            },
        ]
    }

    fn prepare(&self, charge: &Charge) -> Vec<Exchange> {
        vec![
            // Sense leads that were selected earlier and are now disconnected would let the
            // terminal voltage rise.
            word("VOLT:SENS:SOUR", "INT", &["INT", "INTernal"]),
            // A charge runs at its current limit: a protection that takes that for a fault must not
            // be armed.
            word("CURR:PROT:STAT", "OFF", &["0", "OFF"]),
            number("VOLT", charge.voltage.value()),
            number("CURR", charge.current.value()),
            number("VOLT:PROT", charge.voltage.value() + OVER_VOLTAGE_V),
        ]
    }

    fn level(&self, current: Amps) -> Vec<Exchange> {
        vec![number("CURR", current.value())]
    }

    fn measure(&self) -> [&'static str; 2] {
        ["MEAS:VOLT? (@1)", "MEAS:CURR? (@1)"]
    }
}
