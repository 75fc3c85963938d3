//! Siglent SDL1000X: no error queue, so every setting is read back. The keywords that set `FUNC`
//! differ from those in its replies.

use instruments_domain::units::{Amps, Watts};
use instruments_link::link::LinkProfile;

use super::{Capabilities, Dialect, Discharge, Draw};
use crate::{
    exchange::{Bound, Exchange, Identity, ON_OFF, Says, Setting, Shows, Way},
    instrument::{Model, Unattended, ms},
};

/// Siglent SDL1020X/1030X.
pub(super) const SDL1000X: Sdl = Sdl;

/// Greatest current.
const MAX_CURRENT: Amps = Amps(30.0);
/// The over-current protection lies above the current by this factor and this much, A.
const PROTECTION: (f64, f64) = (1.1, 0.1);

/// Within the range of 36 V, and above every cell.
const ABOVE_ANY_CELL_V: f64 = 30.0;

pub(super) struct Sdl;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch(":INP?", "input", ON_OFF),
    Setting::state(
        ":FUNC?",
        "function",
        Says::States(&[
            (Shows::Word("CURRENT"), "constant current"),
            (Shows::Word("VOLTAGE"), "constant voltage"),
            (Shows::Word("POWER"), "constant power"),
            (Shows::Word("RESISTANCE"), "constant resistance"),
        ]),
    ),
    Setting::number(":CURR:LEV:IMM?", "current", "A"),
    Setting::number(":POW:LEV:IMM?", "power", "W"),
    Setting::number(":VOLT:LEV:IMM?", "voltage", "V"),
    Setting::number(":VOLT:LEV:ON?", "voltage below which it stops", "V"),
    Setting::number(":CURR:PROT:LEV?", "over-current protection", "A"),
    Setting::state(":CURR:PROT:STAT?", "over-current protection", ON_OFF),
    Setting::state(":VOLT:LATC?", "latch", ON_OFF),
    Setting::state("SYST:SENS?", "remote sense", ON_OFF),
];

impl Model for Sdl {
    fn key(&self) -> &'static str {
        "siglent-sdl1000x"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            min_gap: ms(10),
            error_query: None,
            ..LinkProfile::scpi()
        }
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        identity.maker.starts_with("SIGLENT") && identity.model.starts_with("SDL")
    }
}

impl Dialect for Sdl {
    fn capabilities(&self) -> Capabilities {
        // `VOLT:LEV:ON` with the latch off.
        Capabilities {
            max_current: MAX_CURRENT,
            max_power_w: 200.0,
            unattended: Unattended::StopsBelow,
        }
    }

    fn input(&self, on: bool) -> Vec<Exchange> {
        if on {
            vec![Exchange::word(":INP ON", ":INP?", &["1", "ON"])]
        } else {
            vec![Exchange::word(":INP OFF", ":INP?", &["0", "OFF"])]
        }
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
                    Exchange::fixed(":VOLT:LEV:IMM", ABOVE_ANY_CELL_V, 3, 1.0e-2),
                    Exchange::word(":FUNC VOLTage", ":FUNC?", &["VOLTAGE"]),
                ],
            },
        ]
    }

    fn bounds(&self) -> &'static [Bound] {
        &[
            Bound {
                query: ":CURR:PROT:LEV?",
                words: "it trips above",
                unit: "A",
            },
            Bound {
                query: ":VOLT:LEV:ON?",
                words: "it stops below",
                unit: "V",
            },
        ]
    }

    fn prepare(&self, discharge: &Discharge) -> Vec<Exchange> {
        let stop = discharge.stop_below.value();
        let mut script = match discharge.draw {
            Draw::Current(current) => {
                // The 5 A range is the finer one; any greater value selects 30 A.
                let (range, range_value) = if current.value() <= 5.0 {
                    ("5", 5.0)
                } else {
                    ("30", 30.0)
                };
                vec![
                    Exchange::word(":FUNC CURRent", ":FUNC?", &["CURRENT"]),
                    Exchange::number(
                        format!(":CURR:IRANG {range}"),
                        ":CURR:IRANG?",
                        range_value,
                        0.1,
                    ),
                    // No cell exceeds 36 V, and the coarse range resolves ten times worse.
                    Exchange::number(":CURR:VRANG 36", ":CURR:VRANG?", 36.0, 0.1),
                ]
            }
            Draw::Power(_) => vec![
                Exchange::word(":FUNC POWer", ":FUNC?", &["POWER"]),
                Exchange::number(":POW:IRANG 30", ":POW:IRANG?", 30.0, 0.1),
                Exchange::number(":POW:VRANG 36", ":POW:VRANG?", 36.0, 0.1),
            ],
        };
        script.extend(self.level(discharge.draw));
        // With the latch off, the input opens automatically when the cell falls below this voltage.
        // This is a second guard beside the daemon.
        script.push(Exchange::switch(":VOLT:LATC", false));
        script.push(Exchange::fixed(":VOLT:LEV:ON", stop, 3, 5.0e-3));
        // A third guard lies above the requested current; that of an earlier discharge must not cut
        // off a power.
        let protection = match discharge.draw {
            Draw::Current(current) => {
                (100.0 * (PROTECTION.0 * current.value() + PROTECTION.1)).round() / 100.0
            }
            Draw::Power(_) => MAX_CURRENT.value(),
        };
        script.push(Exchange::fixed(
            ":CURR:PROT:LEV",
            protection.min(MAX_CURRENT.value()),
            4,
            5.0e-3,
        ));
        script.push(Exchange::switch(":CURR:PROT:STAT", true));
        script
    }

    fn level(&self, draw: Draw) -> Vec<Exchange> {
        vec![match draw {
            Draw::Current(current) => Exchange::fixed(":CURR:LEV:IMM", current.value(), 4, 2.0e-3),
            Draw::Power(power) => Exchange::fixed(":POW:LEV:IMM", power.value(), 3, 1.0e-2),
        }]
    }

    fn sense(&self, remote: bool) -> Vec<Exchange> {
        vec![Exchange::switch("SYST:SENS", remote)]
    }

    fn watch(&self) -> Vec<Exchange> {
        // No cell exceeds 36 V, and the coarse range resolves ten times worse.
        vec![Exchange::number(
            ":CURR:VRANG 36",
            ":CURR:VRANG?",
            36.0,
            0.1,
        )]
    }

    fn measure(&self) -> [&'static str; 2] {
        ["MEAS:VOLT?", "MEAS:CURR?"]
    }
}
