//! Huber Pilot ONE, Unistat: the PB commands. `{M` and two hexadecimal digits of a register, then
//! four of a value or `****` to read. The reply to every command is `{S`, the register and its
//! value after limiting. Values are hundredths of a degree in two's complement. Malformed commands
//! get no reply.

use instruments_domain::units::Celsius;
use instruments_link::link::{Grammar, LinkProfile};
use instruments_scpi::decode::Terminator;

use super::{Dialect, HARMLESS_C, Status};
use crate::{
    exchange::{Exchange, Expect, Identity, Says, Setting, Shows, Way},
    instrument::{Model, ms},
};

/// Huber with PB commands.
pub(super) const HUBER: Huber = Huber;

/// Registers: set-point, bath, status word, temperature control.
const SETPOINT: u8 = 0x00;
const CONTROL: u8 = 0x14;
/// Answer of a register that the unit does not have.
const NOT_AVAILABLE: u16 = 0x7fff;
/// Reading of a bath without a sensor, in hundredths of a degree.
const NO_SENSOR: i16 = -15_100;
/// Bits of the status word: temperature control, error, and the one that is clear right after a
/// restart.
const CONTROLLING: u16 = 1;
const ERROR: u16 = 1 << 8;
const UP: u16 = 1 << 14;

pub(super) struct Huber;

/// Descriptions of its settings.
const SETTINGS: &[Setting] = &[
    Setting {
        question: "{M00****",
        name: "set-point",
        says: Says::Hundredths("°C"),
        is_switch: false,
        without: None,
    },
    Setting::switch(
        "{M14****",
        "control",
        Says::States(&[
            (Shows::Text("{S140001"), "on"),
            (Shows::Text("{S140000"), "off"),
        ]),
    ),
];

impl Model for Huber {
    fn key(&self) -> &'static str {
        "huber-pb"
    }

    fn profile(&self) -> LinkProfile {
        LinkProfile {
            grammar: Grammar::Plain,
            terminator: Terminator::CrLf,
            min_gap: ms(20),
            error_query: None,
            ..LinkProfile::scpi()
        }
    }

    /// The instrument has no name query: only the set-point's register identifies the dialect.
    fn identity_query(&self) -> &'static str {
        "{M00****"
    }

    fn settings(&self) -> &'static [Setting] {
        SETTINGS
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        register(&identity.raw).is_some_and(|(address, _)| address == SETPOINT)
    }
}

/// Parses the register and value of a reply.
fn register(answer: &str) -> Option<(u8, u16)> {
    let digits = answer
        .trim()
        .strip_prefix("{S")
        .filter(|digits| digits.len() == 6 && digits.is_ascii())?;
    let address = u8::from_str_radix(&digits[..2], 16).ok()?;
    u16::from_str_radix(&digits[2..], 16)
        .ok()
        .map(|value| (address, value))
}

/// Returns a command that writes a register. The reply must carry the exact value, because a
/// limited value is not the requested one.
fn write(address: u8, value: u16) -> Exchange {
    let tail = format!("{address:02X}{value:04X}");
    let shows = || Expect::Contains(format!("{{S{tail}"));
    let read_back = Some((format!("{{M{address:02X}****"), shows()));
    Exchange::Ask {
        message: format!("{{M{tail}"),
        expect: shows(),
        read_back,
    }
}

/// Hundredths of a degree in two's complement.
fn centidegrees(celsius: f64) -> Option<u16> {
    let hundredths = (celsius * 100.0).round();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within the range"
    )]
    (-15_100.0..=32_000.0)
        .contains(&hundredths)
        .then_some(hundredths as i16 as u16)
}

impl Dialect for Huber {
    fn range(&self) -> (Celsius, Celsius) {
        (Celsius(-20.0), Celsius(150.0))
    }

    fn run(&self, setpoint: Option<Celsius>) -> Vec<Exchange> {
        let Some(Celsius(celsius)) = setpoint else {
            return vec![write(CONTROL, 0)];
        };
        match centidegrees(celsius) {
            Some(value) => vec![write(SETPOINT, value), write(CONTROL, 1)],
            None => vec![Exchange::Refuse {
                message: "{M00".to_owned(),
                reason: format!(
                    "expected a set-point within -151 °C to 320 °C, found {celsius} °C"
                ),
            }],
        }
    }

    fn zero(&self) -> Vec<Way> {
        vec![Way {
            name: "a set-point of 20 °C",
            script: self.run(Some(HARMLESS_C)),
        }]
    }

    fn setpoint(&self) -> Option<&'static str> {
        Some("{M00****")
    }

    fn queries(&self) -> [&'static str; 2] {
        ["{M01****", "{M0A****"]
    }

    fn celsius(&self, answer: &str) -> Option<f64> {
        let (_, value) = register(answer)?;
        let hundredths = value.cast_signed();
        // In this protocol values above 327 °C wrap around to below absolute zero. No cell is that
        // hot, so neither is accepted.
        (value != NOT_AVAILABLE && hundredths > NO_SENSOR).then(|| f64::from(hundredths) / 100.0)
    }

    fn status(&self, answer: &str) -> Status {
        let raw = answer.trim().to_owned();
        let word = register(&raw)
            .map(|(_, value)| value)
            .filter(|value| *value != NOT_AVAILABLE);
        let alarm = match word {
            None => Some(format!("an answer that is not a status word: {raw}")),
            Some(word) if word & ERROR != 0 => Some(format!("error, status word {word:#06x}")),
            Some(_) => None,
        };
        // Right after a restart it may control towards a set-point that is not ours.
        let running = word.is_some_and(|word| word & CONTROLLING != 0 && word & UP != 0);
        Status {
            running,
            remote: true,
            alarm,
            raw,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn temperatures_are_two_s_complement_hundredths_and_what_is_none_is_none() {
        for (answer, celsius) in [
            ("{S0109C4", Some(25.0)),
            ("{S01F6F5", Some(-23.15)),
            ("{S017FFF", None),
            ("{S01C504", None),
            ("{S01FFFF", Some(-0.01)),
            ("{S01", None),
            ("{S01äab", None),
            ("", None),
        ] {
            assert_eq!(HUBER.celsius(answer), celsius, "{answer}");
        }
        assert_eq!(centidegrees(-23.15), Some(0xf6f5));
        assert_eq!((centidegrees(f64::NAN), centidegrees(400.0)), (None, None));
    }

    #[test]
    fn the_status_word_is_read_from_its_least_bit() {
        for (answer, running, alarm) in [
            ("{S0A4001", true, false),
            ("{S0A4003", true, false),
            ("{S0A4000", false, false),
            ("{S0A4101", true, true),
            ("{S0A0001", false, false),
            ("{S0A8000", false, false),
            ("{S0A7FFF", false, true),
            ("nonsense", false, true),
        ] {
            let status = HUBER.status(answer);
            assert_eq!(
                (status.running, status.alarm.is_some()),
                (running, alarm),
                "{answer}"
            );
        }
    }
}
