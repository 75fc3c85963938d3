//! Prints results and remarks. A closed output must not end the work.

use std::{fmt, io::Write};

use serde::Serialize;

use crate::failure::Failure;

/// Prints a line of a result.
pub(crate) fn print_line(text: fmt::Arguments<'_>) {
    let _ = writeln!(std::io::stdout(), "{text}");
}

/// Prints a remark on standard error.
pub(crate) fn print_remark(text: fmt::Arguments<'_>) {
    let _ = writeln!(std::io::stderr(), "eis-archive: {text}");
}

/// Prints a result as JSON.
///
/// # Errors
/// JSON cannot represent the value.
pub(crate) fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value);
    let text = text.map_err(|error| Failure::Store(error.to_string()))?;
    print_line(format_args!("{text}"));
    Ok(())
}
