//! Errors of reading records of oscilloscopes.

use std::{
    fs::File,
    path::{Path, PathBuf},
};

/// Error of reading a record of an oscilloscope.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScopeError {
    /// The file system returned an error.
    #[error("{}: could not {action}: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Action that failed, in words.
        action: &'static str,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The header is invalid.
    #[error("{}: {kind}, {field}: expected {expected}, met {met}", file.display())]
    Layout {
        /// The file.
        file: PathBuf,
        /// Kind of the file.
        kind: &'static str,
        /// The field.
        field: &'static str,
        /// Allowed values, in words.
        expected: String,
        /// Value found.
        met: String,
    },
    /// The file has no known format.
    #[error(
        "{}: expected a scope's record (Siglent .bin of V2 to V4, Rigol .bin, LeCroy .trc, sigrok .sr, or a \
        CSV with rows of numbers), met {met}",
        file.display()
    )]
    Unknown {
        /// The file.
        file: PathBuf,
        /// First bytes of the file.
        met: String,
    },
    /// A table is truncated or contains fields that are not numbers.
    #[error("{}, line {line}: expected {expected}, met {met}", file.display())]
    Row {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Allowed values, in words.
        expected: String,
        /// Value found.
        met: String,
    },
}

impl ScopeError {
    /// Creates errors about the header of one file: field, allowed values, value found.
    pub(super) fn about(
        file: &Path,
        kind: &'static str,
    ) -> impl Fn(&'static str, &str, String) -> Self {
        move |field, expected, met| Self::Layout {
            file: file.to_owned(),
            kind,
            field,
            expected: expected.to_owned(),
            met,
        }
    }

    /// The open file.
    pub(super) fn opened(path: &Path) -> Result<File, Self> {
        File::open(path).map_err(|source| Self::Io {
            file: path.to_owned(),
            action: "open it",
            source,
        })
    }
}
