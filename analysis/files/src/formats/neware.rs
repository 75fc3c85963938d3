//! Converts binary records of Neware's cyclers to cycler text: `.nda`, and `.ndax`, which is a ZIP
//! archive of `.ndc`.
//!
//! The manufacturer does not publish the layouts. The reader uses those found by the programs
//! `fastnda` and `NewareNDA`, for the versions that `fastnda` has verified against exports of
//! BTSDA. Any other version is refused, because a wrong layout gives plausible but wrong numbers.

mod bts9;
mod fields;
mod nda;
mod ndax;
mod record;

pub(super) use self::record::Decoded;
use self::record::Fault;
use super::error::FormatError;
use std::path::Path;

/// First bytes of a `.nda`.
const NDA: &[u8] = b"NEWARE";
/// First bytes of a ZIP archive.
const ZIP: &[u8] = b"PK\x03\x04";

/// Returns the text of a record, and remarks on data that it omits; `None` for any other file.
///
/// # Errors
/// [`FormatError::Decode`] for an unsupported version and for a truncated file.
pub(super) fn text(path: &Path, bytes: &[u8]) -> Option<Result<Decoded, FormatError>> {
    let (kind, read): (_, Result<Decoded, Fault>) = if bytes.starts_with(NDA) {
        ("a Neware .nda", nda::read(bytes))
    } else if bytes.starts_with(ZIP) {
        ("a Neware .ndax", ndax::read(bytes)?)
    } else {
        return None;
    };
    Some(read.map_err(|fault| FormatError::Decode {
        file: path.to_owned(),
        kind,
        reason: fault.to_string(),
    }))
}

#[cfg(test)]
mod tests;
