//! The record of an analysis.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::arguments::{AnalysisKind, Options};

/// State of an analysis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// Others come first.
    Waiting,
    /// Its process runs.
    #[serde(rename = "in work")]
    InWork,
    /// It has results.
    Done,
    /// It has none.
    Failed,
    /// Somebody has ended it.
    Cancelled,
}

/// How far an analysis is.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Progress {
    /// Share that is done, where the command counts.
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
    /// The spectra, where not all are meant.
    #[serde(default)]
    pub spectra: Vec<String>,
    /// Options.
    pub options: Options,
    /// Who asked for it.
    pub by: String,
    /// When, s since 1970.
    pub submitted_unix_s: f64,
    /// When its process began, s since 1970.
    pub began_unix_s: Option<f64>,
    /// When it ended, s since 1970.
    pub ended_unix_s: Option<f64>,
    /// State.
    pub state: State,
    /// How far it is.
    pub progress: Progress,
    /// Time left, s; null if it is unknown.
    pub left_s: Option<f64>,
    /// Why it has no results; a remark on them.
    pub message: Option<String>,
    /// The same on a command line.
    pub command: String,
    /// Number of its process, once it has begun.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pid: Option<i32>,
}
