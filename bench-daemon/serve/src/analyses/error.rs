//! Reasons why an analysis is not taken or not cancelled.

/// Why an analysis is not taken or not cancelled.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    /// The request is invalid.
    #[error("{0}")]
    Unfit(String),
    /// No such analysis.
    #[error("expected the name of an analysis, found {0:?}")]
    Unknown(String),
    /// The request conflicts with the current state.
    #[error("{0}")]
    Conflict(String),
    /// The file system.
    #[error("{0}")]
    Io(String),
}
