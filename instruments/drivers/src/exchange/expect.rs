//! Conditions on an answer, and the reading of numbers and fields out of answers. Sends nothing.

use instruments_scpi::{
    message::parse_response,
    number::{parse_bool, parse_quantity},
};

/// Condition that a read-back must meet.
#[derive(Debug, Clone, PartialEq)]
pub enum Expect {
    /// A number, perhaps with a unit behind it, within `tolerance` of `value`.
    Number {
        /// Expected value.
        value: f64,
        /// Greatest allowed difference; covers the rounding of the instrument's display.
        tolerance: f64,
    },
    /// Two numbers of this magnitude: a limit of both signs, answered as `pos, neg`.
    Magnitude {
        /// Expected magnitude.
        value: f64,
        /// Greatest allowed difference.
        tolerance: f64,
    },
    /// A switch in this position, answered as `1`/`0` or `ON`/`OFF`.
    Switch(bool),
    /// One of these keywords, in any case.
    Word(&'static [&'static str]),
    /// One of these keywords. Errors report other replies with their meaning if it is known.
    Confirmed {
        /// Answers that count as done.
        words: &'static [&'static str],
        /// Refusals and their meaning.
        refusals: &'static [(&'static str, &'static str)],
    },
    /// A field of a Siglent `KEY,value,KEY,value` answer with a number within `tolerance` of
    /// `value`.
    Fields(Vec<(&'static str, f64, f64)>),
    /// A field of a Siglent `KEY,value,KEY,value` reply with this keyword.
    FieldWord(&'static str, &'static str),
    /// All of these.
    All(Vec<Expect>),
    /// The answer contains this text, whatever the case.
    Contains(String),
    /// The low bits of a hexadecimal status word: `word & mask == bits`.
    Bits {
        /// Bits that count.
        mask: u32,
        /// Their expected value.
        bits: u32,
    },
}

impl Expect {
    /// Returns the requested number if it is not finite: no instrument may receive it.
    pub(super) fn not_finite(&self) -> Option<f64> {
        match self {
            Self::Number { value, .. } | Self::Magnitude { value, .. } => {
                Some(*value).filter(|value| !value.is_finite())
            }
            Self::Fields(fields) => fields
                .iter()
                .map(|(_, value, _)| *value)
                .find(|value| !value.is_finite()),
            Self::All(all) => all.iter().find_map(Self::not_finite),
            _ => None,
        }
    }

    /// Checks a reply.
    ///
    /// # Errors
    /// The expected reply, as text that follows "expected".
    pub fn judge(&self, answer: &str) -> Result<(), String> {
        match self {
            Self::Number { value, tolerance } => {
                judge_number(answer, *value, *tolerance, "a number")
            }
            Self::Magnitude { value, tolerance } => {
                let fields = parse_response(answer);
                let right = |text: &str| {
                    leading_number(text)
                        .is_some_and(|number| (number.abs() - value).abs() <= *tolerance)
                };
                (fields.len() == 2 && fields.iter().all(|field| right(&field.text)))
                    .then_some(())
                    .ok_or_else(|| {
                        format!("two numbers within {tolerance:.1e} of ±{}", plain(*value))
                    })
            }
            Self::Switch(on) => match parse_bool(answer) {
                Ok(met) if met == *on => Ok(()),
                _ => Err((if *on { "1 or ON" } else { "0 or OFF" }).to_owned()),
            },
            Self::Word(words) => words
                .iter()
                .any(|word| answer.trim().eq_ignore_ascii_case(word))
                .then_some(())
                .ok_or_else(|| format!("one of {}", words.join(", "))),
            Self::Confirmed { words, refusals } => {
                if words.contains(&answer.trim()) {
                    return Ok(());
                }
                let meaning = refusals.iter().find(|(code, _)| *code == answer.trim());
                Err(format!(
                    "{}{}",
                    words.join(" or "),
                    meaning.map_or_else(String::new, |(code, meaning)| format!(
                        " ({code}: {meaning})"
                    ))
                ))
            }
            Self::Fields(fields) => fields.iter().try_for_each(|(key, value, tolerance)| {
                let text = field(answer, key).ok_or_else(|| format!("a field {key}"))?;
                // A long reply is truncated in messages, perhaps before this field.
                judge_number(text, *value, *tolerance, key)
                    .map_err(|expected| format!("{expected}, found {text}"))
            }),
            Self::FieldWord(key, word) => match field(answer, key) {
                Some(met) if met.eq_ignore_ascii_case(word) => Ok(()),
                _ => Err(format!("{key},{word}")),
            },
            Self::All(all) => all.iter().try_for_each(|expect| expect.judge(answer)),
            Self::Contains(text) => answer
                .to_ascii_uppercase()
                .contains(&text.to_ascii_uppercase())
                .then_some(())
                .ok_or_else(|| format!("`{text}` in the answer")),
            Self::Bits { mask, bits } => {
                let word = hex_word(answer).ok_or("a hexadecimal status word")?;
                (word & mask == *bits)
                    .then_some(())
                    .ok_or_else(|| format!("status bits {bits:#06x} under mask {mask:#06x}"))
            }
        }
    }
}

/// Returns the number at the start of a reply, regardless of the unit after it; a header such as
/// `#MRI:` before it is skipped.
pub fn leading_number(answer: &str) -> Option<f64> {
    parse_quantity(after_header(answer))
        .ok()
        .map(|quantity| quantity.value)
}

/// Returns the part of a reply after the `#HEADER:` of protocols that repeat the query, or the
/// whole reply without one.
pub fn after_header(answer: &str) -> &str {
    let named =
        |header: &str| !header.is_empty() && header.bytes().all(|byte| byte.is_ascii_uppercase());
    let header = answer
        .trim()
        .strip_prefix('#')
        .and_then(|rest| rest.split_once(':'));
    header
        .filter(|(header, _)| named(header))
        .map_or(answer, |(_, value)| value)
}

/// Returns the value after `key` in a `KEY,value,KEY,value` list; a header such as `C1:BSWV `
/// before the list is skipped.
pub fn field<'a>(answer: &'a str, key: &str) -> Option<&'a str> {
    let text = answer.trim();
    let list = text
        .split_once(' ')
        .filter(|(header, _)| header.contains(':'))
        .map_or(text, |(_, list)| list);
    let mut parts = list.split(',');
    while let Some(part) = parts.next() {
        if part.trim().eq_ignore_ascii_case(key) {
            return parts.next().map(str::trim);
        }
    }
    None
}

/// Parses a hexadecimal status word such as `0x0224` or `#MST:08000002`.
pub fn hex_word(answer: &str) -> Option<u32> {
    let text = after_header(answer).trim();
    let digits = text
        .strip_prefix("0x")
        .or_else(|| text.strip_prefix("0X"))
        .unwrap_or(text);
    u32::from_str_radix(digits, 16).ok()
}

/// Checks the last field: some replies repeat a keyword before it (`VALue,1.00E+00`).
fn judge_number(answer: &str, value: f64, tolerance: f64, what: &str) -> Result<(), String> {
    match parse_response(answer)
        .last()
        .and_then(|field| leading_number(&field.text))
    {
        Some(number) if (number - value).abs() <= tolerance => Ok(()),
        _ => Err(format!("{what} within {tolerance:.1e} of {}", plain(value))),
    }
}

/// Formats a number as a person writes it: six digits, no exponent or binary rounding artefacts,
/// and no sign before a zero.
pub fn plain(value: f64) -> String {
    let rounded = format!("{value:.5e}").parse::<f64>().unwrap_or(value);
    format!("{}", rounded + 0.0)
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
            ("", None),
            ("ON", None),
        ] {
            assert_eq!(leading_number(answer), number, "{answer}");
        }
    }

    #[test]
    fn an_expectation_says_what_it_wanted() {
        let answer = "C1:BSWV WVTP,SINE,FRQ,1000HZ,PERI,0.001S,AMP,1V,OFST,-0.28V,PHSE,0";
        assert_eq!(
            Expect::Fields(vec![("FRQ", 1000.0, 1e-3), ("OFST", -0.28, 1e-3)]).judge(answer),
            Ok(())
        );
        let refused = Expect::Fields(vec![("AMP", 2.0, 0.01)])
            .judge(answer)
            .unwrap_err();
        assert!(
            refused.contains("AMP") && refused.contains("of 2"),
            "{refused}"
        );
        assert_eq!(
            field("C1:BSWV WVTP, SINE, FRQ, 1000HZ, AMP, 1V", "FRQ"),
            Some("1000HZ")
        );
        assert_eq!(
            Expect::Contains("LOAD,HZ".to_owned()).judge("OUTP OFF,LOAD,50"),
            Err("`LOAD,HZ` in the answer".to_owned())
        );
        let both = Expect::Magnitude {
            value: 3.0,
            tolerance: 0.01,
        };
        for (answer, accepted) in [
            ("3.0E0, -3.0E0", true),
            ("3.0E0", false),
            ("3.0E0, -2.0E1", false),
            ("2.0E1, -3.0E0", false),
            ("", false),
        ] {
            assert_eq!(both.judge(answer).is_ok(), accepted, "{answer}");
        }
        assert!(Expect::Word(&["FIX", "FIXED"]).judge("fixed").is_ok());
        assert!(
            Expect::Word(&["FIX", "FIXED"])
                .judge("EXT")
                .unwrap_err()
                .contains("FIX, FIXED")
        );
        assert!(
            Expect::Switch(true).judge("1").is_ok() && Expect::Switch(false).judge("off").is_ok()
        );
        assert_eq!(Expect::Switch(false).judge("ON").unwrap_err(), "0 or OFF");
        assert!(
            Expect::Bits {
                mask: 0x10,
                bits: 0x10
            }
            .judge("0x0224")
            .is_err()
        );
        assert!(
            Expect::Bits {
                mask: 0x20,
                bits: 0x20
            }
            .judge("0x0224")
            .is_ok()
        );
    }

    #[test]
    fn a_number_is_written_without_what_a_computer_adds() {
        for (value, text) in [
            (0.1 + 0.2, "0.3"),
            (1.2240000000000002, "1.224"),
            (-0.0, "0"),
            (25.0, "25"),
            (12_345.678_9, "12345.7"),
        ] {
            assert_eq!(plain(value), text);
        }
    }
}
