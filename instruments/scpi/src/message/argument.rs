//! Arguments of a program message (IEEE 488.2 clause 7.7; channel lists after SCPI-1999 volume
//! 1, 8.3.2).

use super::ProgramError;
use crate::{
    block::{self, BlockHeader},
    excerpt,
    number::{self, NumberError, Quantity},
    text_of,
};

/// Most channels that one list may expand to; a list such as `(@1:999999999)` is refused instead of
/// filling the memory.
pub const MAX_CHANNELS: usize = 1024;

/// One argument.
#[derive(Debug, Clone, PartialEq)]
pub enum Argument {
    /// A decimal number with the suffix behind it, if any; [`Quantity::si`] reads it in the unit
    /// that is expected.
    Number(Quantity),
    /// `#H1F`, `#Q17` or `#B101`.
    NonDecimal(u64),
    /// A string with its quotes taken off.
    Text(String),
    /// A channel list, expanded: `(@1,3:5)` is 1, 3, 4, 5.
    Channels(Vec<u32>),
    /// Any other expression in parentheses, without them.
    Expression(String),
    /// Character data as written: `MIN`, `ON`, `SINE`.
    Word(String),
    /// The payload of a block.
    Block(Vec<u8>),
}

impl Argument {
    /// Returns whether the argument is character data equal to the keyword in `pattern`, in manual
    /// notation (`MAXimum`): long or short form, in any case.
    pub fn is_word(&self, pattern: &str) -> bool {
        let short_len = pattern
            .bytes()
            .take_while(|byte| !byte.is_ascii_lowercase())
            .count();
        let short = pattern.get(..short_len).unwrap_or(pattern);
        matches!(self, Self::Word(word) if word.eq_ignore_ascii_case(pattern) || word.eq_ignore_ascii_case(short))
    }

    /// Returns the argument as a number in `unit`; see [`Quantity::si`].
    ///
    /// # Errors
    /// [`NumberError`] if it is not a decimal number or has another unit.
    pub fn number(&self, unit: &str) -> Result<f64, NumberError> {
        match self {
            Self::Number(quantity) => quantity.si(unit),
            Self::NonDecimal(value) => Ok(*value as f64),
            Self::Word(word) => number::parse_f64(word),
            other => Err(NumberError::NotANumber(
                format!("{other:?}").chars().take(60).collect(),
            )),
        }
    }

    /// Returns the argument as a Boolean: `ON`, `OFF`, or a number that rounds to zero or not
    /// (SCPI-1999 volume 1, 7.3).
    ///
    /// # Errors
    /// [`NumberError::NotABoolean`] for any other argument.
    pub fn boolean(&self) -> Result<bool, NumberError> {
        match self {
            Self::Number(quantity) if quantity.suffix.is_empty() && quantity.value.is_finite() => {
                Ok(quantity.value.round() != 0.0)
            }
            Self::Word(word) => number::parse_bool(word),
            other => Err(NumberError::NotABoolean(
                format!("{other:?}").chars().take(60).collect(),
            )),
        }
    }
}

/// Returns whether a character is white space within a message: every control character but NL, and
/// the blank (IEEE 488.2 clause 7.4.1.2).
pub(super) fn is_blank(byte: u8) -> bool {
    byte <= b' '
}

pub(super) fn skip_blanks(text: &[u8]) -> &[u8] {
    let start = text
        .iter()
        .position(|&byte| !is_blank(byte))
        .unwrap_or(text.len());
    text.get(start..).unwrap_or_default()
}

/// Reads the arguments up to the end of the unit; answers them and what follows, from `;` on.
pub(super) fn parse_all(text: &[u8]) -> Result<(Vec<Argument>, &[u8]), ProgramError> {
    let mut arguments = Vec::new();
    let mut rest = skip_blanks(text);
    if matches!(rest.first(), None | Some(b';')) {
        return Ok((arguments, rest));
    }
    loop {
        let (argument, after) = parse_one(rest)?;
        arguments.push(argument);
        rest = skip_blanks(after);
        match rest.first() {
            None | Some(b';') => return Ok((arguments, rest)),
            Some(b',') => rest = skip_blanks(rest.get(1..).unwrap_or_default()),
            Some(_) => return Err(ProgramError::Separator(excerpt(rest))),
        }
    }
}

fn parse_one(text: &[u8]) -> Result<(Argument, &[u8]), ProgramError> {
    match text {
        [] | [b';' | b',', ..] => Err(ProgramError::MissingArgument(excerpt(text))),
        [quote @ (b'"' | b'\''), inner @ ..] => string(text, *quote, inner),
        [b'(', inner @ ..] => expression(text, inner),
        [b'#', b'0'..=b'9', ..] => block_data(text),
        [b'#', ..] => {
            let (word, rest) = split_word(text);
            let value = number::parse_non_decimal(&text_of(word)).map_err(ProgramError::Number)?;
            Ok((Argument::NonDecimal(value), rest))
        }
        [b'0'..=b'9' | b'+' | b'-' | b'.', ..] => decimal(text),
        _ => {
            let (word, rest) = split_word(text);
            if word.is_ascii() {
                Ok((Argument::Word(text_of(word)), rest))
            } else {
                Err(ProgramError::CharacterData(excerpt(word)))
            }
        }
    }
}

/// Parses a number and the suffix after it; blanks may separate the two.
fn decimal(text: &[u8]) -> Result<(Argument, &[u8]), ProgramError> {
    let digits = number::decimal_length(text);
    let suffix_at = text.len() - skip_blanks(text.get(digits..).unwrap_or_default()).len();
    let end = if text.get(suffix_at).is_some_and(u8::is_ascii_alphabetic) || digits == 0 {
        suffix_at
            + split_word(text.get(suffix_at..).unwrap_or_default())
                .0
                .len()
    } else {
        digits
    };
    let (number, rest) = text.split_at_checked(end).unwrap_or((text, &[]));
    number::parse_quantity(&text_of(number))
        .map(|quantity| (Argument::Number(quantity), rest))
        .map_err(ProgramError::Number)
}

fn split_word(text: &[u8]) -> (&[u8], &[u8]) {
    let end = text
        .iter()
        .position(|&byte| is_blank(byte) || matches!(byte, b',' | b';'))
        .unwrap_or(text.len());
    text.split_at_checked(end).unwrap_or((text, &[]))
}

/// Parses a string, in which quotes are doubled.
fn string<'a>(
    whole: &[u8],
    quote: u8,
    inner: &'a [u8],
) -> Result<(Argument, &'a [u8]), ProgramError> {
    let mut value = Vec::new();
    let mut rest = inner;
    loop {
        match rest {
            [] => return Err(ProgramError::OpenString(excerpt(whole))),
            [first, second, after @ ..] if *first == quote && *second == quote => {
                value.push(quote);
                rest = after;
            }
            [first, after @ ..] if *first == quote => {
                return Ok((Argument::Text(text_of(&value)), after));
            }
            [first, after @ ..] => {
                value.push(*first);
                rest = after;
            }
        }
    }
}

fn expression<'a>(whole: &[u8], inner: &'a [u8]) -> Result<(Argument, &'a [u8]), ProgramError> {
    let mut depth = 1_usize;
    for (index, byte) in inner.iter().enumerate() {
        match byte {
            b'(' => depth += 1,
            b')' => depth -= 1,
            _ => {}
        }
        if depth == 0 {
            let (body, rest) = inner.split_at_checked(index).unwrap_or((inner, &[]));
            let rest = rest.get(1..).unwrap_or_default();
            let body = text_of(body);
            let argument = match body.trim_start().strip_prefix('@') {
                Some(list) => Argument::Channels(
                    channels(list).ok_or_else(|| ProgramError::Channels(excerpt(whole)))?,
                ),
                None => Argument::Expression(body),
            };
            return Ok((argument, rest));
        }
    }
    Err(ProgramError::OpenExpression(excerpt(whole)))
}

fn channels(list: &str) -> Option<Vec<u32>> {
    let mut expanded = Vec::new();
    for entry in list.split(',') {
        let (first, last) = entry.split_once(':').unwrap_or((entry, entry));
        let (first, last): (u32, u32) = (first.trim().parse().ok()?, last.trim().parse().ok()?);
        let room = MAX_CHANNELS - expanded.len();
        if last < first || (last - first) as usize >= room {
            return None;
        }
        expanded.extend(first..=last);
    }
    Some(expanded)
}

fn block_data(text: &[u8]) -> Result<(Argument, &[u8]), ProgramError> {
    let fail = || ProgramError::Block(excerpt(text));
    match block::parse_header(text) {
        BlockHeader::Definite {
            header_len,
            payload_len,
        } => {
            let (payload, rest) = text
                .get(header_len..)
                .and_then(|after| after.split_at_checked(payload_len))
                .ok_or_else(fail)?;
            Ok((Argument::Block(payload.to_vec()), rest))
        }
        // Nothing but the end of the message ends it, so that it takes everything.
        BlockHeader::Indefinite => Ok((
            Argument::Block(text.get(2..).unwrap_or_default().to_vec()),
            &[],
        )),
        BlockHeader::Incomplete | BlockHeader::Invalid => Err(fail()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::parse_program;

    fn arguments(message: &[u8]) -> Vec<Argument> {
        parse_program(message).unwrap().remove(0).arguments
    }

    fn number(value: f64, suffix: &str) -> Argument {
        Argument::Number(Quantity {
            value,
            suffix: suffix.to_owned(),
        })
    }

    #[test]
    fn every_type_of_argument_is_read() {
        let word = |text: &str| Argument::Word(text.to_owned());
        let text = |text: &str| Argument::Text(text.to_owned());
        let table: [(&[u8], Vec<Argument>); 14] = [
            (b"CURR 1500 mA", vec![number(1500.0, "MA")]),
            (
                b"FREQ 2MHZ,-1.5E-3 , .5",
                vec![
                    number(2.0e6 / 1.0e6, "MHZ"),
                    number(-0.0015, ""),
                    number(0.5, ""),
                ],
            ),
            (
                b"*ESE #H1F,#q17,#B101",
                vec![
                    Argument::NonDecimal(31),
                    Argument::NonDecimal(15),
                    Argument::NonDecimal(5),
                ],
            ),
            (
                b"DISP \"a,b;c\",'it''s \"x\"'",
                vec![text("a,b;c"), text("it's \"x\"")],
            ),
            (
                b"ROUT:SCAN (@1,3:5)",
                vec![Argument::Channels(vec![1, 3, 4, 5])],
            ),
            (
                b"VOLT 6,( @ 2 )",
                vec![number(6.0, ""), Argument::Channels(vec![2])],
            ),
            (
                b"CALC (A+(B*2))",
                vec![Argument::Expression("A+(B*2)".to_owned())],
            ),
            (b"VOLT MAX", vec![word("MAX")]),
            (
                b"C1:BSWV WVTP,SINE,FRQ,1000HZ,AMP,4VPP",
                vec![
                    word("WVTP"),
                    word("SINE"),
                    word("FRQ"),
                    number(1000.0, "HZ"),
                    word("AMP"),
                    number(4.0, "VPP"),
                ],
            ),
            (b"MODE:SET 4W", vec![number(4.0, "W")]),
            (
                b"DATA #14a\nb;,1",
                vec![Argument::Block(b"a\nb;".to_vec()), number(1.0, "")],
            ),
            (b"DATA #0a;b,c", vec![Argument::Block(b"a;b,c".to_vec())]),
            (b"VOLT? MIN", vec![word("MIN")]),
            (b"VOLT -INF", vec![number(f64::NEG_INFINITY, "")]),
        ];
        for (message, expected) in table {
            assert_eq!(arguments(message), expected, "{}", message.escape_ascii());
        }
    }

    #[test]
    fn arguments_are_read_as_numbers_booleans_and_words() {
        assert_eq!(arguments(b"CURR 1500 mA")[0].number("A"), Ok(1.5));
        assert_eq!(arguments(b"FREQ 2 MHZ")[0].number("HZ"), Ok(2.0e6));
        assert_eq!(arguments(b"X #H10")[0].number("A"), Ok(16.0));
        assert!(arguments(b"X \"1\"")[0].number("A").is_err());
        for (message, expected) in [
            ("X ON", true),
            ("X 0", false),
            ("X 2", true),
            ("X off", false),
            ("X 0.4", false),
        ] {
            assert_eq!(
                arguments(message.as_bytes())[0].boolean(),
                Ok(expected),
                "{message}"
            );
        }
        assert!(arguments(b"X 1 V")[0].boolean().is_err());
        for (word, expected) in [
            ("MAX", true),
            ("maximum", true),
            ("MAXI", false),
            ("MIN", false),
        ] {
            assert_eq!(
                Argument::Word(word.to_owned()).is_word("MAXimum"),
                expected,
                "{word}"
            );
        }
    }

    #[test]
    fn a_list_that_would_fill_the_memory_is_refused() {
        assert_eq!(arguments(b"ROUT (@1:1024)").len(), 1);
        for message in [
            "ROUT (@1:1025)",
            "ROUT (@1:4294967295)",
            "ROUT (@1:1000,1:1000)",
            "ROUT (@)",
            "ROUT (@1:2:3)",
        ] {
            assert!(
                matches!(
                    parse_program(message.as_bytes()),
                    Err(ProgramError::Channels(_))
                ),
                "{message}"
            );
        }
    }
}
