//! Reason why a run folder cannot be written.

use std::path::{Path, PathBuf};

use analysis_files::dataset::DatasetError;

use crate::journal::JournalError;
use bench_plan::support::quoted::quoted;

/// Error while writing a run folder.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file system reported an error.
    #[error("{path}: {what}: {source}", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Operation that failed.
        what: &'static str,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A table cannot be written.
    #[error("{}", with_causes(.0))]
    Dataset(#[from] DatasetError),
    /// The journal cannot be written.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A file of the folder differs from the journal.
    #[error("{path}: expected {expected}, found {found}", path = path.display())]
    Differs {
        /// The file.
        path: PathBuf,
        /// Expected content.
        expected: String,
        /// Content that was found.
        found: String,
    },
    /// The folder is already in use.
    #[error("{path}: expected a new or empty folder, found files in it; choose another with --out, \
    or go on with that run: `eis-bench resume {pasted}`", path = path.display(), pasted = quoted(path))]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
}

/// Returns an error with its causes, which a person can fix.
pub fn with_causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |cause| cause.source());
    causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
}

/// Adds the file and the operation to an error of the system.
pub(super) fn io(
    path: &Path,
    what: &'static str,
) -> impl Fn(std::io::Error) -> RecordError + use<> {
    let path = path.to_owned();
    move |source| RecordError::Io {
        path: path.clone(),
        what,
        source,
    }
}
