//! Errors of reading time series.

use super::super::error::FormatError;
use crate::dataset::DatasetError;
use analysis_signal::series::SeriesError;
use std::path::PathBuf;

/// Error of reading a time series.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SeriesReadError {
    /// The file could not be read.
    #[error("{}: expected a readable file of current and voltage over time: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The text is not a table.
    #[error(transparent)]
    Text(#[from] FormatError),
    /// The file has another format.
    #[error("{}: expected a record of time, voltage and current, met {kind}", file.display())]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Its format, and how to get a readable file from it.
        kind: &'static str,
    },
    /// Columns of no known format.
    #[error(
        "{}{place}: expected columns of a time, a voltage and a current, such as \"Test Time / \
         s,Voltage / V,Current / A\", met {met}",
        file.display()
    )]
    UnknownFormat {
        /// The file.
        file: PathBuf,
        /// `, line N`, or empty for a file without lines.
        place: String,
        /// The shortened header, and the missing columns.
        met: String,
    },
    /// Currents without a direction.
    #[error(
        "{}: its currents are all of one sign, and neither the voltage nor a column (State, Step Type, \
         charge and discharge capacity) nor the file's name distinguishes charge from discharge{detail}; state \
         which is positive: --positive discharge or --positive charge (Python: sign=, dataset.toml: \
         current_positive)",
        file.display()
    )]
    Sign {
        /// The file.
        file: PathBuf,
        /// The rows that leave it undetermined, or empty.
        detail: String,
    },
    /// Columns contradict each other.
    #[error("{}, line {line}: expected columns that agree, met {met}", file.display())]
    Contradiction {
        /// The file.
        file: PathBuf,
        /// Line, from 1; in Parquet the row.
        line: usize,
        /// Both statements with their values, and the next step for the user.
        met: String,
    },
    /// Times decrease.
    #[error("{}, line {line}: expected times in s that rise, met {met}", file.display())]
    Order {
        /// The file.
        file: PathBuf,
        /// Line, from 1; in Parquet the row.
        line: usize,
        /// Both times, and the next step for the user.
        met: String,
    },
    /// The content of a field does not match its column.
    #[error("{}, line {line}, column {column} ({name}): expected a finite number, met {met}", file.display())]
    Field {
        /// The file.
        file: PathBuf,
        /// Line, from 1; in Parquet the row.
        line: usize,
        /// Field, from 1.
        column: usize,
        /// The column's name.
        name: String,
        /// Value found.
        met: String,
    },
    /// The Parquet file cannot be decoded.
    #[error("{}: expected Parquet with columns of numbers: {reason}", file.display())]
    Parquet {
        /// The file.
        file: PathBuf,
        /// Message of the decoder.
        reason: String,
    },
    /// A Parquet file of the bench that is damaged.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The numbers do not form a series.
    #[error("{}: {source}", file.display())]
    Series {
        /// The file.
        file: PathBuf,
        /// Error of the samples.
        #[source]
        source: SeriesError,
    },
}

impl SeriesReadError {
    /// Converts the error for a file of another format from the readers of spectra.
    pub(super) fn foreign(error: FormatError) -> Self {
        match error {
            FormatError::Foreign { file, kind } => Self::Foreign { file, kind },
            other => other.into(),
        }
    }
}
