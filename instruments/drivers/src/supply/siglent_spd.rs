//! Siglent SPD3303X: no output query, so the state is read from the hexadecimal status word (bit 4:
//! channel 1 on); its error replies are not quoted. Needs 10 ms after each write.

use instruments_domain::units::{Amps, Volts};
use instruments_link::link::LinkProfile;

use super::{Capabilities, Charge, Dialect};
use crate::{
    exchange::{Bound, Exchange, Expect, Identity, Says, Setting, Shows, Way},
    instrument::{Model, Unattended, ms},
};

/// Siglent SPD3303X/-E.
pub(super) const SPD3303X: Spd = Spd;

/// Status bits of the tracking mode, and their value for independent channels.
const TRACKING: (u32, u32) = (0b11 << 2, 0b01 << 2);
/// Their value for parallel channels.
const PARALLEL: u32 = 0b10 << 2;
/// Status bit of an output that is on, channel 1.
const CHANNEL_1_ON: u32 = 1 << 4;

pub(super) struct Spd;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch(
        "SYST:STAT?",
        "output",
        Says::States(&[
            (Shows::Bits(CHANNEL_1_ON, CHANNEL_1_ON), "on"),
            (Shows::Bits(CHANNEL_1_ON, 0), "off"),
        ]),
    ),
    Setting::state(
        "SYST:STAT?",
        "coupling",
        Says::States(&[
            (Shows::Bits(TRACKING.0, TRACKING.1), "none"),
            (Shows::Bits(TRACKING.0, PARALLEL), "parallel"),
        ]),
    ),
    Setting::number("CH1:VOLT?", "voltage", "V"),
    Setting::number("CH1:CURR?", "current", "A"),
];

impl Model for Spd {
    fn key(&self) -> &'static str {
        "siglent-spd3303x"
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
        identity.maker.starts_with("SIGLENT") && identity.model.starts_with("SPD3303X")
    }
}

impl Dialect for Spd {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            max_current: Amps(3.2),
            max_voltage: Volts(32.0),
            unattended: Unattended::HoldsVoltage,
        }
    }

    fn output(&self, on: bool) -> Vec<Exchange> {
        let (message, bits) = if on {
            ("OUTP CH1,ON", CHANNEL_1_ON)
        } else {
            ("OUTP CH1,OFF", 0)
        };
        vec![Exchange::Set {
            message: message.to_owned(),
            read_back: "SYST:STAT?".to_owned(),
            expect: Expect::Bits {
                mask: CHANNEL_1_ON,
                bits,
            },
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
                script: vec![Exchange::fixed("CH1:VOLT", 0.0, 3, 2.0e-3)],
            },
        ]
    }

    fn bounds(&self) -> &'static [Bound] {
        &[
            Bound {
                query: "CH1:CURR?",
                words: "it is limited to",
                unit: "A",
            },
            Bound {
                query: "CH1:VOLT?",
                words: "it is limited to",
                unit: "V",
            },
        ]
    }

    fn prepare(&self, charge: &Charge) -> Vec<Exchange> {
        let mut script = vec![
            // In parallel the channel would deliver twice the current.
            Exchange::Set {
                message: "OUTP:TRACK 0".to_owned(),
                read_back: "SYST:STAT?".to_owned(),
                expect: Expect::Bits {
                    mask: TRACKING.0,
                    bits: TRACKING.1,
                },
            },
            Exchange::fixed("CH1:VOLT", charge.voltage.value(), 3, 2.0e-3),
        ];
        script.extend(self.level(charge.current));
        script
    }

    fn level(&self, current: Amps) -> Vec<Exchange> {
        vec![Exchange::fixed("CH1:CURR", current.value(), 3, 2.0e-3)]
    }

    /// The SPD3303X-E and the DP832 without an A have steps of 10 mV and 10 mA.
    fn coarse_step(&self) -> Option<f64> {
        Some(0.01)
    }

    fn measure(&self) -> [&'static str; 2] {
        ["MEAS:VOLT? CH1", "MEAS:CURR? CH1"]
    }
}
