//! Failures of the program, and their exit codes.

use bench_archive::ArchiveError;

/// Reason why a command has failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Failure {
    /// An argument or a file is invalid.
    #[error("{0}")]
    Usage(String),
    /// The store, or a file, failed an operation.
    #[error("{0}")]
    Store(String),
    /// A run or an object failed its verification.
    #[error("{0}")]
    Differs(String),
}

impl Failure {
    /// Returns the exit code; `eis-archive --help` lists them.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Store(_) => 1,
            Self::Usage(_) => 2,
            Self::Differs(_) => 10,
        }
    }
}

impl From<ArchiveError> for Failure {
    fn from(error: ArchiveError) -> Self {
        let text = error.to_string();
        match error {
            ArchiveError::Setting { .. } | ArchiveError::Record(_) => Self::Usage(text),
            ArchiveError::Refused { .. } | ArchiveError::Waiting { .. } => Self::Differs(text),
            _ => Self::Store(text),
        }
    }
}
