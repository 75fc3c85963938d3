//! Prints to the terminal without failing. A closed reader must not stop a measurement, so the
//! text is dropped; `println!` would panic.

use std::{fmt, io::Write};

/// Writes one line.
pub fn line(mut to: impl Write, text: fmt::Arguments<'_>) {
    let _ = writeln!(to, "{text}").and_then(|()| to.flush());
}

/// Writes a line of a result to standard output.
#[macro_export]
macro_rules! say {
    ($($text:tt)*) => { $crate::support::terminal::line(std::io::stdout(), format_args!($($text)*)) };
}

/// Writes a line of a remark to standard error.
#[macro_export]
macro_rules! remark {
    ($($text:tt)*) => { $crate::support::terminal::line(std::io::stderr(), format_args!($($text)*)) };
}

pub use {remark, say};
