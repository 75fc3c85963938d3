//! Errors of reading files of spectra.

use std::path::{Path, PathBuf};

/// Error of reading a file of spectra.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The file could not be read.
    #[error("{}: expected a readable file of impedance spectra: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// The bytes are not text.
    #[error("{}, line {line}: expected UTF-8 text, met byte 0x{byte:02X}", file.display())]
    NotText {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The first byte that is not text.
        byte: u8,
    },
    /// No line with data.
    #[error("{}: expected at least one line with a frequency and an impedance, met {met}", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
        /// Content of the file, in words.
        met: &'static str,
    },
    /// The first line matches no known format.
    #[error(
        "{}, line {line}: expected three numbers (frequency, Re, Im) or one of the headers \
         \"freq_hz,z_re_ohm,z_im_ohm[,…]\", \"freq,offset,resistance,theta\", \
         \"fixture,cell,repeat,bias_a,freq_hz,z_abs_ohm,z_phase_rad\", a file of a \
         potentiostat's program that docs/formats.md lists, or a table that names its columns \
         (`f,re,im`, `Frequency/Hz`, `Zreal`, `|Z|/Ohm`, \
         `Phase/deg`, …), met {met}{nearest}", file.display()
    )]
    UnknownFormat {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The line, shortened.
        met: String,
        /// The reader that came nearest, and why it does not read it, with a semicolon before it;
        /// empty if none is similar.
        nearest: String,
    },
    /// The header names a column twice or only one part of a pair.
    #[error("{}, line {line}: expected {expected}, met {met}", file.display())]
    Header {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Allowed values, in words.
        expected: String,
        /// Value found.
        met: String,
    },
    /// A line has too few or too many fields.
    #[error("{}, line {line}, column {column}: expected {expected} fields, met {met}", file.display())]
    FieldCount {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// The first missing or surplus field, from 1.
        column: usize,
        /// Expected number of fields.
        expected: usize,
        /// Number of fields found.
        met: usize,
    },
    /// The file has another format.
    #[error("{}: expected text with impedance spectra, met {kind}", file.display())]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Its format, and how to get a readable file from it.
        kind: &'static str,
    },
    /// A binary file of a known format cannot be decoded.
    #[error("{}: expected {kind} that can be decoded: {reason}", file.display())]
    Decode {
        /// The file.
        file: PathBuf,
        /// Its kind, in words.
        kind: &'static str,
        /// Message of the decoder.
        reason: String,
    },
    /// The unit of a column is wrong for its quantity or unknown.
    #[error("{}, line {line}, column {column} ({name}): expected {expected}, met {met}: {reason}", file.display())]
    Unit {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Field, from 1.
        column: usize,
        /// The column's name.
        name: String,
        /// Allowed values, in words.
        expected: &'static str,
        /// Value found.
        met: String,
        /// Reason for the refusal.
        reason: &'static str,
    },
    /// The content of a field does not match its column.
    #[error("{}, line {line}, column {column} ({name}): expected {expected}, met \"{met}\"", file.display())]
    Field {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Field, from 1.
        column: usize,
        /// The column's name.
        name: &'static str,
        /// Allowed values, in words.
        expected: &'static str,
        /// Value found.
        met: String,
    },
}

/// Place in a file, for error messages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ErrorPlace<'a> {
    /// The file.
    pub file: &'a Path,
    /// Line, from 1.
    pub line: Option<usize>,
    /// Name or number of the column.
    pub field: Option<String>,
}

impl FormatError {
    /// Returns the place in words.
    pub fn place(&self) -> ErrorPlace<'_> {
        let (file, line, field) = match self {
            Self::Read { file, .. }
            | Self::Empty { file, .. }
            | Self::Foreign { file, .. }
            | Self::Decode { file, .. } => (file, None, None),
            Self::NotText { file, line, .. }
            | Self::UnknownFormat { file, line, .. }
            | Self::Header { file, line, .. } => (file, Some(*line), None),
            Self::FieldCount {
                file, line, column, ..
            } => (file, Some(*line), Some(column.to_string())),
            Self::Unit {
                file, line, name, ..
            } => (file, Some(*line), Some(name.clone())),
            Self::Field {
                file, line, name, ..
            } => (file, Some(*line), Some((*name).to_owned())),
        };
        ErrorPlace { file, line, field }
    }
}
