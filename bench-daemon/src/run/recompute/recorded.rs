//! Run as its folder holds it.

use std::path::PathBuf;

use crate::{
    config::Experiment,
    journal::{Line, replay::JournalReplay},
    plan::Plan,
};

/// Run as its folder holds it.
pub(crate) struct Recorded {
    pub(super) folder: PathBuf,
    pub(super) experiment: Experiment,
    pub(super) plan: Plan,
    /// The journal up to the end of the measurement.
    pub(super) lines: Vec<Line>,
    pub(super) replay: JournalReplay,
    pub(super) stopped: Option<String>,
}

/// An error with what lies below it.
pub(super) fn figures(error: &dyn std::error::Error) -> String {
    error
        .source()
        .map_or_else(|| error.to_string(), |source| format!("{error}: {source}"))
}
