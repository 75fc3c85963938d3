//! Entries of the error queue, as real instruments answer `SYSTem:ERRor?` (SCPI-1999 volume
//! 2, 21.8), and the classes of error that set bits of the standard event status register
//! (IEEE 488.2 clause 11.5.1).

use std::fmt;

use super::{excerpt, number::decimal_length};

/// One entry of an error queue.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErrorEntry {
    /// The number: zero for no error, negative for SCPI's own, positive for the vendor's.
    pub code: i32,
    /// The text with its quotes taken off; may be empty.
    pub message: String,
}

impl ErrorEntry {
    /// Returns whether the queue was empty.
    pub fn is_ok(&self) -> bool {
        self.code == 0
    }

    /// Returns the bit of the standard event status register that an error of this class sets: 5
    /// command, 4 execution, 3 device, 2 query.
    pub fn event_status_bit(&self) -> Option<u8> {
        match self.code {
            0 => None,
            -199..=-100 => Some(5),
            -299..=-200 => Some(4),
            -499..=-400 => Some(2),
            _ => Some(3),
        }
    }
}

impl fmt::Display for ErrorEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},\"{}\"", self.code, self.message.replace('"', "\"\""))
    }
}

/// A reply that is not an entry of an error queue.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected an error-queue entry such as `0,\"No error\"`, found `{0}`")]
pub struct StatusError(String);

/// Parses one entry: `0,"No error"`, `+0,"No error"`, `-113,"Undefined header;detail"`,
/// `0  No Error`, `-0, No errors`, `0,No Error` or the bare number.
///
/// # Errors
/// [`StatusError`] with the text if it does not start with a whole number, or if anything other
/// than a comma or a blank follows it.
pub fn parse_error(text: &str) -> Result<ErrorEntry, StatusError> {
    let fail = || StatusError(excerpt(text.as_bytes()));
    let trimmed = text.trim();
    let (number, rest) = trimmed
        .split_at_checked(decimal_length(trimmed.as_bytes()))
        .ok_or_else(fail)?;
    let code: i32 = number.parse().map_err(|_| fail())?;
    if !(rest.is_empty() || rest.starts_with(',') || rest.starts_with(char::is_whitespace)) {
        return Err(fail());
    }
    let message = rest.trim_start();
    let message = message.strip_prefix(',').unwrap_or(message).trim();
    Ok(ErrorEntry {
        code,
        message: unquoted(message),
    })
}

/// Removes one pair of quotes and undoubles those inside; text without quotes is unchanged.
fn unquoted(text: &str) -> String {
    ['"', '\'']
        .into_iter()
        .find_map(|quote| {
            let inner = text.strip_prefix(quote)?.strip_suffix(quote)?;
            Some(inner.replace(&format!("{quote}{quote}"), &quote.to_string()))
        })
        .unwrap_or_else(|| text.to_owned())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_variants_of_real_instruments_are_read() {
        let table = [
            ("0,\"No error\"", 0, "No error"),
            ("+0,\"No error\"", 0, "No error"),
            (
                "-113,\"Undefined header;SOUR:VLOT\"",
                -113,
                "Undefined header;SOUR:VLOT",
            ),
            ("0  No Error", 0, "No Error"),
            ("-0, No errors", 0, "No errors"),
            ("0,No Error", 0, "No Error"),
            (" 0 ", 0, ""),
            (
                "-222 , 'Data \"out\" of range'",
                -222,
                "Data \"out\" of range",
            ),
            ("101,\"say \"\"no\"\"\"", 101, "say \"no\""),
            ("5,\"", 5, "\""),
        ];
        for (text, code, message) in table {
            let entry = parse_error(text).unwrap();
            assert_eq!(
                (entry.code, entry.message.as_str()),
                (code, message),
                "{text}"
            );
            assert_eq!(entry.is_ok(), code == 0);
        }
    }

    #[test]
    fn other_answers_are_refused_with_their_text() {
        for text in [
            "",
            "No error",
            "1.5,\"x\"",
            "0x",
            "99999999999,\"x\"",
            "+,\"x\"",
        ] {
            assert!(parse_error(text).is_err(), "{text}");
        }
        assert_eq!(
            parse_error("CURRENT").unwrap_err().to_string(),
            "expected an error-queue entry such as `0,\"No error\"`, found `CURRENT`"
        );
    }

    #[test]
    fn classes_set_their_bits() {
        for (code, bit) in [
            (0, None),
            (-113, Some(5)),
            (-222, Some(4)),
            (-350, Some(3)),
            (-410, Some(2)),
            (201, Some(3)),
        ] {
            assert_eq!(
                ErrorEntry {
                    code,
                    message: String::new()
                }
                .event_status_bit(),
                bit,
                "{code}"
            );
        }
    }

    proptest! {
        #[test]
        fn a_written_entry_is_read_back(code in any::<i32>(), message in "[ -~]{0,40}") {
            let entry = ErrorEntry { code, message };
            prop_assert_eq!(parse_error(&entry.to_string()).unwrap(), entry);
        }
    }
}
