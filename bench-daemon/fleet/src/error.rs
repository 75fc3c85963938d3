//! Errors of requests to the fleet.

/// Why it is not done.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FleetError {
    /// The broker does not answer: the outcome of the operation is unknown.
    #[error("the fleet's server does not answer: {0}")]
    Unreachable(String),
    /// A file or a value of the settings.
    #[error("{0}")]
    Settings(String),
    /// No such job or bench.
    #[error("expected {what} of the fleet, found {found:?}")]
    Unknown {
        /// Kind of the thing.
        what: &'static str,
        /// The name that was found.
        found: String,
    },
    /// The request is not as expected.
    #[error("{0}")]
    Unfit(String),
    /// Not as things are.
    #[error("{0}")]
    Conflict(String),
    /// A record that cannot be understood.
    #[error("{key}: expected a record of this version of the fleet, found another: {reason}")]
    Record {
        /// Key of the record.
        key: String,
        /// Reason, in words.
        reason: String,
    },
    /// The server of a bench does not answer: the outcome of the operation is unknown.
    #[error("{0}")]
    Bench(String),
    /// The file system.
    #[error("{0}")]
    File(String),
}

impl FleetError {
    /// An answer that did not come.
    pub(crate) fn unreachable(error: &dyn std::fmt::Display) -> Self {
        Self::Unreachable(error.to_string())
    }
}
