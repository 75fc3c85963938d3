//! Reasons why a file is no record of an oscilloscope.

use std::{
    fs::File,
    path::{Path, PathBuf},
};

/// Reason why a file was not taken as a scope's.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScopeError {
    /// The file system.
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
    /// A header that cannot be.
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
    /// A file of no known kind.
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
    /// A table that breaks off or does not hold numbers.
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
    /// Makes the complaints about the header of one file: field, what it should be, what it is.
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
