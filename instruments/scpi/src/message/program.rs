//! Program messages, as a device reads them (IEEE 488.2 clause 7, SCPI-1999 volume 1, 6.2.4 for the
//! path that is remembered after `;`).

mod error;

use super::{Argument, argument};
use crate::excerpt;
pub use error::ProgramError;

/// Longest absolute header, bytes. The remembered path could otherwise grow with every unit of a
/// message.
const MAX_HEADER: usize = 255;

/// One unit of a program message.
#[derive(Debug, Clone, PartialEq)]
pub struct ProgramUnit {
    /// The absolute header in capitals, without leading colon and without question mark:
    /// `SOUR:VOLT`, `*IDN`.
    pub header: String,
    /// A question mark followed the header.
    pub query: bool,
    /// The arguments in their order.
    pub arguments: Vec<Argument>,
}

impl ProgramUnit {
    /// Returns the header with its question mark, as [`crate::header::Pattern::matches`] compares
    /// it.
    pub fn full_header(&self) -> String {
        format!("{}{}", self.header, if self.query { "?" } else { "" })
    }
}

/// Reads a whole program message without its terminator: units separated by `;`, each with its
/// absolute header. Blanks around units are trimmed and empty units skipped.
///
/// # Errors
/// [`ProgramError`] for the first unit that breaks the syntax; then no unit of the message is
/// answered.
pub fn parse_program(message: &[u8]) -> Result<Vec<ProgramUnit>, ProgramError> {
    let mut units = Vec::new();
    let mut path = String::new();
    let mut rest = message;
    loop {
        rest = argument::skip_blanks(rest);
        match rest.first() {
            None => return Ok(units),
            Some(b';') => rest = rest.get(1..).unwrap_or_default(),
            Some(_) => {
                let (unit, after) = parse_unit(rest, &mut path)?;
                units.push(unit);
                rest = after;
            }
        }
    }
}

fn parse_unit<'a>(
    text: &'a [u8],
    path: &mut String,
) -> Result<(ProgramUnit, &'a [u8]), ProgramError> {
    let end = text
        .iter()
        .position(|&byte| argument::is_blank(byte) || matches!(byte, b';' | b'?'))
        .unwrap_or(text.len());
    let (written, rest) = text.split_at_checked(end).unwrap_or((text, &[]));
    let (query, rest) = rest
        .strip_prefix(b"?")
        .map_or((false, rest), |rest| (true, rest));
    let header = absolute_header(written, path)?;
    // A question mark ends the header; anything but a blank or `;` right after it belongs to no
    // argument.
    if let Some(&byte) = rest.first()
        && !argument::is_blank(byte)
        && byte != b';'
    {
        return Err(ProgramError::Separator(excerpt(rest)));
    }
    let (arguments, rest) = argument::parse_all(rest)?;
    Ok((
        ProgramUnit {
            header,
            query,
            arguments,
        },
        rest,
    ))
}

/// Resolves a written header against the remembered path and remembers the new one.
fn absolute_header(written: &[u8], path: &mut String) -> Result<String, ProgramError> {
    let shown = || excerpt(written);
    let allowed = |&byte: &u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b':' | b'*');
    if !written.iter().all(allowed) || written.iter().skip(1).any(|&byte| byte == b'*') {
        return Err(ProgramError::InvalidCharacter(shown()));
    }
    let name: String = written
        .iter()
        .map(|&byte| char::from(byte.to_ascii_uppercase()))
        .collect();
    if let Some(common) = name.strip_prefix('*') {
        let good = !common.is_empty() && !common.contains(':') && name.len() <= MAX_HEADER;
        return if good {
            Ok(name)
        } else {
            Err(ProgramError::EmptyMnemonic(shown()))
        };
    }
    let header = match name.strip_prefix(':') {
        Some(absolute) => absolute.to_owned(),
        None if path.is_empty() => name,
        None => format!("{path}:{name}"),
    };
    if header.split(':').any(str::is_empty) {
        return Err(ProgramError::EmptyMnemonic(shown()));
    }
    if header.len() > MAX_HEADER {
        return Err(ProgramError::HeaderTooLong(header.len()));
    }
    *path = header
        .rsplit_once(':')
        .map(|(before, _)| before.to_owned())
        .unwrap_or_default();
    Ok(header)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(message: &str) -> Vec<String> {
        parse_program(message.as_bytes())
            .unwrap()
            .iter()
            .map(ProgramUnit::full_header)
            .collect()
    }

    #[test]
    fn the_path_is_remembered_after_a_semicolon() {
        let table: [(&str, &[&str]); 9] = [
            ("SOUR:VOLT 1;CURR 2", &["SOUR:VOLT", "SOUR:CURR"]),
            ("SOUR:VOLT 1;:OUTP ON", &["SOUR:VOLT", "OUTP"]),
            (
                "SOUR:VOLT 1;*WAI;CURR 2",
                &["SOUR:VOLT", "*WAI", "SOUR:CURR"],
            ),
            (
                ":INSTrument:NSELect 1; :SOURce:VOLTage 2",
                &["INSTRUMENT:NSELECT", "SOURCE:VOLTAGE"],
            ),
            ("A:B 1;C:D 2;E 3", &["A:B", "A:C:D", "A:C:E"]),
            ("VOLT 1;CURR 2", &["VOLT", "CURR"]),
            ("*cls;syst:err?", &["*CLS", "SYST:ERR?"]),
            ("  meas:volt? ;; ", &["MEAS:VOLT?"]),
            ("", &[]),
        ];
        for (message, expected) in table {
            assert_eq!(headers(message), expected, "{message}");
        }
    }

    #[test]
    fn broken_messages_are_named_with_their_standard_number() {
        let table: [(&str, i32, &str); 14] = [
            ("VOL&T 1", -101, "found `VOL&T`"),
            ("A*B", -101, "found `A*B`"),
            ("A::B", -102, "found `A::B`"),
            (":", -102, "found `:`"),
            ("*", -102, "found `*`"),
            (
                "VOLT?1",
                -103,
                "expected a comma or the end after an argument, found `1`",
            ),
            ("VOLT 1 2", -103, "found `2`"),
            (
                "VOLT 1,,2",
                -109,
                "expected an argument on both sides of every comma",
            ),
            ("VOLT 1,", -109, "expected an argument on both sides"),
            ("VOLT +", -121, "expected a number such as 42"),
            (
                "DISP \"abc",
                -151,
                "expected a closing quote, found the end after `\"abc`",
            ),
            (
                "DATA #15abc",
                -161,
                "expected a block with its announced bytes, found `#15abc`",
            ),
            ("ROUT (@1,", -171, "expected a closing parenthesis"),
            (
                "ROUT (@5:1)",
                -171,
                "expected a channel list such as (@101,103:105)",
            ),
        ];
        for (message, code, text) in table {
            let error = parse_program(message.as_bytes()).unwrap_err();
            assert_eq!(error.code(), code, "{message}: {error}");
            assert!(error.to_string().contains(text), "{message}: {error}");
        }
    }

    #[test]
    fn a_path_cannot_grow_without_bound() {
        let message = "AAAAAAAA:B 1;".repeat(5000);
        assert!(
            matches!(parse_program(message.as_bytes()), Err(ProgramError::HeaderTooLong(length)) if length < 300)
        );
    }
}
