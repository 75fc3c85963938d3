//! Errors of reading and writing tables.

use std::path::PathBuf;

/// Error of writing or reading a file of a run.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The file system returned an error.
    #[error("{}: could not {action}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Action that failed, in words.
        action: &'static str,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The file is not Parquet, or the table cannot be encoded as Parquet.
    #[error("{}: could not {action}", path.display())]
    Parquet {
        /// The file.
        path: PathBuf,
        /// Action that failed, in words.
        action: &'static str,
        /// Error of the library.
        #[source]
        source: polars::prelude::PolarsError,
    },
    /// A column is missing or has the wrong type.
    #[error("{}, column {column}: expected {expected}, met {found}", path.display())]
    Column {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// Allowed values, in words.
        expected: String,
        /// Value found.
        found: String,
    },
    /// The bytes differ from those that were written.
    #[error("{}: expected a file of this program with the checksum {expected}, met {found}; it is \
    damaged or comes from elsewhere", path.display())]
    Checksum {
        /// The file.
        path: PathBuf,
        /// The checksum in the file.
        expected: String,
        /// The checksum of its bytes.
        found: String,
    },
    /// A key of the metadata is missing or cannot be parsed.
    #[error("{}, metadata {key}: expected {expected}, met {found}", path.display())]
    Metadata {
        /// The file.
        path: PathBuf,
        /// The key.
        key: String,
        /// Allowed values, in words.
        expected: &'static str,
        /// Value found.
        found: String,
    },
    /// The first line of a CSV file is not the header of its kind.
    #[error("{}, line 1: expected the header {expected:?}, met {found:?}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// The header of this kind of file.
        expected: String,
        /// The first line.
        found: String,
    },
    /// A field of a CSV file is wrong.
    #[error("{}, line {line}, column {column}: expected {expected}, met {found:?}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The column.
        column: String,
        /// Allowed values, in words.
        expected: &'static str,
        /// Value found.
        found: String,
    },
}
