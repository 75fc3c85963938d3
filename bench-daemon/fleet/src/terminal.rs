//! Prints results to the terminal without failing: a closed reader must not stop an agent, and
//! `println!` would panic.

use std::{fmt, io::Write};

use serde::Serialize;

use crate::failure::Failure;

/// Writes one line to standard output.
pub(crate) fn line(text: fmt::Arguments<'_>) {
    let mut to = std::io::stdout();
    let _ = writeln!(to, "{text}").and_then(|()| to.flush());
}

/// Writes a line of a result to standard output.
macro_rules! say {
    ($($text:tt)*) => { $crate::terminal::line(format_args!($($text)*)) };
}

pub(crate) use say;

/// Prints a value as JSON, for `--json`.
///
/// # Errors
/// JSON cannot represent the value.
pub(crate) fn say_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value).map_err(std::io::Error::from)?;
    say!("{text}");
    Ok(())
}
