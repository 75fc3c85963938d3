//! Piece of an answer as it arrives.

/// A piece of an answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Arrival {
    /// The bytes.
    pub bytes: Vec<u8>,
    /// With the last of them the answer ends.
    pub end: bool,
}
