//! What a dialect hands to its role: a script of messages, each with what must be true after it. The role plays it through the link.
//!
//! A dialect is sync and sends nothing itself, so that the very texts that go to an instrument can be printed, tested and read beforehand.

use crate::link::{Link, LinkError};

/// One message with its proof.
#[derive(Debug, Clone, PartialEq)]
pub enum Exchange {
    /// Sent; the error queue is asked where the instrument has one.
    Send(String),
    /// Sent, then read back.
    Set {
        /// The command.
        message: String,
        /// The query that shows what the instrument made of it.
        read_back: String,
        /// What the answer must be.
        expect: Expect,
    },
}

/// What a read-back must show.
#[derive(Debug, Clone, PartialEq)]
pub enum Expect {
    /// A number, perhaps with a unit behind it, within `tolerance` of `value`.
    Number {
        /// Expected value.
        value: f64,
        /// Greatest allowed difference; covers the rounding of the instrument's display.
        tolerance: f64,
    },
    /// One of these words, whatever the case.
    Word(&'static [&'static str]),
    /// A field of a Siglent `KEY,value,KEY,value` answer with a number within `tolerance` of `value`.
    Fields(Vec<(&'static str, f64, f64)>),
    /// One or more numbers separated by commas, each of either sign and within `tolerance` of `value`: both sides of a limit.
    Magnitudes {
        /// Expected magnitude.
        value: f64,
        /// Greatest allowed difference.
        tolerance: f64,
    },
    /// The answer contains this text, whatever the case.
    Contains(String),
    /// All of these hold of the one answer.
    All(Vec<Expect>),
    /// The low bits of a hexadecimal status word: `word & mask == bits`.
    Bits {
        /// Bits that count.
        mask: u32,
        /// Their expected value.
        bits: u32,
    },
}

impl Exchange {
    /// A command that is sent and trusted to the error queue.
    pub fn send(message: impl Into<String>) -> Self {
        Self::Send(message.into())
    }

    /// A command whose effect is read back as a number.
    pub fn number(message: impl Into<String>, read_back: impl Into<String>, value: f64, tolerance: f64) -> Self {
        Self::Set { message: message.into(), read_back: read_back.into(), expect: Expect::Number { value, tolerance } }
    }

    /// A command whose effect is read back as one of several words.
    pub fn word(message: impl Into<String>, read_back: impl Into<String>, words: &'static [&'static str]) -> Self {
        Self::Set { message: message.into(), read_back: read_back.into(), expect: Expect::Word(words) }
    }
}

impl Expect {
    /// Judges an answer.
    ///
    /// # Errors
    /// What should have been answered, in words that go behind "expected".
    pub fn judge(&self, answer: &str) -> Result<(), String> {
        match self {
            Self::Number { value, tolerance } => judge_number(answer, *value, *tolerance, "a number"),
            Self::Word(words) => words
                .iter()
                .any(|word| answer.trim().eq_ignore_ascii_case(word))
                .then_some(())
                .ok_or_else(|| format!("one of {}", words.join(", "))),
            Self::Fields(fields) => fields.iter().try_for_each(|(key, value, tolerance)| {
                let text = field(answer, key).ok_or_else(|| format!("a field {key}"))?;
                // A long answer is cut where it is shown, perhaps before this field.
                judge_number(text, *value, *tolerance, key).map_err(|expected| format!("{expected}, found {text}"))
            }),
            Self::Magnitudes { value, tolerance } => answer.split(',').try_for_each(|part| {
                let unsigned = part.trim().trim_start_matches(['+', '-']);
                judge_number(unsigned, *value, *tolerance, "magnitudes")
            }),
            Self::All(expectations) => expectations.iter().try_for_each(|expectation| expectation.judge(answer)),
            Self::Contains(text) => answer
                .to_ascii_uppercase()
                .contains(&text.to_ascii_uppercase())
                .then_some(())
                .ok_or_else(|| format!("`{text}` in the answer")),
            Self::Bits { mask, bits } => {
                let word = hex_word(answer).ok_or("a hexadecimal status word")?;
                (word & mask == *bits).then_some(()).ok_or_else(|| format!("status bits {bits:#06x} under mask {mask:#06x}"))
            }
        }
    }
}

/// Plays a script; stops at the first message that is refused or not believed.
///
/// # Errors
/// The link's error for that message.
pub async fn play(link: &mut Link, script: &[Exchange]) -> Result<(), LinkError> {
    for exchange in script {
        match exchange {
            Exchange::Send(message) => link.send(message).await?,
            Exchange::Set { message, read_back, expect } => link.set(message, read_back, |answer| expect.judge(answer)).await?,
        }
    }
    Ok(())
}

/// Plays a whole script whatever happens in between, for switching off: a message that is refused must not keep the next from being sent.
///
/// # Errors
/// The link's error for the first message that failed.
pub async fn play_all(link: &mut Link, script: &[Exchange]) -> Result<(), LinkError> {
    let mut outcome = Ok(());
    for exchange in script {
        let played = play(link, std::slice::from_ref(exchange)).await;
        outcome = outcome.and(played);
    }
    outcome
}

/// Takes out of the error queue what an earlier client or the power-up left there, which would else be taken for an answer to the first message.
///
/// # Errors
/// The link's.
pub async fn forget_errors(link: &mut Link) -> Result<(), LinkError> {
    for entry in link.drain_errors().await? {
        tracing::warn!(link = link.name(), %entry, "an error from before was in the queue");
    }
    Ok(())
}

/// The number at the start of an answer, whatever unit follows it.
pub fn leading_number(answer: &str) -> Option<f64> {
    let text = answer.trim();
    let mut end = 0;
    let bytes = text.as_bytes();
    while end < bytes.len() {
        let digit = bytes[end].is_ascii_digit() || bytes[end] == b'.';
        let sign = matches!(bytes[end], b'+' | b'-') && (end == 0 || matches!(bytes[end - 1], b'e' | b'E'));
        let exponent = matches!(bytes[end], b'e' | b'E')
            && bytes.get(end + 1).is_some_and(|next| next.is_ascii_digit() || matches!(next, b'+' | b'-'))
            && bytes[..end].iter().any(u8::is_ascii_digit);
        if !(digit || sign || exponent) {
            break;
        }
        end += 1;
    }
    text.get(..end)?.parse().ok()
}

/// The value behind `key` in a `KEY,value,KEY,value` list; a header such as `C1:BSWV ` before the list is skipped.
pub fn field<'a>(answer: &'a str, key: &str) -> Option<&'a str> {
    let answer = answer.trim();
    // Only a blank before the first comma ends a header; later ones are the instrument's way of writing its list.
    let header_end = answer.split(',').next().and_then(|first| first.rfind(' '));
    let list = header_end.and_then(|end| answer.get(end..)).unwrap_or(answer);
    let mut parts = list.split(',');
    while let Some(part) = parts.next() {
        if part.trim().eq_ignore_ascii_case(key) {
            return parts.next().map(str::trim);
        }
    }
    None
}

/// A hexadecimal status word such as `0x0224`.
pub fn hex_word(answer: &str) -> Option<u32> {
    let text = answer.trim();
    let digits = text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")).unwrap_or(text);
    u32::from_str_radix(digits, 16).ok()
}

fn judge_number(answer: &str, value: f64, tolerance: f64, what: &str) -> Result<(), String> {
    match leading_number(answer) {
        Some(number) if (number - value).abs() <= tolerance => Ok(()),
        _ => Err(format!("{what} within {tolerance:.1e} of {value}")),
    }
}

/// What an instrument says of itself.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Identity {
    /// The whole answer.
    pub raw: String,
    /// First field: the maker.
    pub maker: String,
    /// Second field: the model.
    pub model: String,
    /// Third field: the serial number; may be empty.
    pub serial: String,
    /// The rest: firmware.
    pub firmware: String,
}

impl Identity {
    /// Splits an `*IDN?` answer at its commas; answers without commas (old Kepco cards, Julabo) give maker and model by their first blank.
    pub fn parse(raw: &str) -> Self {
        let raw = raw.trim().to_owned();
        let fields: Vec<&str> = raw.split(',').map(str::trim).collect();
        let (maker, model, serial, firmware) = match fields.as_slice() {
            [maker, model, serial, rest @ ..] => ((*maker).to_owned(), (*model).to_owned(), (*serial).to_owned(), rest.join(",")),
            _ => {
                let (maker, model) = raw.split_once(' ').unwrap_or((raw.as_str(), ""));
                (maker.to_owned(), model.to_owned(), String::new(), String::new())
            }
        };
        Self { raw, maker, model, serial, firmware }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_before_their_units() {
        for (answer, number) in [
            ("1000HZ", Some(1000.0)),
            ("-2.5E0", Some(-2.5)),
            ("5.00E-02", Some(0.05)),
            ("+1.000000000000000E+03", Some(1000.0)),
            ("0.5V", Some(0.5)),
            (" 3.25 ", Some(3.25)),
            ("1E", Some(1.0)),
            ("", None),
            ("ON", None),
        ] {
            assert_eq!(leading_number(answer), number, "{answer}");
        }
    }

    #[test]
    fn an_expectation_says_what_it_wanted() {
        let answer = "C1:BSWV WVTP,SINE,FRQ,1000HZ,PERI,0.001S,AMP,1V,OFST,-0.28V,PHSE,0";
        assert_eq!(Expect::Fields(vec![("FRQ", 1000.0, 1e-3), ("OFST", -0.28, 1e-3)]).judge(answer), Ok(()));
        assert_eq!(field("C1:BSWV WVTP, SINE, FRQ, 1000HZ, AMP, 1V", "FRQ"), Some("1000HZ"));
        assert_eq!(field("WVTP,SINE,AMP,1V", "AMP"), Some("1V"));
        let refused = Expect::Fields(vec![("AMP", 2.0, 0.01)]).judge(answer).unwrap_err();
        assert!(refused.contains("AMP") && refused.contains("of 2"), "{refused}");
        assert!(Expect::Word(&["1", "ON"]).judge("on").is_ok());
        assert!(Expect::Word(&["1", "ON"]).judge("OFF").unwrap_err().contains("1, ON"));
        assert_eq!(Expect::Contains("LOAD,HZ".to_owned()).judge("OUTP OFF,LOAD,50"), Err("`LOAD,HZ` in the answer".to_owned()));
        assert!(Expect::Bits { mask: 0x10, bits: 0x10 }.judge("0x0224").is_err());
        let both = Expect::Magnitudes { value: 3.0, tolerance: 0.01 };
        for (answer, accepted) in
            [("3.0E0, -3.0E0", true), ("3.0E0", true), ("3.0E0, -2.0E1", false), ("2.0E1, -3.0E0", false), ("", false)]
        {
            assert_eq!(both.judge(answer).is_ok(), accepted, "{answer}");
        }
        assert!(Expect::Bits { mask: 0x20, bits: 0x20 }.judge("0x0224").is_ok());
    }

    #[test]
    fn identities_of_every_shape_are_read() {
        let kepco = Identity::parse("KEPCO,BOP1KW 50-20 ,E156884, 2.01");
        assert_eq!((kepco.maker.as_str(), kepco.model.as_str(), kepco.serial.as_str()), ("KEPCO", "BOP1KW 50-20", "E156884"));
        let card = Identity::parse("KEPCO BOP BIT232 REV. 3.1");
        assert_eq!((card.maker.as_str(), card.model.as_str()), ("KEPCO", "BOP BIT232 REV. 3.1"));
        let spd = Identity::parse("Siglent Technologies,SPD3303X-E,SPD3XIDQ5R5553,1.01.01.02.07R2,V3.0");
        assert_eq!(spd.firmware, "1.01.01.02.07R2,V3.0");
    }
}
