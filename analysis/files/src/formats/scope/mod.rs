//! Reads records of oscilloscopes from their own files. The format is recognised by the content;
//! the source of each layout is given.
//!
//! * Siglent binary, V2.0, V3.0 and V4.0, told by its version and plausible header: Siglent, "How
//!   to Extract Data from the Binary File"; V4.0 as real files have it
//! * Rigol binary (`.bin`), told by `RG`: user guides of MSO5000/7000, HDO, DHO: "Binary Data
//!   Format"
//! * LeCroy `.trc`, told by `WAVEDESC`: the template LECROY_2_3 that the instruments send
//! * Siglent and Rigol CSV, any table of numbers, told by a row of numbers: the files themselves
//!
//! Nothing is loaded as a whole: binary files are read where they are, a table goes once through a
//! temporary file of numbers. Rigol's `.wfm` is not documented by its maker and refused. Knows no
//! shunt and no frequency.

mod lecroy;
mod raw;
mod rigol;
mod siglent;
mod table;

use std::fs::File;
use std::path::{Path, PathBuf};

use analysis_signal::sine::{Channel, Stored};
use raw::RawFile;

/// A record of one or more channels, on disk.
#[derive(Debug)]
pub struct ScopeRecord {
    /// Kind of the file.
    pub kind: &'static str,
    /// Time between two samples, s.
    pub interval_s: f64,
    /// Samples of each channel.
    pub samples: usize,
    /// Names of the channels as the file has them.
    pub names: Vec<String>,
    raw: RawFile,
}

impl ScopeRecord {
    /// A channel by its number in the file, from 0, ready to be fitted.
    pub fn channel(&self, index: usize) -> Option<Channel<'_>> {
        let layout = self.raw.channels.get(index)?;
        Some(Channel::Stored(Stored {
            samples: &self.raw,
            channel: index,
            start: 0,
            count: self.samples,
            scale: layout.scale,
            lsb_v: layout.lsb_v,
            level_v: layout.level_v,
        }))
    }

    /// Volts of a channel from its number `start` on, at most `count`.
    ///
    /// # Errors
    /// [`ScopeError::Layout`] for a file that cannot be read any more.
    pub fn volts(&self, index: usize, start: usize, count: usize) -> Result<Vec<f64>, ScopeError> {
        self.raw
            .volts_of(index, start, count.min(self.samples.saturating_sub(start)))
    }
}

/// Reason why a file was not taken as a scope's.
#[derive(Debug, thiserror::Error)]
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
        "{}: expected a scope's record (Siglent .bin of V2 to V4, Rigol .bin, LeCroy .trc, or a \
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
    fn about(file: &Path, kind: &'static str) -> impl Fn(&'static str, &str, String) -> Self {
        move |field, expected, met| Self::Layout {
            file: file.to_owned(),
            kind,
            field,
            expected: expected.to_owned(),
            met,
        }
    }

    /// The open file.
    fn opened(path: &Path) -> Result<File, Self> {
        File::open(path).map_err(|source| Self::Io {
            file: path.to_owned(),
            action: "open it",
            source,
        })
    }
}

/// Opens a scope's record. `interval_s`: time between two samples, for a table that does not tell
/// it.
///
/// # Errors
/// [`ScopeError`].
pub fn open_scope(path: &Path, interval_s: Option<f64>) -> Result<ScopeRecord, ScopeError> {
    let file = ScopeError::opened(path)?;
    let bytes = raw::Bytes::new(path, &file)?;
    if let Some(at) = lecroy::begins(&bytes) {
        return lecroy::open(path, &bytes, at);
    }
    if bytes.head().starts_with(b"RG") {
        return rigol::open(path, &bytes);
    }
    if siglent::is_one(&bytes) {
        return siglent::open(path, &bytes);
    }
    let text = bytes
        .head()
        .iter()
        .take(512)
        .all(|byte| *byte >= 9 && *byte != 127);
    if text && !bytes.head().is_empty() {
        return table::open(path, interval_s);
    }
    let met: Vec<String> = bytes
        .head()
        .iter()
        .take(8)
        .map(|byte| format!("{byte:02x}"))
        .collect();
    Err(ScopeError::Unknown {
        file: path.to_owned(),
        met: format!("bytes {}", met.join(" ")),
    })
}

#[cfg(test)]
mod tests;
