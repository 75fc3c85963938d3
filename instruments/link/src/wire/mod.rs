//! The wire forms of the transports that carry whole messages, both directions and without a
//! socket: [`rpc`] and [`vxi11`], [`hislip`], [`prologix`].
//!
//! Converts bytes to values and back. The limits that the caller sets bound the memory. The order
//! of messages between the peers is the task of [`crate::transport`] on the client's side and of a
//! simulated instrument on the other.

pub mod hislip;
pub mod prologix;
pub mod rpc;
pub mod vxi11;

/// Bytes that are not a message of the protocol.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found}")]
pub struct WireError {
    expected: String,
    found: String,
}

impl WireError {
    /// Creates an error from the expected and the actual value.
    pub fn new(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self {
            expected: expected.into(),
            found: found.into(),
        }
    }
}

impl From<WireError> for std::io::Error {
    fn from(error: WireError) -> Self {
        Self::new(std::io::ErrorKind::InvalidData, error)
    }
}
