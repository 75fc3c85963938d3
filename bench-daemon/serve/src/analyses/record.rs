//! The record of an analysis.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::arguments::{AnalysisKind, Options};

/// State of an analysis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// It waits for earlier analyses.
    Waiting,
    /// Its process runs.
    #[serde(rename = "in work")]
    InWork,
    /// It has results.
    Done,
    /// It failed and has no results.
    Failed,
    /// A person cancelled it.
    Cancelled,
}

/// Progress of an analysis.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Progress {
    /// Completed share, if the command counts it.
    pub done: Option<f64>,
    /// Present action.
    pub words: String,
}

/// An analysis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Analysis {
    /// Its name.
    pub id: String,
    /// Its kind.
    pub kind: AnalysisKind,
    /// The runs.
    pub runs: Vec<String>,
    /// The selected spectra; empty for all.
    #[serde(default)]
    pub spectra: Vec<String>,
    /// Options.
    pub options: Options,
    /// Name of the person who submitted it.
    pub by: String,
    /// Time of submission, s since 1970.
    pub submitted_unix_s: f64,
    /// Start of its process, s since 1970.
    pub began_unix_s: Option<f64>,
    /// Time of its end, s since 1970.
    pub ended_unix_s: Option<f64>,
    /// State.
    pub state: State,
    /// Progress.
    pub progress: Progress,
    /// Time left, s; null if it is unknown.
    pub left_s: Option<f64>,
    /// Reason why it has no results, or a remark on them.
    pub message: Option<String>,
    /// The equivalent command line.
    pub command: String,
    /// Process number, after its start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pid: Option<i32>,
}
