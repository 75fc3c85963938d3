//! Identity of an instrument by its own last answer.

use serde::{Deserialize, Serialize};

/// Identity of an instrument.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Identity {
    /// Its role.
    pub role: String,
    /// Its answer.
    pub identity: Answer,
    /// Whether that is the configured model.
    pub recognised: bool,
}

/// The answer itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// As it came.
    pub raw: String,
}
