//! Errors of a link.

use std::{io, time::Duration};

use instruments_scpi::{
    decode::DecodeError,
    status::{ErrorEntry, StatusError},
};

use crate::transport::{Address, TransportError};

/// A failed exchange. Every text names the instrument, the message and the deadline if there is
/// one.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The address could not be opened.
    #[error("{link}: {source}")]
    Connect {
        /// The instrument.
        link: String,
        /// The reason.
        #[source]
        source: TransportError,
    },
    /// The address did not take the connection in time.
    #[error("{link}: expected {address} to take a connection within {deadline:?}, it did not")]
    ConnectTimeout {
        /// The instrument.
        link: String,
        /// Its address.
        address: Address,
        /// The deadline that passed.
        deadline: Duration,
    },
    /// Another handle of the same link has taken over to switch the instrument off.
    #[error("{link}: another task has taken over the connection, to switch the instrument off")]
    TakenOver {
        /// The instrument.
        link: String,
    },
    /// Virtual time jumps ahead while a real port has an answer under way.
    #[error("{link}: expected a memory: address in virtual time, found {address}")]
    VirtualTime {
        /// The instrument.
        link: String,
        /// Its address.
        address: Address,
    },
    /// The instrument could not discard its pending queries. The link is dropped.
    #[error("{link}: expected {expected} after a device clear, found {found}")]
    NotCleared {
        /// The instrument.
        link: String,
        /// Expected answer.
        expected: String,
        /// Answer that came.
        found: String,
    },
    /// The message contains its own terminator or is not text that an instrument can read. It was
    /// not sent.
    #[error("{link}: expected a message of printable ASCII, found `{message}`; nothing was sent")]
    Unsendable {
        /// The instrument.
        link: String,
        /// The message, escaped.
        message: String,
    },
    /// The message is not valid in the instrument's language, or does not fit the requested
    /// operation. It was not sent.
    #[error("{link}: `{message}`: {reason}; nothing was sent")]
    Malformed {
        /// The instrument.
        link: String,
        /// The message, escaped.
        message: String,
        /// Expected and found answer.
        reason: String,
    },
    /// The message holds a command that must never be sent with a cell in the jig; nothing was
    /// sent.
    #[error(
        "{link}: `{message}` holds {header}, which is never sent to an instrument of this bench; \
        nothing was sent"
    )]
    Forbidden {
        /// The instrument.
        link: String,
        /// The message, escaped.
        message: String,
        /// The command.
        header: &'static str,
    },
    /// The instrument did not take the message in time. The link is dropped.
    #[error("{link}: expected `{message}` to be taken within {deadline:?}, it was not")]
    WriteTimeout {
        /// The instrument.
        link: String,
        /// The message.
        message: String,
        /// The deadline that passed.
        deadline: Duration,
    },
    /// No answer came in time. The link is dropped.
    #[error("{link}: expected an answer to `{message}` within {deadline:?}, found none")]
    Timeout {
        /// The instrument.
        link: String,
        /// The message.
        message: String,
        /// The deadline that passed.
        deadline: Duration,
    },
    /// The instrument closed the connection, or its plug was pulled. The link is dropped.
    #[error("{link}: the connection was closed from the other side at `{message}`")]
    Closed {
        /// The instrument.
        link: String,
        /// The message.
        message: String,
    },
    /// The operating system reports a failure. The link is dropped.
    #[error("{link}: the connection failed at `{message}`: {source}")]
    Io {
        /// The instrument.
        link: String,
        /// The message.
        message: String,
        /// The failure.
        #[source]
        source: io::Error,
    },
    /// The reply is invalid. The link is dropped.
    #[error("{link}: answer to `{message}`: {source}")]
    Garbage {
        /// The instrument.
        link: String,
        /// The message.
        message: String,
        /// Error of the decoder.
        #[source]
        source: DecodeError,
    },
    /// The reply to the error query is invalid. The link is dropped.
    #[error("{link}: answer to `{message}`: {source}")]
    ErrorQueue {
        /// The instrument.
        link: String,
        /// The error query.
        message: String,
        /// Error that the instrument reported.
        #[source]
        source: StatusError,
    },
    /// The instrument does not stop sending. The link is dropped.
    #[error("{link}: expected silence before `{message}`, found {bytes} bytes and no end")]
    Noise {
        /// The instrument.
        link: String,
        /// Message that was to be sent.
        message: String,
        /// Bytes that came unasked.
        bytes: usize,
    },
    /// The instrument put an error into its queue.
    #[error("{link}: `{message}` was refused: {code}, {text}{}", listed(.further))]
    Refused {
        /// The instrument.
        link: String,
        /// The message.
        message: String,
        /// The number of the first error.
        code: i32,
        /// Its text.
        text: String,
        /// The errors after it.
        further: Vec<ErrorEntry>,
    },
    /// The instrument did not accept the setting.
    #[error("{link}: after `{sent}`, `{asked}` answered `{answered}`: expected {expected}")]
    ReadBack {
        /// The instrument.
        link: String,
        /// Message that was sent.
        sent: String,
        /// The query that read it back.
        asked: String,
        /// Its answer.
        answered: String,
        /// Expected value.
        expected: String,
    },
    /// A reply arrived completely, but its content is unusable.
    #[error("{link}: `{asked}` answered `{answered}`: expected {expected}")]
    Unexpected {
        /// The instrument.
        link: String,
        /// The query.
        asked: String,
        /// Its answer.
        answered: String,
        /// Expected value.
        expected: String,
    },
    /// The link was dropped before; nothing was sent.
    #[error("{link}: the link is dropped ({why}); nothing was sent")]
    Dropped {
        /// The instrument.
        link: String,
        /// Why it was dropped.
        why: String,
    },
}

fn listed(entries: &[ErrorEntry]) -> String {
    entries.iter().map(|entry| format!("; {entry}")).collect()
}

impl LinkError {
    /// Returns whether the link is dropped after this error and answers nothing until it is
    /// reconnected.
    pub fn drops_link(&self) -> bool {
        !matches!(
            self,
            Self::Unsendable { .. }
                | Self::Malformed { .. }
                | Self::Forbidden { .. }
                | Self::Refused { .. }
                | Self::ReadBack { .. }
                | Self::Unexpected { .. }
        )
    }

    /// Returns whether the error may disappear if the instrument is queried again on a new
    /// connection: data that were lost, late or garbled on the way, or left in a queue. A setting
    /// that an instrument does not accept, and an invalid message, remain errors.
    pub fn may_pass(&self) -> bool {
        !matches!(
            self,
            Self::VirtualTime { .. }
                | Self::Unsendable { .. }
                | Self::Malformed { .. }
                | Self::Forbidden { .. }
                | Self::ReadBack { .. }
        )
    }

    /// Creates the error for a reply that a driver cannot use.
    pub fn unexpected(link: &str, asked: &str, answered: &str, expected: &str) -> Self {
        let (link, asked) = (link.to_owned(), asked.to_owned());
        Self::Unexpected {
            link,
            asked,
            answered: answered.trim().to_owned(),
            expected: expected.to_owned(),
        }
    }
}
