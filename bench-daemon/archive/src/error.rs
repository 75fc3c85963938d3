//! Errors of the archive.

use std::{io, path::PathBuf};

use analysis_files::{batch::BatchError, dataset::DatasetError};

/// Error of archiving or fetching a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// A file of the run or of the data folder could not be read or written.
    #[error("{}: could not {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Action that failed, in words.
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The archive does not accept the run in its present state.
    #[error("{run}: not archived: {why}")]
    Refused {
        /// Name of the run.
        run: String,
        /// The reason.
        why: String,
    },
    /// The run is in progress, or its end is not recorded yet.
    #[error("{run}: not archived yet: {why}")]
    Waiting {
        /// Name of the run.
        run: String,
        /// Whether a process works in its folder.
        in_use: bool,
        /// The reason.
        why: String,
    },
    /// The run folder changed while it was read.
    #[error("{}: changed while the run was archived", file.display())]
    Changed {
        /// The file.
        file: PathBuf,
    },
    /// The store refused or failed an operation.
    #[error("{store}, {path}: could not {action}: {source}")]
    Store {
        /// The store.
        store: String,
        /// The object.
        path: String,
        /// Action that failed, in words.
        action: &'static str,
        /// Error of the store.
        source: Box<object_store::Error>,
    },
    /// The store returned other bytes than were sent.
    #[error("{store}, {path}: expected {expected}, found {found}")]
    Bytes {
        /// The store.
        store: String,
        /// The object.
        path: String,
        /// SHA-256 and size that were sent.
        expected: String,
        /// SHA-256 and size that were read back.
        found: String,
    },
    /// The store contains a file that this program did not write.
    #[error("{store}, {path}: {why}")]
    Content {
        /// The store.
        store: String,
        /// The object.
        path: String,
        /// Expected and found text.
        why: String,
    },
    /// A setting of the store is invalid.
    #[error("{field}: {why}")]
    Setting {
        /// The setting.
        field: &'static str,
        /// Expected and found text.
        why: String,
    },
    /// A receipt or a list of moved files cannot be read.
    #[error("{0}")]
    Record(String),
    /// The file cannot be written.
    #[error(transparent)]
    Write(#[from] DatasetError),
    /// The table cannot be created.
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
