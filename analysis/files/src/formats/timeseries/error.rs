//! Reasons why a time series could not be read.

use super::super::error::FormatError;
use crate::dataset::DatasetError;
use analysis_signal::series::SeriesError;
use std::path::PathBuf;

/// Reason why a time series could not be read.
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
    /// A text that is no table.
    #[error(transparent)]
    Text(#[from] FormatError),
    /// A file of another kind.
    #[error("{}: expected a record of time, voltage and current, met {kind}", file.display())]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Its kind, and a way to what is read.
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
        /// `, line N`, or nothing for a file without lines.
        place: String,
        /// The header, shortened, and what it lacks.
        met: String,
    },
    /// Currents without a direction.
    #[error(
        "{}: its currents are all of one sign, and neither the voltage nor a column (State, Step Type, \
         charge and discharge capacity) nor the file's name tells charge from discharge{detail}; state \
         which is positive: --positive discharge or --positive charge (Python: sign=, dataset.toml: \
         current_positive)",
        file.display()
    )]
    Sign {
        /// The file.
        file: PathBuf,
        /// The rows that leave it open, or nothing.
        detail: String,
    },
    /// Columns that contradict each other.
    #[error("{}, line {line}: expected columns that agree, met {met}", file.display())]
    Contradiction {
        /// The file.
        file: PathBuf,
        /// Line, from 1; in Parquet the row.
        line: usize,
        /// Both sides, with their values, and the next thing to try.
        met: String,
    },
    /// Times that go back.
    #[error("{}, line {line}: expected times in s that rise, met {met}", file.display())]
    Order {
        /// The file.
        file: PathBuf,
        /// Line, from 1; in Parquet the row.
        line: usize,
        /// Both times, and the next thing to try.
        met: String,
    },
    /// A field that is not what its column holds.
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
    /// Parquet that cannot be decoded.
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
    /// Numbers that are no series.
    #[error("{}: {source}", file.display())]
    Series {
        /// The file.
        file: PathBuf,
        /// Fault of the samples.
        #[source]
        source: SeriesError,
    },
}

impl SeriesReadError {
    /// The refusal of a file of another kind, as the readers of spectra give it.
    pub(super) fn foreign(error: FormatError) -> Self {
        match error {
            FormatError::Foreign { file, kind } => Self::Foreign { file, kind },
            other => other.into(),
        }
    }
}
