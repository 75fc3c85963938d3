//! Errors of requests to the fleet.

/// Error of a request to the fleet.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FleetError {
    /// The broker does not answer: the outcome of the operation is unknown.
    #[error("the fleet's server does not answer: {0}")]
    Unreachable(String),
    /// A file or a value of the settings is invalid.
    #[error("{0}")]
    Settings(String),
    /// There is no such job or bench.
    #[error("expected {what} of the fleet, found {found:?}")]
    Unknown {
        /// `job` or `bench`.
        what: &'static str,
        /// The requested name.
        found: String,
    },
    /// The request is invalid.
    #[error("{0}")]
    Unfit(String),
    /// The present state does not allow the request.
    #[error("{0}")]
    Conflict(String),
    /// A record cannot be parsed.
    #[error("{key}: expected a record of this version of the fleet, found another: {reason}")]
    Record {
        /// Key of the record.
        key: String,
        /// The reason.
        reason: String,
    },
    /// The server of a bench does not answer: the outcome of the operation is unknown.
    #[error("{0}")]
    Bench(String),
    /// The file system returned an error.
    #[error("{0}")]
    File(String),
}

impl FleetError {
    /// Creates the error of a missing answer.
    pub(crate) fn unreachable(error: &dyn std::fmt::Display) -> Self {
        Self::Unreachable(error.to_string())
    }
}
