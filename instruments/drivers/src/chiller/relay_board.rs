//! A serial board with a DS18B20 in the bath and two relays, for a heater and a cooler
//! (`docs/thermostat.md`). It has no set-point: the daemon closes the loop with pulses that end
//! automatically.
//!
//! The sensor's reply is the text of the Linux kernel's `w1_slave`: nine bytes, their checksum,
//! `YES` or `NO`, and `t=` in thousandths of a degree. It is accepted if bytes, checksum and number
//! agree, and if it is not the 85 °C that the sensor reports before its first conversion.

use instruments_domain::units::Celsius;
use instruments_link::link::{Grammar, LinkProfile};

use super::{Dialect, Status};
use crate::{
    exchange::{Exchange, Expect, Identity, Way},
    instrument::{Model, ms},
};

/// The board.
pub(super) const RELAY_BOARD: RelayBoard = RelayBoard;

/// Longest pulse, s.
const LONGEST_S: f64 = 60.0;
/// Shortest pulse, s.
const SHORTEST_S: f64 = 0.01;
/// The register of a sensor that was just switched on: 85 °C.
const POWER_ON: i16 = 0x0550;

pub(super) struct RelayBoard;

impl Model for RelayBoard {
    fn key(&self) -> &'static str {
        "relay-thermostat"
    }

    fn profile(&self) -> LinkProfile {
        // A conversion of 12 bits takes 750 ms.
        LinkProfile {
            grammar: Grammar::Plain,
            min_gap: ms(10),
            timeout: ms(3_000),
            error_query: None,
            ..LinkProfile::scpi()
        }
    }

    fn identity_query(&self) -> &'static str {
        "ID"
    }

    fn recognises_folded(&self, identity: &Identity) -> bool {
        identity.raw.starts_with("THERMOSTAT BOARD")
    }
}

/// Returns a confirmed command with the state that it must leave.
fn switched(message: String, state: &'static str) -> Exchange {
    let expect = Expect::Contains(format!("OK {state}"));
    Exchange::Ask {
        message,
        expect,
        read_back: Some(("STATE".to_owned(), Expect::Contains(state.to_owned()))),
    }
}

impl Dialect for RelayBoard {
    fn range(&self) -> (Celsius, Celsius) {
        (Celsius(10.0), Celsius(60.0))
    }

    /// Switches both relays off: the daemon holds the set-point.
    fn run(&self, _: Option<Celsius>) -> Vec<Exchange> {
        vec![switched("OFF".to_owned(), "OFF")]
    }

    fn pulse(&self, seconds: f64) -> Option<Vec<Exchange>> {
        let (word, length_s) = if seconds < 0.0 {
            ("COOL", -seconds)
        } else {
            ("HEAT", seconds)
        };
        Some(match length_s {
            0.0 => self.run(None),
            length_s if length_s <= LONGEST_S => {
                vec![switched(format!("{word} {length_s:.2}"), word)]
            }
            _ => {
                let reason =
                    format!("expected a pulse of at most {LONGEST_S} s, found {seconds} s");
                vec![Exchange::Refuse {
                    message: word.to_owned(),
                    reason,
                }]
            }
        })
    }

    /// A new pulse replaces the running one and ends automatically.
    fn zero(&self) -> Vec<Way> {
        vec![Way {
            name: "its shortest pulse",
            script: self.pulse(SHORTEST_S).unwrap_or_default(),
        }]
    }

    fn queries(&self) -> [&'static str; 2] {
        ["TEMP", "STATE"]
    }

    fn celsius(&self, answer: &str) -> Option<f64> {
        let words: Vec<&str> = answer.split_whitespace().collect();
        let bytes: Vec<u8> = words
            .iter()
            .take(9)
            .map_while(|word| u8::from_str_radix(word, 16).ok())
            .collect();
        let (sum, payload) = bytes
            .split_last()
            .filter(|(_, payload)| payload.len() == 8)?;
        let raw = i16::from_le_bytes([*payload.first()?, *payload.get(1)?]);
        let stated: f64 = words
            .iter()
            .find_map(|word| word.strip_prefix("t="))?
            .parse()
            .ok()?;
        let celsius = f64::from(raw) / 16.0;
        let sound = words.contains(&"YES")
            && sum_of(payload) == *sum
            && (stated / 1000.0 - celsius).abs() < 2.0e-3
            && raw != POWER_ON;
        sound.then_some(celsius)
    }

    fn status(&self, answer: &str) -> Status {
        let raw = answer.trim().to_owned();
        let known = raw == "OFF" || raw.starts_with("HEAT ") || raw.starts_with("COOL ");
        Status {
            running: known,
            remote: true,
            alarm: (!known).then(|| format!("an answer that is not a state: {raw}")),
            raw,
        }
    }
}

/// Returns the cyclic checksum of the 1-Wire bus (Maxim application note 27).
fn sum_of(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| {
        (0..8).fold(sum ^ byte, |sum, _| {
            if sum & 1 == 1 {
                sum >> 1 ^ 0x8c
            } else {
                sum >> 1
            }
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reading_is_believed_only_when_bytes_sum_and_number_agree() {
        let of =
            |first: &str, rest: &str| format!("{first} 01 4b 46 7f ff 0e 10 57 : crc=57 {rest}");
        for (answer, celsius) in [
            (
                of("72", "YES 72 01 4b 46 7f ff 0e 10 57 t=23125"),
                Some(23.125),
            ),
            (of("72", "NO 72 01 4b 46 7f ff 0e 10 57 t=23125"), None),
            (of("73", "YES t=23187"), None),
            (of("72", "YES t=23000"), None),
            (of("72", "YES"), None),
            (
                "50 05 4b 46 7f ff 0c 10 1c : crc=1c YES 50 05 4b 46 7f ff 0c 10 1c t=85000"
                    .to_owned(),
                None,
            ),
            (
                "00 00 00 00 00 00 00 00 00 : crc=00 NO t=0".to_owned(),
                None,
            ),
            ("ERR no sensor".to_owned(), None),
            (String::new(), None),
        ] {
            assert_eq!(RELAY_BOARD.celsius(&answer), celsius, "{answer}");
        }
    }
}
