//! The SCPI codec, without input or output: it converts bytes to messages and messages to bytes, on
//! both sides of the wire.
//!
//! The controller's side: [`message::Command`] writes a message, [`decode::ResponseDecoder`] splits
//! the stream into replies, [`message::parse_response`], [`number`], [`block`] and [`status`] parse
//! them. The device's side: [`decode::ProgramFramer`] splits the stream into messages,
//! [`message::parse_program`] parses them, [`header::Pattern`] compares their headers with a
//! manual's notation.
//!
//! After IEEE 488.2-1992 (clauses 7 and 8, the syntax of messages) and SCPI-1999 volume 1. Contains
//! no dialect, no socket and no clock.

pub mod block;
pub mod decode;
mod exercise;
pub mod header;
pub mod message;
pub mod number;
pub mod status;

#[doc(hidden)]
pub use exercise::exercise;

/// How much of a foreign text an error message repeats, characters.
const EXCERPT_CHARS: usize = 60;

/// Returns a short, printable form of foreign bytes for error messages: escaped, and truncated if
/// they are long.
pub fn excerpt(bytes: &[u8]) -> String {
    let mut shown = escaped(&latin1(bytes.get(..EXCERPT_CHARS).unwrap_or(bytes)));
    if bytes.len() > EXCERPT_CHARS {
        shown.push_str(&format!("… ({} bytes)", bytes.len()));
    }
    shown
}

/// Returns text with its control characters and backslashes written as escapes.
fn escaped(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for c in text.chars() {
        if c.is_control() || c == '\\' {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
    }
    shown
}

/// Returns the text of an instrument: UTF-8 if it is valid, otherwise Latin-1, as older firmware
/// writes `°` and `Ω`. Never fails and loses nothing.
pub fn text_of(bytes: &[u8]) -> String {
    std::str::from_utf8(bytes).map_or_else(|_| latin1(bytes), str::to_owned)
}

fn latin1(bytes: &[u8]) -> String {
    bytes.iter().map(|&byte| char::from(byte)).collect()
}
