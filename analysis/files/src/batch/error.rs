//! Errors of reading and writing tables of spectra and results.

use std::path::PathBuf;

use polars::prelude::PolarsError;

use crate::dataset::DatasetError;

/// Error of reading or writing a table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BatchError {
    /// The file could not be read or written.
    #[error("{}: expected to {action}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Attempted action.
        action: &'static str,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The Parquet file could not be decoded or encoded.
    #[error("{}: expected to {action}: {source}", path.display())]
    Parquet {
        /// The file.
        path: PathBuf,
        /// Attempted action.
        action: &'static str,
        /// Error of the decoder or encoder.
        #[source]
        source: PolarsError,
    },
    /// A table without a column, or with one of another type.
    #[error("{}: expected a column {column}{of}, met {met}", path.display())]
    Column {
        /// The file.
        path: PathBuf,
        /// Name of the column.
        column: String,
        /// Expected type in words, with a blank before it; may be empty.
        of: &'static str,
        /// Columns or type met.
        met: String,
    },
    /// A row that cannot be assigned to a spectrum.
    #[error("{}, {place}: expected {expected}, met {met}", path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// Line or row, from 1.
        place: String,
        /// Allowed values in words.
        expected: &'static str,
        /// Value found.
        met: String,
    },
    /// The path holds results of another call.
    #[error("{}: expected nothing or the unfinished results of the same call, met {met}", path.display())]
    Taken {
        /// The file or folder.
        path: PathBuf,
        /// Content met, in words.
        met: String,
    },
    /// A part could not be written completely.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
}
