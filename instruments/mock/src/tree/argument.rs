//! Parameters of commands as the mocks accept them: numbers with their suffixes, keywords of a
//! table, lists of channels.

use std::collections::VecDeque;

use scpi::{
    error::{Error, ErrorCode},
    parser::{mnemonic_compare, parameters::Parameters, tokenizer::Token},
};

use super::{Fallible, fail};

/// One parameter of a command, owned.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Argument {
    /// A decimal number as written, and its suffix in upper case (empty without one).
    Number { digits: String, suffix: String },
    /// Character data as written.
    Word(String),
    /// Text between the parentheses of an expression.
    List(String),
    /// A non-decimal number.
    Bits(u64),
    /// A string or a block, of no use to any of the mocks.
    Other,
}

/// The least, the greatest and the default value of a setting.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Span {
    pub(crate) min: f64,
    pub(crate) max: f64,
    pub(crate) default: f64,
}

/// The parameters of a command, in order.
#[derive(Debug)]
pub(crate) struct Arguments(VecDeque<Argument>);

impl Arguments {
    pub(super) fn read(mut params: Parameters) -> Fallible<Self> {
        let mut items = VecDeque::new();
        while let Some(token) = params.next_optional_token()? {
            items.push_back(match token {
                Token::DecimalNumericProgramData(digits) => Argument::Number {
                    digits: lossy(digits),
                    suffix: String::new(),
                },
                Token::DecimalNumericSuffixProgramData(digits, suffix) => Argument::Number {
                    digits: lossy(digits),
                    suffix: lossy(suffix).to_ascii_uppercase(),
                },
                Token::CharacterProgramData(word) => Argument::Word(lossy(word)),
                Token::ExpressionProgramData(list) => Argument::List(lossy(list)),
                Token::NonDecimalNumericProgramData(bits) => Argument::Bits(bits),
                _ => Argument::Other,
            });
        }
        Ok(Self(items))
    }

    /// Returns the next parameter, if any.
    pub(crate) fn next(&mut self) -> Option<Argument> {
        self.0.pop_front()
    }

    /// Refuses parameters that are left over (−108).
    pub(crate) fn end(&self) -> Fallible {
        if self.0.is_empty() {
            Ok(())
        } else {
            fail(ErrorCode::ParameterNotAllowed)
        }
    }

    /// Returns whether anything is left.
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Returns whether the next parameter is one of these words.
    pub(crate) fn begins_with(&self, words: &[&str]) -> bool {
        match self.0.front() {
            Some(Argument::Word(word)) => {
                words.iter().any(|known| known.eq_ignore_ascii_case(word))
            }
            _ => false,
        }
    }

    fn required(&mut self) -> Fallible<Argument> {
        self.next()
            .ok_or_else(|| Error::new(ErrorCode::MissingParameter))
    }

    /// Returns a number in `unit` (upper case; empty: no suffix allowed), with the SCPI
    /// multipliers.
    pub(crate) fn number(&mut self, unit: &str) -> Fallible<f64> {
        to_number(&self.required()?, unit)
    }

    /// Returns a number, or `MIN`, `MAX`, `DEF` of its span. Not checked against the span.
    pub(crate) fn number_in(&mut self, unit: &str, span: Span) -> Fallible<f64> {
        match self.required()? {
            Argument::Word(word) => {
                named_value(&word, span).ok_or_else(|| Error::new(ErrorCode::IllegalParameterValue))
            }
            other => to_number(&other, unit),
        }
    }

    /// Returns the argument of a query: `MIN`, `MAX` or `DEF` of the span, the value itself without
    /// one.
    pub(crate) fn value_or_named(&mut self, value: f64, span: Span) -> Fallible<f64> {
        match self.next() {
            None => Ok(value),
            Some(Argument::Word(word)) => {
                named_value(&word, span).ok_or_else(|| Error::new(ErrorCode::IllegalParameterValue))
            }
            Some(_) => fail(ErrorCode::ParameterNotAllowed),
        }
    }

    /// `ON`, `OFF` or a number, which means on unless it rounds to zero.
    pub(crate) fn switch(&mut self) -> Fallible<bool> {
        match self.required()? {
            Argument::Word(word) if word.eq_ignore_ascii_case("ON") => Ok(true),
            Argument::Word(word) if word.eq_ignore_ascii_case("OFF") => Ok(false),
            Argument::Word(_) => fail(ErrorCode::IllegalParameterValue),
            other => Ok(to_number(&other, "")?.round() != 0.0),
        }
    }

    /// Returns one keyword of a table written as `LONGform`; a number with a suffix (`20M`) counts
    /// as a keyword.
    pub(crate) fn word(&mut self, table: &[&'static str]) -> Fallible<&'static str> {
        let written = match self.required()? {
            Argument::Word(word) => word,
            Argument::Number { digits, suffix } => digits + &suffix,
            _ => return fail(ErrorCode::DataTypeError),
        };
        let found = table
            .iter()
            .copied()
            .find(|entry| mnemonic_compare(entry.as_bytes(), written.as_bytes()));
        found.ok_or_else(|| Error::new(ErrorCode::IllegalParameterValue))
    }

    /// One of three channels, by its number or as `CH1`: its index.
    pub(crate) fn one_of_three(&mut self) -> Fallible<usize> {
        Ok(match self.word(&["1", "2", "3", "CH1", "CH2", "CH3"])? {
            "1" | "CH1" => 0,
            "2" | "CH2" => 1,
            _ => 2,
        })
    }

    /// Returns a channel list such as `(@101,103:105)`, in the order written.
    pub(crate) fn channels(&mut self) -> Fallible<Vec<u16>> {
        match self.required()? {
            Argument::List(list) => {
                channel_list(&list).ok_or_else(|| Error::new(ErrorCode::InvalidExpression))
            }
            _ => fail(ErrorCode::DataTypeError),
        }
    }
}

fn lossy(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn named_value(word: &str, span: Span) -> Option<f64> {
    let table: [(&[u8], f64); 3] = [
        (b"MINimum", span.min),
        (b"MAXimum", span.max),
        (b"DEFault", span.default),
    ];
    table
        .iter()
        .find(|(name, _)| mnemonic_compare(name, word.as_bytes()))
        .map(|(_, value)| *value)
}

/// Returns a numeric argument in `unit`.
pub(crate) fn to_number(argument: &Argument, unit: &str) -> Fallible<f64> {
    match argument {
        Argument::Number { digits, suffix } => {
            let value: f64 = digits
                .parse()
                .map_err(|_| Error::new(ErrorCode::NumericDataError))?;
            let scale = if suffix.is_empty() {
                Some(1.0)
            } else {
                multiplier(suffix, unit)
            };
            let scale = scale.ok_or_else(|| {
                Error::new(if unit.is_empty() {
                    ErrorCode::SuffixNotAllowed
                } else {
                    ErrorCode::InvalidSuffix
                })
            })?;
            Ok(value * scale)
        }
        #[expect(
            clippy::cast_precision_loss,
            reason = "registers and counts, far below 2^53"
        )]
        Argument::Bits(bits) => Ok(*bits as f64),
        _ => fail(ErrorCode::DataTypeError),
    }
}

/// Returns the factor of a suffix (IEEE 488.2 table 7-2): `M` is milli but for hertz and ohms.
fn multiplier(suffix: &str, unit: &str) -> Option<f64> {
    if unit.is_empty() {
        return None;
    }
    match suffix.strip_suffix(unit)? {
        "" => Some(1.0),
        "G" => Some(1e9),
        "MA" => Some(1e6),
        "M" if matches!(unit, "HZ" | "OHM") => Some(1e6),
        "K" => Some(1e3),
        "M" => Some(1e-3),
        "U" => Some(1e-6),
        "N" => Some(1e-9),
        "P" => Some(1e-12),
        _ => None,
    }
}

/// The most channels that one list may name: more than any scanner has.
const MAX_CHANNELS: usize = 120;

fn channel_list(list: &str) -> Option<Vec<u16>> {
    let mut channels = Vec::new();
    for item in list.strip_prefix('@')?.split(',') {
        let (first, last) = item.split_once(':').unwrap_or((item, item));
        let (first, last): (u16, u16) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
        if first > last || usize::from(last - first) + channels.len() >= MAX_CHANNELS {
            return None;
        }
        channels.extend(first..=last);
    }
    Some(channels)
}
