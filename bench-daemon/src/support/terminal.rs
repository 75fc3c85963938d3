//! Prints to the terminal without failing. A closed reader must not stop a measurement, so the
//! text is dropped; `println!` would panic.

use std::{fmt, io::Write};

/// Writes one line.
pub fn line(mut to: impl Write, text: fmt::Arguments<'_>) {
    let _ = writeln!(to, "{text}").and_then(|()| to.flush());
}

/// A line of a result, on standard output.
macro_rules! say {
    ($($text:tt)*) => { $crate::support::terminal::line(std::io::stdout(), format_args!($($text)*)) };
}

/// A line of a remark, on standard error.
macro_rules! remark {
    ($($text:tt)*) => { $crate::support::terminal::line(std::io::stderr(), format_args!($($text)*)) };
}

pub(crate) use {remark, say};
