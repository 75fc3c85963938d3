//! Julabo CF/F/FL/MS: `IN_`/`OUT_` commands ended by CR, answers by CR LF; writes are never
//! answered, and ignored in manual mode.

use instruments_domain::units::Celsius;
use instruments_link::link::{Grammar, LinkProfile};
use instruments_scpi::decode::Terminator;

use super::{Dialect, HARMLESS_C, Status};
use crate::{
    exchange::{Exchange, Expect, Identity, ON_OFF, Says, Setting, Shows, Way},
    instrument::{Model, ms},
};

/// Julabo refrigerated circulator.
pub(super) const JULABO: Julabo = Julabo;

pub(super) struct Julabo;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::number("IN_SP_00", "set-point", "°C"),
    Setting::switch("IN_MODE_05", "control", ON_OFF),
    Setting::state(
        "IN_MODE_04",
        "sensor",
        Says::States(&[
            (Shows::Word("0"), "its own"),
            (Shows::Word("1"), "an external one"),
        ]),
    )
    .optional("which sensor controls the bath"),
];

impl Model for Julabo {
    fn key(&self) -> &'static str {
        "julabo"
    }

    fn profile(&self) -> LinkProfile {
        // The manual requires 250 ms after a command and 10 ms after a query; messages that arrive
        // a little early are lost silently.
        LinkProfile {
            grammar: Grammar::Plain,
            terminator: Terminator::Cr,
            min_gap: ms(20),
            write_gap: ms(300),
            error_query: None,
            strip_flow_bytes: true,
            ..LinkProfile::scpi()
        }
    }

    fn identity_query(&self) -> &'static str {
        "VERSION"
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        identity.raw.starts_with("JULABO")
    }
}

impl Dialect for Julabo {
    fn range(&self) -> (Celsius, Celsius) {
        (Celsius(-20.0), Celsius(150.0))
    }

    fn run(&self, setpoint: Option<Celsius>) -> Vec<Exchange> {
        match setpoint {
            Some(Celsius(celsius)) => vec![
                // Internal control, on the first set-point: with another one chosen the bath would
                // follow that.
                Exchange::word("OUT_MODE_04 0", "IN_MODE_04", &["0"]),
                Exchange::send("OUT_MODE_01 0"),
                Exchange::number(
                    format!("OUT_SP_00 {celsius:.2}"),
                    "IN_SP_00",
                    celsius,
                    0.006,
                ),
                Exchange::word("OUT_MODE_05 1", "IN_MODE_05", &["1"]),
            ],
            None => vec![Exchange::word("OUT_MODE_05 0", "IN_MODE_05", &["0"])],
        }
    }

    fn zero(&self) -> Vec<Way> {
        vec![Way {
            name: "a set-point of 20 °C",
            script: self.run(Some(HARMLESS_C)),
        }]
    }

    fn setpoint(&self) -> Option<&'static str> {
        Some("IN_SP_00")
    }

    fn queries(&self) -> [&'static str; 2] {
        ["IN_PV_00", "STATUS"]
    }

    /// A warning, or an error in the last command, does not indicate whether it runs.
    fn asks_whether_it_runs(&self, answer: &str) -> Option<(&'static str, Expect)> {
        let code = answer.split_whitespace().next()?.parse::<i32>().ok()?;
        (code < 0).then_some(("IN_MODE_05", Expect::Word(&["1"])))
    }

    fn status(&self, answer: &str) -> Status {
        let raw = answer.trim().to_owned();
        let code = raw
            .split_whitespace()
            .next()
            .and_then(|code| code.parse::<i32>().ok());
        let warning_only = raw.to_ascii_uppercase().contains("WARNING");
        // Codes −08 to −11 report an error in the last command, not in the bath. A status that
        // cannot be parsed counts as an alarm.
        let alarm = code.is_none_or(|code| code < 0 && !(-11..=-8).contains(&code))
            && !(warning_only && code.is_some());
        Status {
            running: matches!(code, Some(1 | 3)),
            remote: !matches!(code, Some(0 | 1)),
            alarm: alarm.then(|| raw.clone()),
            raw,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn status_codes_are_distinguished() {
        for (answer, running, remote, alarm) in [
            ("00 MANUAL STOP", false, false, false),
            ("01 MANUAL START", true, false, false),
            ("02 REMOTE STOP", false, true, false),
            ("03 REMOTE START", true, true, false),
            ("-01 LOW LEVEL ALARM", false, true, true),
            ("-03 EXCESS TEMPERATURE WARNING", false, true, false),
            ("-14 EXCESS TEMPERATURE PROTECTOR ALARM", false, true, true),
            ("-20 WARNING: CLEAN CONDENSOR", false, true, false),
            ("", false, true, true),
            ("23.50", false, true, true),
            (
                "-09 COMMAND NOT ALLOWED IN CURRENT OPERATING MODE",
                false,
                true,
                false,
            ),
        ] {
            let status = JULABO.status(answer);
            assert_eq!(
                (status.running, status.remote, status.alarm.is_some()),
                (running, remote, alarm),
                "{answer}"
            );
        }
    }
}
