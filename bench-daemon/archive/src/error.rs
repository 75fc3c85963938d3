//! Reasons why a run is not in the archive.

use std::{io, path::PathBuf};

use analysis_files::{batch::BatchError, dataset::DatasetError};

/// Reason why a run is not in the archive, or does not come back from it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// A file of the run or of the data folder.
    #[error("{}: could not {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Action that failed, in words.
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A run that the archive does not accept in its present state.
    #[error("{run}: not archived: {why}")]
    Refused {
        /// Name of the run.
        run: String,
        /// The reason.
        why: String,
    },
    /// A run that is in progress, or whose end is not recorded yet.
    #[error("{run}: not archived yet: {why}")]
    Waiting {
        /// Name of the run.
        run: String,
        /// A process works in its folder.
        in_use: bool,
        /// The reason.
        why: String,
    },
    /// A run folder that changes while it is read.
    #[error("{}: changed while the run was archived", file.display())]
    Changed {
        /// The file.
        file: PathBuf,
    },
    /// The store refuses or fails an operation.
    #[error("{store}, {path}: could not {action}: {source}")]
    Store {
        /// The store.
        store: String,
        /// The object.
        path: String,
        /// Action that failed, in words.
        action: &'static str,
        /// Its answer.
        source: Box<object_store::Error>,
    },
    /// The store gives other bytes back than it was given.
    #[error("{store}, {path}: expected {expected}, found {found}")]
    Bytes {
        /// The store.
        store: String,
        /// The object.
        path: String,
        /// SHA-256 and size that were sent.
        expected: String,
        /// SHA-256 and size that came back.
        found: String,
    },
    /// A file in the store that this program did not write.
    #[error("{store}, {path}: {why}")]
    Content {
        /// The store.
        store: String,
        /// The object.
        path: String,
        /// Expectation and finding.
        why: String,
    },
    /// A setting of the store.
    #[error("{field}: {why}")]
    Setting {
        /// The setting.
        field: &'static str,
        /// Expectation and finding.
        why: String,
    },
    /// A receipt or a list of moved files that cannot be read.
    #[error("{0}")]
    Record(String),
    /// A file that cannot be written.
    #[error(transparent)]
    Write(#[from] DatasetError),
    /// A table that cannot be made.
    #[error(transparent)]
    Table(#[from] BatchError),
}

impl ArchiveError {
    /// Returns whether the store, not the run, is the cause: the next run would fail for the same
    /// reason.
    pub fn is_of_store(&self) -> bool {
        matches!(self, Self::Store { .. } | Self::Setting { .. })
    }

    /// Returns whether a retry may succeed.
    pub fn may_pass(&self) -> bool {
        matches!(
            self,
            Self::Store { .. } | Self::Bytes { .. } | Self::Changed { .. }
        )
    }

    pub(crate) fn io(
        path: impl Into<PathBuf>,
        action: &'static str,
    ) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io {
            path,
            action,
            source,
        }
    }
}
