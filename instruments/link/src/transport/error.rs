//! Reasons why a transport does not open.

use std::io;

use super::address::Address;

/// An address that could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum TransportError {
    /// The operating system refused.
    #[error("cannot open {address}: {source}")]
    Open {
        /// The address.
        address: Address,
        /// Error of the operating system.
        #[source]
        source: io::Error,
    },
    /// This process has no listener under this name.
    #[error("cannot open memory:{name}: no simulated instrument has this name in this process")]
    NobodyListens {
        /// The name.
        name: String,
    },
    /// The listener has not yet taken in the connections that came before.
    #[error("cannot open memory:{name}: its listener takes in no connections")]
    Busy {
        /// The name.
        name: String,
    },
    /// This name already has a listener.
    #[error("cannot listen on memory:{name}: somebody does already")]
    AlreadyListening {
        /// The name.
        name: String,
    },
}
