//! Program messages, as the controller writes them. What cannot be written safely (a number that is
//! not finite, a text that would end the message) is refused before anything is sent.

use crate::{
    excerpt,
    number::{self, NumberError},
};

/// A command that could not be written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CommandError {
    /// A number that is not finite or too large.
    #[error("`{header}`: {source}")]
    Number {
        /// The header of the command.
        header: String,
        /// Error of the number.
        source: NumberError,
    },
    /// A header or argument with characters that do not belong there.
    #[error("`{header}`: expected {expected}, found `{found}`")]
    Text {
        /// The header of the command.
        header: String,
        /// Text that is allowed at this position.
        expected: &'static str,
        /// Text that was to be written.
        found: String,
    },
}

/// Builds one program message. [`Command::build`] reports the first mistake.
///
/// ```
/// use instruments_scpi::message::Command;
/// # fn main() -> Result<(), instruments_scpi::message::CommandError> {
/// let message = Command::new("SOUR:CURR").fixed(1.5, 3).build()?;
/// assert_eq!(message, "SOUR:CURR 1.500");
///
/// let no_number = Command::new("SOUR:CURR").fixed(f64::NAN, 3).build();
/// assert!(no_number.is_err());
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Command {
    header: String,
    arguments: Vec<String>,
    error: Option<CommandError>,
}

impl Command {
    /// Creates a command with this header: `SOUR:VOLT`, `*CLS`.
    pub fn new(header: &str) -> Self {
        let mut command = Self {
            header: header.to_owned(),
            arguments: Vec::new(),
            error: None,
        };
        let good =
            |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b':' | b'*' | b'_' | b'?');
        if header.is_empty() || !header.bytes().all(good) {
            command.refuse("a header of letters, digits, `_`, `:`, `*` and `?`", header);
        }
        command
    }

    /// Creates a query with this header, without its question mark: `MEAS:VOLT`.
    pub fn query(header: &str) -> Self {
        Self::new(&format!("{header}?"))
    }

    /// Adds a number with exactly `decimals` digits after the point, never with an exponent.
    #[must_use]
    pub fn fixed(mut self, value: f64, decimals: usize) -> Self {
        match number::format_fixed(value, decimals) {
            Ok(text) => self.arguments.push(text),
            Err(source) => {
                let header = self.header.clone();
                self.error
                    .get_or_insert(CommandError::Number { header, source });
            }
        }
        self
    }

    /// Adds a whole number.
    #[must_use]
    pub fn integer(mut self, value: i64) -> Self {
        self.arguments.push(value.to_string());
        self
    }

    /// Adds `ON` or `OFF`.
    #[must_use]
    pub fn on_off(self, on: bool) -> Self {
        self.word(if on { "ON" } else { "OFF" })
    }

    /// Adds character data such as `MAX`.
    #[must_use]
    pub fn word(mut self, word: &str) -> Self {
        let good = |byte: u8| {
            byte.is_ascii_graphic()
                && !matches!(byte, b',' | b';' | b'"' | b'\'' | b'#' | b'(' | b')')
        };
        if word.is_empty() || !word.bytes().all(good) {
            self.refuse("a word of printable characters without separators", word);
        } else {
            self.arguments.push(word.to_owned());
        }
        self
    }

    /// Adds a string in double quotes; a quote inside is doubled.
    #[must_use]
    pub fn string(mut self, text: &str) -> Self {
        if text
            .bytes()
            .all(|byte| byte == b' ' || byte.is_ascii_graphic())
        {
            self.arguments
                .push(format!("\"{}\"", text.replace('"', "\"\"")));
        } else {
            self.refuse("a text of printable ASCII", text);
        }
        self
    }

    /// Adds a channel list: `(@101,102)`.
    #[must_use]
    pub fn channels(mut self, channels: &[u32]) -> Self {
        if channels.is_empty() {
            self.refuse("at least one channel", "");
        } else {
            let list: Vec<String> = channels.iter().map(u32::to_string).collect();
            self.arguments.push(format!("(@{})", list.join(",")));
        }
        self
    }

    /// Returns the message as text, without terminator.
    ///
    /// # Errors
    /// The first [`CommandError`] that was met while building.
    pub fn build(self) -> Result<String, CommandError> {
        match self.error {
            Some(error) => Err(error),
            None if self.arguments.is_empty() => Ok(self.header),
            None => Ok(format!("{} {}", self.header, self.arguments.join(","))),
        }
    }

    fn refuse(&mut self, expected: &'static str, found: &str) {
        let header = excerpt(self.header.as_bytes());
        self.error.get_or_insert_with(|| CommandError::Text {
            header,
            expected,
            found: excerpt(found.as_bytes()),
        });
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::message::{Argument, parse_program};

    #[test]
    fn messages_are_written_as_the_manuals_do() {
        let table = [
            (Command::new("*CLS"), "*CLS"),
            (Command::query("MEAS:VOLT"), "MEAS:VOLT?"),
            (Command::new("VOLT").fixed(-2.5, 4), "VOLT -2.5000"),
            (
                Command::new("VOLT").fixed(6.0, 2).channels(&[1, 2]),
                "VOLT 6.00,(@1,2)",
            ),
            (Command::new("OUTP").on_off(true), "OUTP ON"),
            (
                Command::new("DISP:TEXT").string("say \"no\""),
                "DISP:TEXT \"say \"\"no\"\"\"",
            ),
            (Command::query("SYST:CTYP").integer(100), "SYST:CTYP? 100"),
        ];
        for (command, text) in table {
            assert_eq!(command.build().unwrap(), text);
        }
    }

    #[test]
    fn what_would_break_the_message_is_refused() {
        let table = [
            (
                Command::new("VOLT").fixed(f64::NAN, 4),
                "`VOLT`: expected a finite number to send, found NaN",
            ),
            (
                Command::new("VOLT\nOUTP"),
                "`VOLT\\nOUTP`: expected a header of letters, digits, `_`, `:`, `*` and `?`, found \
                `VOLT\\nOUTP`",
            ),
            (
                Command::new("FUNC").word("A;B"),
                "`FUNC`: expected a word of printable characters without separators, found `A;B`",
            ),
            (
                Command::new("DISP").string("a\nb"),
                "`DISP`: expected a text of printable ASCII, found `a\\nb`",
            ),
            (
                Command::new("ROUT").channels(&[]),
                "`ROUT`: expected at least one channel, found ``",
            ),
            (
                Command::new("X").fixed(f64::INFINITY, 1).word(""),
                "`X`: expected a finite number to send, found inf",
            ),
        ];
        for (command, text) in table {
            assert_eq!(command.build().unwrap_err().to_string(), text);
        }
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_back(
            value in -1.0e6_f64..1.0e6,
            text in "[ -~]{0,20}",
            word in "[A-Z]{1,8}",
            channels in prop::collection::vec(0_u32..2000, 1..5),
        ) {
            let message = Command::new("A:B")
                .fixed(value, 6)
                .string(&text)
                .word(&word)
                .channels(&channels)
                .build()
                .unwrap();
            let units = parse_program(message.as_bytes()).unwrap();
            prop_assert_eq!(units.len(), 1);
            let arguments = &units[0].arguments;
            prop_assert!((arguments[0].number("V").unwrap() - value).abs() <= 5.1e-7);
            prop_assert_eq!(&arguments[1], &Argument::Text(text));
            prop_assert!(arguments[2].is_word(&word));
            prop_assert_eq!(&arguments[3], &Argument::Channels(channels));
        }
    }
}
