//! A run as its folder contains it.

use std::path::PathBuf;

use bench_core::journal::{Line, replay::JournalReplay};
use bench_plan::{config::Experiment, plan::Plan};

/// A run as its folder contains it.
pub struct Recorded {
    pub(super) folder: PathBuf,
    pub(super) experiment: Experiment,
    pub(super) plan: Plan,
    /// The journal up to the end of the measurement.
    pub(super) lines: Vec<Line>,
    pub(super) replay: JournalReplay,
    pub(super) stopped: Option<String>,
}

/// Converts an error and its causes to text.
pub(super) fn figures(error: &dyn std::error::Error) -> String {
    error
        .source()
        .map_or_else(|| error.to_string(), |source| format!("{error}: {source}"))
}
