//! Reads records of oscilloscopes from their own files. The format is recognised by the content;
//! the source of each layout is given.
//!
//! * Siglent binary, V2.0, V3.0 and V4.0, recognised by its version and a plausible header:
//!   Siglent, "How to Extract Data from the Binary File"; V4.0 as found in real files
//! * Rigol binary (`.bin`), recognised by `RG`: user guides of MSO5000/7000, HDO, DHO: "Binary Data
//!   Format"; Keysight binary, recognised by `AG`: InfiniiVision, "Binary Data in .bin Format", the
//!   same layout
//! * LeCroy `.trc`, recognised by `WAVEDESC`: the template LECROY_2_3 that the instruments send
//! * Siglent, Rigol and Rohde & Schwarz CSV, any table of numbers, recognised by a row of numbers: the
//!   files themselves; for an RTO also the settings file beside it
//! * sigrok's session `.sr`, recognised by its `metadata`
//!
//! No file is loaded as a whole: binary files are read in place, a table is converted once to a
//! temporary file of numbers. Rigol's `.wfm` is refused because its manufacturer does not document
//! it. Independent of shunts and frequencies.

mod error;
mod lecroy;
mod raw;
mod record;
mod rigol;
mod rohde_schwarz;
mod siglent;
mod sigrok;
mod table;

use std::path::Path;

pub use error::ScopeError;
pub use record::ScopeRecord;

/// Opens a scope's record. `interval_s`: time between two samples, for a table that does not state
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
    if let Some(kind) = rigol::kind(&bytes) {
        return rigol::open(path, &bytes, kind);
    }
    if siglent::is_one(&bytes) {
        return siglent::open(path, &bytes);
    }
    if bytes.head().starts_with(sigrok::MAGIC)
        && let Some(record) = sigrok::open(path)?
    {
        return Ok(record);
    }
    if let Some(pair) = rohde_schwarz::pair(path) {
        return rohde_schwarz::open(&pair);
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
