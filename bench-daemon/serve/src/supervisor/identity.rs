//! Identity of an instrument by its own last answer.

use instruments::clock;
use serde::{Deserialize, Serialize};

use bench_core::bench::outputs::OutputReading;

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

/// What `eis-bench identify` found of one instrument.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Asked {
    /// Its role.
    pub role: String,
    /// Its address.
    pub address: String,
    /// Its answer, if it answered.
    pub identity: Option<Answer>,
    /// Whether that is the configured model.
    pub recognised: Option<bool>,
    /// State of its output, if it can move charge.
    pub output: Option<OutputReading>,
    /// Reason why it did not answer.
    pub failure: Option<String>,
    /// Time at which the answers were received, s since 1970.
    #[serde(default = "clock::unix_time_s")]
    pub unix_s: f64,
}
