//! Rigol DP832(A): the channel is named in every command, switches answer `ON` and `OFF`. Channel 1
//! (30 V, 3 A) carries the cell.

use instruments_domain::units::{Amps, Volts};
use instruments_link::link::LinkProfile;

use super::{Capabilities, Charge, Dialect};
use crate::{
    exchange::{Bound, Exchange, Identity, ON_OFF, Setting, Way},
    instrument::{Model, Unattended, ms},
};

/// Rigol DP832 and DP832A.
pub(super) const DP832: Dp832 = Dp832;

/// So far above the limit of the charge the instrument switches itself off, V.
const OVER_VOLTAGE_V: f64 = 0.2;
/// Rounding of read-backs, V and A.
const READ_BACK: f64 = 2.0e-3;

pub(super) struct Dp832;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch(":OUTP? CH1", "output", ON_OFF),
    Setting::number(":SOUR1:VOLT?", "voltage", "V"),
    Setting::number(":SOUR1:CURR?", "current", "A"),
    Setting::number(":OUTP:OVP:VAL? CH1", "over-voltage protection", "V"),
    Setting::state(":OUTP:OVP? CH1", "over-voltage protection", ON_OFF),
    Setting::state(":OUTP:OCP? CH1", "over-current protection", ON_OFF),
];

impl Model for Dp832 {
    fn key(&self) -> &'static str {
        "rigol-dp832"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            min_gap: ms(20),
            ..LinkProfile::scpi()
        }
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        identity.maker.starts_with("RIGOL") && identity.model.starts_with("DP832")
    }
}

fn switch(header: &str, on: bool) -> Exchange {
    let (state, words): (_, &[&str]) = if on {
        ("ON", &["ON", "1"])
    } else {
        ("OFF", &["OFF", "0"])
    };
    Exchange::word(
        format!("{header} CH1,{state}"),
        format!("{header}? CH1"),
        words,
    )
}

impl Dialect for Dp832 {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            max_current: Amps(3.0),
            max_voltage: Volts(30.0),
            unattended: Unattended::HoldsVoltage,
        }
    }

    fn output(&self, on: bool) -> Vec<Exchange> {
        vec![switch(":OUTP", on)]
    }

    fn zero(&self) -> Vec<Way> {
        vec![
            Way {
                name: "its current at 0",
                script: self.level(Amps(0.0)),
            },
            Way {
                name: "its voltage at 0",
                script: vec![Exchange::fixed(":SOUR1:VOLT", 0.0, 3, READ_BACK)],
            },
        ]
    }

    fn bounds(&self) -> &'static [Bound] {
        &[
            Bound {
                query: ":SOUR1:CURR?",
                words: "it is limited to",
                unit: "A",
            },
            Bound {
                query: ":SOUR1:VOLT?",
                words: "it is limited to",
                unit: "V",
            },
        ]
    }

    fn prepare(&self, charge: &Charge) -> Vec<Exchange> {
        let protection = charge.voltage.value() + OVER_VOLTAGE_V;
        let level = Exchange::command(":OUTP:OVP:VAL", |command| {
            command.word("CH1").fixed(protection, 3)
        });
        vec![
            // A charge runs at its current limit: a protection that takes that for a fault must not
            // be armed.
            switch(":OUTP:OCP", false),
            Exchange::fixed(":SOUR1:VOLT", charge.voltage.value(), 3, READ_BACK),
            Exchange::fixed(":SOUR1:CURR", charge.current.value(), 3, READ_BACK),
            match level {
                Exchange::Send(message) => {
                    Exchange::number(message, ":OUTP:OVP:VAL? CH1", protection, READ_BACK)
                }
                refused => refused,
            },
            switch(":OUTP:OVP", true),
        ]
    }

    fn level(&self, current: Amps) -> Vec<Exchange> {
        vec![Exchange::fixed(
            ":SOUR1:CURR",
            current.value(),
            3,
            READ_BACK,
        )]
    }

    /// The SPD3303X-E and the DP832 without an A have steps of 10 mV and 10 mA.
    fn coarse_step(&self) -> Option<f64> {
        Some(0.01)
    }

    fn measure(&self) -> [&'static str; 2] {
        [":MEAS:VOLT? CH1", ":MEAS:CURR? CH1"]
    }
}
