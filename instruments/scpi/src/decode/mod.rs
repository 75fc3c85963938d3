//! Cuts byte streams into messages, whatever pieces they arrive in: [`ResponseDecoder`] for the
//! controller, [`ProgramFramer`] for the device.
//!
//! A stream has no frames: the end of a text line is a byte, the end of a block is a count, and the
//! two must not be confused, since a payload may hold every byte (IEEE 488.2 clauses 7.7.6, 8.7.9
//! and 8.9). Memory is bounded on both sides.

mod framer;
mod response;

pub use framer::{FrameError, ProgramFramer};
pub use response::{DecodeError, DecoderOptions, Expect, MAX_PREFIX, Response, ResponseDecoder};

/// Terminator of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Terminator {
    /// NL; a CR before it belongs to it when reading.
    #[default]
    Lf,
    /// CR NL when writing; reads like [`Terminator::Lf`].
    CrLf,
    /// CR alone when writing; when reading, CR and NL both end a message.
    Cr,
}

impl Terminator {
    /// Bytes that are written behind a message.
    pub fn bytes(self) -> &'static [u8] {
        match self {
            Self::Lf => b"\n",
            Self::CrLf => b"\r\n",
            Self::Cr => b"\r",
        }
    }

    fn ends(self, byte: u8) -> bool {
        byte == b'\n' || (self == Self::Cr && byte == b'\r')
    }
}

fn is_line_end(byte: u8) -> bool {
    matches!(byte, b'\r' | b'\n')
}
