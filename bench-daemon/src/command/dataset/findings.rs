//! Findings of `dataset init`.

use serde::Serialize;

use analysis::ocv::OcvCurve;

use bench_evaluate::investigate::proposal::{
    Estimate, FoundLog, FoundSpectrum, Missing, ProposedRun, StartModel,
};

/// Everything that was found, for `--json`.
#[derive(Debug, Serialize)]
pub(super) struct Findings {
    /// Every file, with its kind or the reason why it cannot be read.
    pub(super) files: Vec<FileFinding>,
    /// Logs with their loads.
    pub(super) logs: Vec<FoundLog>,
    /// Spectra.
    pub(super) spectra: Vec<FoundSpectrum>,
    /// Runs in time that are proposed.
    pub(super) runs: Vec<ProposedRun>,
    /// Noise and codes.
    pub(super) bench: Estimate,
    /// Keys that the user must fill in.
    pub(super) missing: Vec<Missing>,
    /// Curve through the rest voltages, if no curve was given.
    pub(super) curve: Option<OcvCurve>,
    /// Model to start from, if there is no spectrum.
    pub(super) model: Option<StartModel>,
}

/// A file and its kind.
#[derive(Debug, Clone, Serialize)]
pub(super) struct FileFinding {
    /// Path as given.
    pub(super) file: String,
    /// Kind; `None` if the file cannot be read.
    pub(super) kind: Option<FileKind>,
    /// Short description of the content, or the most similar reader and the reason.
    pub(super) text: String,
}

/// Kind of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum FileKind {
    /// Spectra.
    Spectra,
    /// Current and voltage over time.
    Log,
}
