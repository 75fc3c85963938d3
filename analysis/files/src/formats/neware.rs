//! Records of Neware's cyclers in their binary files, as the text of a cycler: `.nda`, and `.ndax`,
//! which is a ZIP archive of `.ndc`.
//!
//! The maker does not publish the layouts. Those here are the ones that the programs `fastnda` and
//! `NewareNDA` have found, in the versions that `fastnda` has checked against exports of BTSDA. Any
//! other version is refused: a wrong layout gives numbers that look right.

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

/// The text of a record, and remarks on what is not in it; nothing for a file of another kind.
///
/// # Errors
/// [`FormatError::Decode`] for a version that is not read, and for a file that is cut off.
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
