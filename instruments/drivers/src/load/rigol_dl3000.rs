//! Rigol DL3021/DL3031: the function is set as `CURR` and answered as `CC`; some firmware ends an
//! answer with two line ends.

use instruments_domain::units::{Amps, Watts};
use instruments_link::link::LinkProfile;

use super::{Capabilities, Dialect, Discharge, Draw};
use crate::{
    exchange::{Bound, Exchange, Identity, ON_OFF, Says, Setting, Shows, Way},
    instrument::{Model, Unattended, ms},
};

/// Rigol DL3021(A); the DL3031(A) is used as far as the smaller one reaches.
pub(super) const DL3000: Dl3000 = Dl3000;

/// So far above the level its own limit of the current is set, A.
const ILIM_MARGIN_A: f64 = 1.0;

/// Within the range of 15 V, and above every cell.
const ABOVE_ANY_CELL_V: f64 = 14.0;

pub(super) struct Dl3000;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch(":SOUR:INP:STAT?", "input", ON_OFF),
    Setting::state(
        ":SOUR:FUNC?",
        "function",
        Says::States(&[
            (Shows::Word("CC"), "constant current"),
            (Shows::Word("CV"), "constant voltage"),
            (Shows::Word("CP"), "constant power"),
            (Shows::Word("CR"), "constant resistance"),
        ]),
    ),
    Setting::state(
        ":SOUR:FUNC:MODE?",
        "mode",
        Says::States(&[
            (Shows::Word("FIX"), "steady"),
            (Shows::Word("FIXED"), "steady"),
            (Shows::Word("LIST"), "a list"),
            (Shows::Word("WAV"), "a waveform"),
            (Shows::Word("BATT"), "a battery test"),
            (Shows::Word("OCP"), "a test of a protection"),
        ]),
    ),
    Setting::number(":SOUR:CURR:LEV:IMM?", "current", "A"),
    Setting::number(":SOUR:POW:LEV:IMM?", "power", "W"),
    Setting::number(":SOUR:VOLT:LEV:IMM?", "voltage", "V"),
    Setting::number(":SOUR:CURR:ILIM?", "limit of the current", "A"),
    Setting::number(":SOUR:CURR:VON?", "voltage from which it sinks", "V"),
    Setting::state(":SOUR:SENS?", "remote sense", ON_OFF),
];

impl Model for Dl3000 {
    fn key(&self) -> &'static str {
        "rigol-dl3000"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            min_gap: ms(10),
            ..LinkProfile::scpi()
        }
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        identity.maker.starts_with("RIGOL") && identity.model.starts_with("DL30")
    }
}

/// Selects the finest range for a cell's voltage.
fn voltmeter() -> [Exchange; 1] {
    [Exchange::number(
        ":SOUR:VOLT:RANG 15",
        ":SOUR:VOLT:RANG?",
        15.0,
        0.1,
    )]
}

impl Dialect for Dl3000 {
    fn capabilities(&self) -> Capabilities {
        // The guide does not state whether `VON` also stops a load that it let start.
        Capabilities {
            max_current: Amps(40.0),
            max_power_w: 200.0,
            unattended: Unattended::NothingKnown,
        }
    }

    fn input(&self, on: bool) -> Vec<Exchange> {
        vec![Exchange::switch(":SOUR:INP:STAT", on)]
    }

    fn zero(&self) -> Vec<Way> {
        vec![
            Way {
                name: "its set-points at 0",
                script: [
                    self.level(Draw::Current(Amps(0.0))),
                    self.level(Draw::Power(Watts(0.0))),
                ]
                .concat(),
            },
            // It sinks only what lies above this voltage: no cell does.
            Way {
                name: "constant voltage far above that of a cell",
                script: vec![
                    Exchange::fixed(":SOUR:VOLT:LEV:IMM", ABOVE_ANY_CELL_V, 3, 1.0e-2),
                    Exchange::word(":SOUR:FUNC VOLT", ":SOUR:FUNC?", &["CV"]),
                ],
            },
        ]
    }

    fn bounds(&self) -> &'static [Bound] {
        &[Bound {
            query: ":SOUR:CURR:ILIM?",
            words: "at constant current it sinks at most",
            unit: "A",
        }]
    }

    fn prepare(&self, discharge: &Discharge) -> Vec<Exchange> {
        let mut script = vec![Exchange::word(
            ":SOUR:FUNC:MODE FIX",
            ":SOUR:FUNC:MODE?",
            &["FIX", "FIXED"],
        )];
        match discharge.draw {
            Draw::Current(current) => {
                // The DL3021 has the ranges 4 A and 40 A, the DL3031 6 A and 60 A: it takes the one
                // that holds the value, and answers its own.
                let (range, ranges) = if current.value() <= 4.0 {
                    ("4", (5.0, 1.1))
                } else {
                    ("40", (50.0, 10.5))
                };
                script.push(Exchange::word(":SOUR:FUNC CURR", ":SOUR:FUNC?", &["CC"]));
                script.push(Exchange::number(
                    format!(":SOUR:CURR:RANG {range}"),
                    ":SOUR:CURR:RANG?",
                    ranges.0,
                    ranges.1,
                ));
                // Left low by an earlier user, it would hold the discharge back.
                script.push(Exchange::fixed(
                    ":SOUR:CURR:ILIM",
                    current.value() + ILIM_MARGIN_A,
                    3,
                    5.0e-3,
                ));
            }
            Draw::Power(_) => script.push(Exchange::word(":SOUR:FUNC POW", ":SOUR:FUNC?", &["CP"])),
        }
        script.extend(voltmeter());
        script.extend(self.level(discharge.draw));
        // The load does not start to sink below this voltage. The guide does not state whether it
        // also stops there, so nothing relies on it.
        script.push(Exchange::fixed(
            ":SOUR:CURR:VON",
            discharge.stop_below.value(),
            3,
            5.0e-3,
        ));
        script
    }

    fn level(&self, draw: Draw) -> Vec<Exchange> {
        vec![match draw {
            Draw::Current(current) => {
                Exchange::fixed(":SOUR:CURR:LEV:IMM", current.value(), 4, 2.0e-3)
            }
            Draw::Power(power) => Exchange::fixed(":SOUR:POW:LEV:IMM", power.value(), 3, 1.0e-2),
        }]
    }

    fn usual_sense(&self) -> Option<bool> {
        Some(true)
    }

    fn sense(&self, remote: bool) -> Vec<Exchange> {
        vec![Exchange::switch(":SOUR:SENS", remote)]
    }

    fn watch(&self) -> Vec<Exchange> {
        voltmeter().into()
    }

    fn measure(&self) -> [&'static str; 2] {
        [":MEAS:VOLT?", ":MEAS:CURR?"]
    }
}
