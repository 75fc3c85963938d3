//! Kepco BOP of any rating. Two families differ in how the analog input is selected: BOP-MG/-GL select it by
//! command (`CURR:MODE EXT`, manual BOP 1KW-MG, section 3.5.6), the linear BOP 20-20 with a BIT
//! card by switches and wiring, and there `EXT` is an unknown keyword.
//!
//! Numbers are sent as plain `%.4f`: the parser of the instrument drops digits silently if there
//! are more than four before the point.

use std::sync::{Mutex, PoisonError};

use instruments_domain::units::{Amps, Hertz, Volts};
use instruments_link::link::LinkProfile;

use super::{AnalogSelect, Capabilities, Dialect, Holds, Limits, Rating};
use crate::{
    exchange::{Bound, Exchange, Expect, Identity, ON_OFF, Says, Setting, Shows, Way},
    instrument::{Model, ms},
};

/// Kepco BOP 1KW 50-20MG/GL, analog input selected by command: the 20 A member of the family.
pub(super) const BOP_MG: Kepco = Kepco {
    key: "kepco-bop-mg",
    analog_select: AnalogSelect::Command,
    rating: None,
};
/// Kepco BOP 20-20M/D/ML, linear, with a BIT card.
pub(super) const BOP_LINEAR: Kepco = Kepco {
    key: "kepco-bop-linear",
    analog_select: AnalogSelect::Wiring,
    rating: None,
};
/// Members with a rating from a bench file. A dialect lives as long as the process.
static MEMBERS: Mutex<Vec<&'static Kepco>> = Mutex::new(Vec::new());

/// Decimals of sent numbers.
const DECIMALS: usize = 4;
/// Tolerance of read-backs, as a share of the rated value and at least, V or A: the display of a
/// 20 A instrument rounds to a milliampere.
const READ_BACK: (f64, f64) = (2.5e-4, 5.0e-3);

/// The linear units end at 400 W, the switching ones have 1 kW.
const SWITCHING_FROM_W: f64 = 1000.0;
/// Full scale of the models unless the bench file states a rating.
const FULL_SCALE: Amps = Amps(20.0);
/// Greatest difference between a rating in the bench file and in the identity, as a share.
const SAME: f64 = 1.0e-3;

pub(super) struct Kepco {
    key: &'static str,
    analog_select: AnalogSelect,
    rating: Option<Rating>,
}

impl Kepco {
    fn full_scale(&self) -> Amps {
        self.rating.map_or(FULL_SCALE, |rating| Amps(rating.amps))
    }

    fn read_back_a(&self) -> f64 {
        (READ_BACK.0 * self.full_scale().value()).max(READ_BACK.1)
    }

    fn read_back_v(&self) -> f64 {
        (READ_BACK.0 * self.rating.map_or(0.0, |rating| rating.volts)).max(READ_BACK.1)
    }

    /// Checks the rating in an identity.
    fn is_rated(&self, found: Rating) -> bool {
        let same = |one: f64, other: f64| (one - other).abs() <= SAME * other;
        match self.rating {
            Some(rating) => same(found.volts, rating.volts) && same(found.amps, rating.amps),
            None => (found.amps - FULL_SCALE.value()).abs() < 0.5,
        }
    }
}

/// Source of a command or a limit.
const FOLLOWS: Says = Says::States(&[
    (Shows::Word("FIX"), "its own setting"),
    (Shows::Word("FIXED"), "its own setting"),
    (Shows::Word("EXT"), "its analog input"),
    (Shows::Word("EXTERNAL"), "its analog input"),
    (Shows::Word("LESS"), "the lesser of both"),
    (Shows::Word("LIST"), "a list"),
    (Shows::Word("TRANS"), "a transient"),
    (Shows::Word("GAIN"), "its analog input, scaled"),
]);

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting::switch("OUTP?", "output", ON_OFF),
    Setting::state(
        "OUTP:MODE?",
        "state of the output when off",
        Says::States(&[
            (Shows::Word("BATTERY"), "open"),
            (Shows::Word("BATT"), "open"),
            (Shows::Word("ACTIVE"), "held at zero"),
            (Shows::Word("ACT"), "held at zero"),
            (Shows::Word("RESISTIVE"), "resistive"),
            (Shows::Word("RES"), "resistive"),
        ]),
    ),
    Setting::state(
        "FUNC:MODE?",
        "mode",
        Says::States(&[
            (Shows::Word("1"), "constant current"),
            (Shows::Word("CURR"), "constant current"),
            (Shows::Word("0"), "constant voltage"),
            (Shows::Word("VOLT"), "constant voltage"),
        ]),
    ),
    Setting::state("CURR:MODE?", "command", FOLLOWS),
    Setting::state("SYST:REM?", "remote control", ON_OFF)
        .optional("whether messages or the panel control it"),
    Setting::state("VOLT:PROT:MODE?", "limit of the voltage", FOLLOWS),
    Setting::state("CURR:PROT:MODE?", "limit of the current", FOLLOWS),
    Setting::number("CURR:LIM?", "limit of the current", "A"),
    Setting::number("CURR?", "current", "A"),
    Setting::number("VOLT?", "voltage", "V"),
];

impl Model for Kepco {
    fn key(&self) -> &'static str {
        self.key
    }

    fn profile(&self) -> LinkProfile {
        // ≈25 ms a command on the LAN card, which loses what comes faster.
        LinkProfile {
            min_gap: ms(35),
            ..LinkProfile::scpi()
        }
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        let raw = &identity.raw;
        let rating = rating(&identity.model);
        let switching =
            raw.contains("1KW") || rating.is_some_and(|rating| rating.watts() >= SWITCHING_FROM_W);
        // The family spans 10 V / 75 A to 200 V / 1 A: volts at the analog input mean other amperes
        // on another member.
        let rated = rating.map(|rating| self.is_rated(rating));
        match self.analog_select {
            AnalogSelect::Command => raw.starts_with("KEPCO") && switching && rated == Some(true),
            // Old cards name themselves instead of their unit; no linear unit has more than 20 A.
            AnalogSelect::Wiring => raw.starts_with("KEPCO") && !switching && rated.unwrap_or(true),
        }
    }
}

impl Dialect for Kepco {
    fn capabilities(&self) -> Capabilities {
        Capabilities {
            analog_select: self.analog_select,
            // `CURR:LIM` is of the switching family.
            holds: if self.analog_select == AnalogSelect::Command {
                Holds::CurrentAndVoltage
            } else {
                Holds::Voltage
            },
            full_scale: self.full_scale(),
            // The bandwidth is 5 kHz to 10 kHz: at 3 kHz at most a seventh of the amplitude is
            // lost.
            max_freq: Hertz(3000.0),
            analog_full_scale: Volts(10.0),
        }
    }

    fn output(&self, on: bool) -> Vec<Exchange> {
        if on {
            return vec![Exchange::switch("OUTP", true)];
        }
        let off = Exchange::switch("OUTP", false);
        match self.analog_select {
            // The factory setting ACTIVE holds zero volts when off, which shorts a cell; BATTERY
            // opens the output.
            AnalogSelect::Command => vec![
                Exchange::word("OUTP:MODE BATTERY", "OUTP:MODE?", &["BATTERY", "BATT"]),
                off,
            ],
            // A linear one that is off holds zero of what its mode controls: zero amperes leave the
            // cell alone, zero volts do not.
            AnalogSelect::Wiring => vec![
                Exchange::word("FUNC:MODE CURR", "FUNC:MODE?", &["1", "CURR"]),
                off,
            ],
        }
    }

    /// On RS-232 the card takes commands of the output only in remote mode.
    fn remote(&self) -> Vec<Exchange> {
        vec![Exchange::switch("SYST:REM", true)]
    }

    fn zero(&self) -> Vec<Way> {
        match self.analog_select {
            AnalogSelect::Command => {
                vec![Way {
                    name: "its own command, 0 A, instead of the generator's",
                    script: [
                        self.analog(false),
                        vec![Exchange::fixed("CURR", 0.0, DECIMALS, self.read_back_a())],
                    ]
                    .concat(),
                }]
            }
            AnalogSelect::Wiring => Vec::new(),
        }
    }

    fn bounds(&self) -> &'static [Bound] {
        match self.analog_select {
            AnalogSelect::Command => &[Bound {
                query: "CURR:LIM?",
                words: "it is limited to",
                unit: "A",
            }],
            AnalogSelect::Wiring => &[],
        }
    }

    fn prepare(&self, limits: &Limits) -> Vec<Exchange> {
        let mut script = vec![Exchange::word(
            "FUNC:MODE CURR",
            "FUNC:MODE?",
            &["1", "CURR"],
        )];
        if self.analog_select == AnalogSelect::Command {
            // Acts on the main channel, so that the mode comes first.
            script.push(Exchange::word(
                "CURR:MODE FIX",
                "CURR:MODE?",
                &["FIX", "FIXED"],
            ));
        }
        script.push(Exchange::fixed("CURR", 0.0, DECIMALS, self.read_back_a()));
        script.push(Exchange::fixed(
            "VOLT",
            limits.compliance.value(),
            DECIMALS,
            self.read_back_v(),
        ));
        if self.analog_select == AnalogSelect::Command {
            // Left at EXT, pins of the analog port would set the limits and the digital ones have
            // no effect.
            script.push(Exchange::word(
                "VOLT:PROT:MODE FIX",
                "VOLT:PROT:MODE?",
                &["FIX", "FIXED"],
            ));
            script.push(Exchange::word(
                "CURR:PROT:MODE FIX",
                "CURR:PROT:MODE?",
                &["FIX", "FIXED"],
            ));
            // In current mode the protection channel is the voltage; only the software limit bounds
            // the current.
            script.push(both_signs(
                "CURR:LIM",
                limits.current.value(),
                self.read_back_a(),
            ));
        }
        script
    }

    fn analog(&self, on: bool) -> Vec<Exchange> {
        match (self.analog_select, on) {
            (AnalogSelect::Command, true) => vec![Exchange::word(
                "CURR:MODE EXT",
                "CURR:MODE?",
                &["EXT", "EXTERNAL"],
            )],
            (AnalogSelect::Command, false) => vec![Exchange::word(
                "CURR:MODE FIX",
                "CURR:MODE?",
                &["FIX", "FIXED"],
            )],
            (AnalogSelect::Wiring, _) => Vec::new(),
        }
    }

    fn measure(&self) -> [&'static str; 2] {
        ["MEAS:VOLT?", "MEAS:CURR?"]
    }

    fn rated(&self, rating: Rating) -> Result<&'static dyn Dialect, String> {
        let switching = rating.watts() >= SWITCHING_FROM_W;
        if switching != (self.analog_select == AnalogSelect::Command) {
            let other = if switching {
                BOP_MG.key
            } else {
                BOP_LINEAR.key
            };
            return Err(format!(
                "expected model = {other:?} for a BOP {}-{} ({:.0} W), found {:?}",
                rating.volts,
                rating.amps,
                rating.watts(),
                self.key
            ));
        }
        let mut members = MEMBERS.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = members
            .iter()
            .find(|member| member.key == self.key && member.rating == Some(rating))
        {
            return Ok(*known);
        }
        let member: &'static Kepco = Box::leak(Box::new(Kepco {
            key: self.key,
            analog_select: self.analog_select,
            rating: Some(rating),
        }));
        members.push(member);
        Ok(member)
    }
}

/// Returns the rating in a model such as `BOP1KW 50-20` or `BOP 20-20M`.
fn rating(model: &str) -> Option<Rating> {
    model.split_whitespace().find_map(Rating::parse)
}

/// Returns a limit of both signs: its reply is `pos, neg`.
fn both_signs(header: &str, value: f64, tolerance: f64) -> Exchange {
    match Exchange::command(header, |command| command.fixed(value, DECIMALS)) {
        Exchange::Send(message) => Exchange::Set {
            message,
            read_back: format!("{header}?"),
            expect: Expect::Magnitude { value, tolerance },
        },
        refused => refused,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(script: &[Exchange]) -> Vec<&str> {
        script
            .iter()
            .map(|exchange| match exchange {
                Exchange::Send(message)
                | Exchange::Set { message, .. }
                | Exchange::Ask { message, .. }
                | Exchange::Refuse { message, .. } => message.as_str(),
                Exchange::Data { head, .. } => head.as_str(),
            })
            .collect()
    }

    #[test]
    fn the_switching_family_selects_the_analog_input_by_command_and_the_linear_one_never_sends_it()
    {
        let limits = Limits {
            compliance: Volts(5.0),
            current: Amps(3.0),
        };
        assert_eq!(
            words(&BOP_MG.prepare(&limits)),
            [
                "FUNC:MODE CURR",
                "CURR:MODE FIX",
                "CURR 0.0000",
                "VOLT 5.0000",
                "VOLT:PROT:MODE FIX",
                "CURR:PROT:MODE FIX",
                "CURR:LIM 3.0000"
            ]
        );
        assert_eq!(words(&BOP_MG.analog(true)), ["CURR:MODE EXT"]);
        assert_eq!(
            words(&BOP_LINEAR.prepare(&limits)),
            ["FUNC:MODE CURR", "CURR 0.0000", "VOLT 5.0000"]
        );
        assert_eq!(BOP_LINEAR.analog(true), []);
        // The described limit is the limit that is sent.
        for supply in [&BOP_MG, &BOP_LINEAR] {
            let sent = words(&supply.prepare(&limits))
                .iter()
                .any(|message| message.starts_with("CURR:LIM "));
            assert_eq!(
                supply.capabilities().holds == Holds::CurrentAndVoltage,
                sent,
                "{}",
                supply.key
            );
        }
    }

    #[test]
    fn a_unit_of_the_other_family_or_another_rating_is_not_taken_for_ones_own() {
        for (answer, switching, linear) in [
            ("KEPCO,BOP1KW 50-20 ,E156884, 2.01", true, false),
            ("KEPCO,BOP 50-20,E1234,2.6", true, false),
            ("KEPCO,BOP 50-20MG,E1234,2.6", true, false),
            ("KEPCO,BOP1KW 20-50 ,E156884, 2.01", false, false),
            ("KEPCO,BOP1KW,E156884,2.01", false, false),
            ("KEPCO,BOP 20-20M,E1234,2.6", false, true),
            ("KEPCO,BOP 100-1M,E1234,2.6", false, false),
            ("KEPCO BOP BIT232 REV. 3.1", false, true),
            ("ACME,BOP 20-20,1,1", false, false),
        ] {
            let identity = Identity::parse(answer);
            assert_eq!(
                (
                    BOP_MG.recognises(&identity),
                    BOP_LINEAR.recognises(&identity)
                ),
                (switching, linear),
                "{answer}"
            );
        }
    }

    #[test]
    fn a_unit_of_another_rating_is_described_by_its_volts_and_amperes() {
        let of = |key: &str, rating: &str| super::super::dialect(key, Rating::parse(rating));
        for (key, rating, own, other) in [
            (
                "kepco-bop-linear",
                "36-12M",
                "KEPCO,BOP 36-12M,E1,2.6",
                "KEPCO,BOP 20-20M,E1,2.6",
            ),
            (
                "kepco-bop-linear",
                "20-10",
                "KEPCO,BOP 20-10M,E1,2.6",
                "KEPCO,BOP 50-8M,E1,2.6",
            ),
            (
                "kepco-bop-mg",
                "20-50MG",
                "KEPCO,BOP1KW 20-50 ,E1, 2.01",
                "KEPCO,BOP1KW 50-20,E1,1",
            ),
        ] {
            let dialect = of(key, rating).unwrap();
            let amps = Rating::parse(rating).unwrap().amps;
            assert_eq!(dialect.capabilities().full_scale, Amps(amps), "{rating}");
            assert!(dialect.recognises(&Identity::parse(own)), "{rating}: {own}");
            assert!(
                !dialect.recognises(&Identity::parse(other)),
                "{rating}: {other}"
            );
            // One dialect for one rating, however often a bench file is read.
            assert!(
                std::ptr::addr_eq(dialect, of(key, rating).unwrap()),
                "{rating}"
            );
        }
        assert_eq!(
            of("kepco-bop-linear", "20-50MG").err().as_deref(),
            Some(
                "expected model = \"kepco-bop-mg\" for a BOP 20-50 (1000 W), found \
                \"kepco-bop-linear\""
            )
        );
        assert!(of("caenels-fast-ps", "20-20").is_err());
        for wrong in ["36", "36-", "-12", "36-12 M", "0-12", "36-x", "36/12"] {
            assert_eq!(Rating::parse(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn switching_off_never_shorts_the_cell() {
        assert_eq!(
            words(&BOP_MG.output(false)),
            ["OUTP:MODE BATTERY", "OUTP OFF"]
        );
        assert_eq!(
            words(&BOP_LINEAR.output(false)),
            ["FUNC:MODE CURR", "OUTP OFF"]
        );
    }
}
