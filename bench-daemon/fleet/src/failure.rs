//! Reasons why a command ends without a result, with their exit codes. Codes have the same meaning
//! as those of `eis-bench`.

use crate::error::FleetError;

/// Reason why a command ended without a result.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// A file or an argument is invalid, or a request is refused.
    #[error("{0}")]
    Usage(String),
    /// Outputs may be on.
    #[error("LOOK AT THE BENCH: {0}")]
    Unsafe(String),
    /// A server does not answer, or the operating system reported an error.
    #[error("{0}")]
    System(#[from] std::io::Error),
}

impl Failure {
    /// Returns the exit code; `eis-fleet --help` lists them.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => 2,
            Self::Unsafe(_) => 6,
            Self::System(_) => 1,
        }
    }
}

impl From<FleetError> for Failure {
    fn from(error: FleetError) -> Self {
        match error {
            FleetError::Unreachable(_) | FleetError::Bench(_) => {
                std::io::Error::other(error.to_string()).into()
            }
            error => Self::Usage(error.to_string()),
        }
    }
}
