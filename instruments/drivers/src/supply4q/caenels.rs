//! CAENels FAST-PS: `COMMAND:argument` ended by CR, every write confirmed by `#AK` or refused by
//! `#NAK:nn` (vendor's EPICS database and protocol file; list of the refusals from a public
//! driver).
//!
//! In current mode no compliance can be sent. It is not known whether the unit's own limits
//! (`MLIMITS`) bound the analog input; only its rating certainly does. So the driver claims no
//! limit except those that the daemon monitors. Assumed, for lack of a source: the output is open
//! when off; it follows the analog input to 300 Hz.

use instruments_domain::units::{Amps, Hertz, Volts};
use instruments_link::link::{Grammar, LinkProfile};
use instruments_scpi::decode::Terminator;

use super::{AnalogSelect, Capabilities, Dialect, Holds, Limits};
use crate::{
    exchange::{Exchange, Expect, Identity, Says, Setting, Shows, Way},
    instrument::{Model, ms},
};

/// CAENels FAST-PS 2020-400: ±20 A, ±20 V.
pub(super) const FAST_PS: FastPs = FastPs;

const FULL_SCALE: Amps = Amps(20.0);
/// Bit of the status word for an output that is on.
const ON: u32 = 1;
const REFUSALS: &[(&str, &str)] = &[
    ("#NAK:01", "unknown command"),
    ("#NAK:02", "unknown parameter"),
    ("#NAK:05", "not without the password"),
    (
        "#NAK:08",
        "the module is in fault: look why, then clear it with MRESET",
    ),
    ("#NAK:09", "already on"),
    ("#NAK:10", "beyond the hardware's bounds"),
    ("#NAK:11", "beyond the limits set in it"),
    ("#NAK:13", "the module is off"),
    ("#NAK:15", "in local mode: set it to remote at its panel"),
    ("#NAK:20", "this variant does not have that loop"),
    ("#NAK:21", "not in normal update mode"),
    ("#NAK:24", "without the option of an analog input"),
    ("#NAK:38", "it waits to be off"),
];

pub(super) struct FastPs;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch(
        "MST",
        "output",
        Says::States(&[(Shows::Bits(ON, ON), "on"), (Shows::Bits(ON, 0), "off")]),
    ),
    Setting::state(
        "LOOP:?",
        "loop",
        Says::States(&[
            (Shows::Word("#LOOP:I"), "that of the current"),
            (Shows::Word("#LOOP:V"), "that of the voltage"),
        ]),
    ),
    Setting::state(
        "UPMODE:?",
        "command",
        Says::States(&[
            (Shows::Word("#UPMODE:NORMAL"), "its own set-point"),
            (Shows::Word("#UPMODE:ANALOG"), "its analog input"),
            (Shows::Word("#UPMODE:WAVEFORM"), "a waveform of its own"),
            (Shows::Word("#UPMODE:TRIGGER"), "a trigger"),
        ]),
    ),
];

impl Model for FastPs {
    fn key(&self) -> &'static str {
        "caenels-fast-ps"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            grammar: Grammar::Plain,
            terminator: Terminator::Cr,
            min_gap: ms(10),
            error_query: None,
            ..LinkProfile::scpi()
        }
    }

    fn identity_query(&self) -> &'static str {
        "VER"
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        // The first two digits are the rated amperes, the next two the volts: volts at the analog
        // input mean other amperes on another member.
        let rating = identity.raw.strip_prefix("#VER:FAST-PS ");
        rating
            .and_then(|rating| rating.get(..2)?.parse::<f64>().ok())
            .is_some_and(|amps| (amps - FULL_SCALE.value()).abs() < 0.5)
    }
}

/// Returns a command, the replies that count as success, and the query that checks it.
fn confirmed(
    message: &str,
    words: &'static [&'static str],
    query: &str,
    expect: Expect,
) -> Exchange {
    let (message, query) = (message.to_owned(), query.to_owned());
    Exchange::Ask {
        message,
        expect: Expect::Confirmed {
            words,
            refusals: REFUSALS,
        },
        read_back: Some((query, expect)),
    }
}

impl Dialect for FastPs {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            analog_select: AnalogSelect::Command,
            holds: Holds::Nothing,
            full_scale: FULL_SCALE,
            max_freq: Hertz(300.0),
            analog_full_scale: Volts(10.0),
        }
    }

    fn output(&self, on: bool) -> Vec<Exchange> {
        let (message, words): (_, &[_]) = if on {
            ("MON", &["#AK", "#NAK:09"])
        } else {
            ("MOFF", &["#AK", "#NAK:13"])
        };
        vec![confirmed(
            message,
            words,
            "MST",
            Expect::Bits {
                mask: ON,
                bits: u32::from(on),
            },
        )]
    }

    fn zero(&self) -> Vec<Way> {
        let zero = Exchange::Ask {
            message: "MWI:0".to_owned(),
            // An output that is off has no set-point.
            expect: Expect::Confirmed {
                words: &["#AK", "#NAK:13"],
                refusals: REFUSALS,
            },
            read_back: None,
        };
        vec![Way {
            name: "its own command, 0 A, instead of the generator's",
            script: vec![normal(), zero],
        }]
    }

    /// No set-point must be brought to zero: a module that is off has none.
    fn prepare(&self, _: &Limits) -> Vec<Exchange> {
        vec![
            confirmed(
                "LOOP:I",
                &["#AK", "#NAK:19"],
                "LOOP:?",
                Expect::Word(&["#LOOP:I"]),
            ),
            normal(),
        ]
    }

    fn analog(&self, on: bool) -> Vec<Exchange> {
        if !on {
            return vec![normal()];
        }
        vec![confirmed(
            "UPMODE:ANALOG",
            &["#AK"],
            "UPMODE:?",
            Expect::Word(&["#UPMODE:ANALOG"]),
        )]
    }

    fn measure(&self) -> [&'static str; 2] {
        ["MRV", "MRI"]
    }

    fn own_limits(&self) -> Option<&'static str> {
        Some("MLIMITS:?")
    }
}

/// Commands come from messages, not from the analog input, a waveform or a trigger.
fn normal() -> Exchange {
    confirmed(
        "UPMODE:NORMAL",
        &["#AK"],
        "UPMODE:?",
        Expect::Word(&["#UPMODE:NORMAL"]),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_member_of_the_family_is_not_taken_for_this_one() {
        for (answer, own) in [
            ("#VER:FAST-PS 2020-400:1.5.9", true),
            ("#VER:FAST-PS 1020-200:1.5.9", false),
            ("#VER:NGPS 100-50:0.9.01", false),
            ("#VER:FAST-PS", false),
            ("#NAK:01", false),
        ] {
            assert_eq!(
                FAST_PS.recognises(&Identity::parse(answer)),
                own,
                "{answer}"
            );
        }
        let identity = Identity::parse("#VER:FAST-PS 2020-400:1.5.9");
        assert_eq!(
            (
                identity.maker.as_str(),
                identity.model.as_str(),
                identity.firmware.as_str()
            ),
            ("CAENels", "FAST-PS 2020-400", "1.5.9")
        );
    }
}
