//! Reasons why a table cannot be read or written.

use std::path::PathBuf;

/// Reason why a file of a run could not be written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The file system refused.
    #[error("{}: could not {action}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Action that failed, in words.
        action: &'static str,
        /// The file system's answer.
        #[source]
        source: std::io::Error,
    },
    /// The file is no Parquet, or the table cannot become one.
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
    /// A column is missing or not what it should be.
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
    /// The bytes are not those that were written.
    #[error("{}: expected a file of this program with the checksum {expected}, met {found}; it is \
    damaged or comes from elsewhere", path.display())]
    Checksum {
        /// The file.
        path: PathBuf,
        /// The checksum in the file.
        expected: String,
        /// That of its bytes.
        found: String,
    },
    /// The metadata of a file lacks something or does not parse.
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
