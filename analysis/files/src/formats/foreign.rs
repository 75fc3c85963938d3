//! Recognises files that are no text with spectra, by their first bytes, else by their extension.

use super::error::FormatError;
use std::path::Path;

/// First bytes and what begins with them.
const MAGIC: [(&[u8], &str); 20] = [
    (
        b"PAR1",
        "Parquet, which is read for time series, and with --table as spectra in long form",
    ),
    (b"\x89HDF\r\n\x1a\n", "HDF5"),
    (
        b"MATLAB ",
        "a MATLAB .mat, which is read for time series (but version 7.3, which is HDF5)",
    ),
    (b"%PDF", "a PDF"),
    (b"\x89PNG", "a picture"),
    (b"\xFF\xD8\xFF", "a picture"),
    (b"GIF8", "a picture"),
    (b"\x1F\x8B", "a gzip archive; unpack it"),
    (b"BZh", "a bzip2 archive; unpack it"),
    (b"\xFD7zXZ\0", "an xz archive; unpack it"),
    (b"\x28\xB5\x2F\xFD", "a Zstandard archive; unpack it"),
    (b"7z\xBC\xAF\x27\x1C", "a 7z archive; unpack it"),
    (
        b"\xD0\xCF\x11\xE0\xA1\xB1\x1A\xE1",
        "an old Excel workbook that cannot be decoded, or another compound file; export the table as CSV",
    ),
    (
        b"\0\x01\0\0Standard Jet DB",
        "an Arbin .res (an Access database); export it as CSV or Excel from MITS Pro",
    ),
    (
        b"\0\x01\0\0Standard ACE DB",
        "an Access database; export its table as CSV",
    ),
    (
        b"SQLite format 3\0",
        "an SQLite database; export its table as CSV",
    ),
    (b"\x93NUMPY", "a NumPy array"),
    (
        b"NEWARE",
        "a Neware .nda, which is binary; export it as CSV",
    ),
    (b"%!PS", "PostScript"),
    (b"II*\0", "a picture"),
];

/// Neware's archive of binary tables.
const NDAX: &str = "a Neware .ndax, which is binary; export it as CSV or Excel from BTSDA";

/// Extensions of files that are known and not read; of texts too.
const EXTENSIONS: [(&str, &str); 8] = [
    ("mpr", "bytes that are no EC-Lab .mpr; export it as .mpt"),
    (
        "isw",
        "a Zahner .isw, which is binary; export it as a text list",
    ),
    (
        "res",
        "an Arbin .res; export it as CSV or Excel from MITS Pro",
    ),
    ("nda", "a Neware .nda, which is binary; export it as CSV"),
    ("ndax", NDAX),
    ("sr", "a sigrok session; export it as CSV from PulseView"),
    ("mat", "a MATLAB .mat that is not of Level 5 (`save -v7`)"),
    (
        "fods",
        "an OpenDocument spreadsheet that cannot be decoded; export the table as CSV",
    ),
];

/// Files whose first bytes are those of no text; told before anything else is tried.
pub(super) fn binary(path: &Path, bytes: &[u8]) -> Option<FormatError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let known = MAGIC
        .iter()
        .find(|(magic, _)| bytes.starts_with(magic))
        .map(|(_, kind)| *kind);
    let kind = match known {
        Some(kind) => kind,
        None if bytes.starts_with(b"PK\x03\x04") => {
            by_extension(path).unwrap_or_else(|| archive(bytes))
        }
        // A text has no zero byte.
        None if bytes.contains(&0) => {
            by_extension(path).unwrap_or("a binary file of unknown kind; export the data as text")
        }
        None => return None,
    };
    Some(error(path, kind))
}

/// Texts in which no spectrum was found.
pub(super) fn text(path: &Path, bytes: &[u8]) -> Option<FormatError> {
    let bytes = bytes
        .strip_prefix(b"\xEF\xBB\xBF")
        .unwrap_or(bytes)
        .trim_ascii_start();
    let by_content = match bytes {
        [b'{', ..] => Some("JSON, which is not read as a spectrum"),
        _ if bytes.starts_with(b"<") && has(bytes, b"<office:document") => {
            by_extension(Path::new("a.fods"))
        }
        _ if bytes.starts_with(b"<?xml")
            || bytes.starts_with(b"<!DOCTYPE")
            || bytes.starts_with(b"<html") =>
        {
            Some("XML or HTML")
        }
        _ => None,
    };
    by_content
        .or_else(|| by_extension(path))
        .map(|kind| error(path, kind))
}

fn error(path: &Path, kind: &'static str) -> FormatError {
    FormatError::Foreign {
        file: path.to_owned(),
        kind,
    }
}

fn by_extension(path: &Path) -> Option<&'static str> {
    let extension = path.extension()?.to_string_lossy().to_lowercase();
    EXTENSIONS
        .iter()
        .find(|(known, _)| *known == extension)
        .map(|(_, kind)| *kind)
}

fn archive(bytes: &[u8]) -> &'static str {
    if has(bytes, b"opendocument.spreadsheet") {
        "an OpenDocument spreadsheet that cannot be decoded; export the table as CSV"
    } else if has(bytes, b"xl/") {
        "an Excel workbook that cannot be decoded; export the table as CSV"
    } else if has(bytes, b".ndc") {
        NDAX
    } else {
        "a ZIP archive; unpack it"
    }
}

fn has(bytes: &[u8], part: &[u8]) -> bool {
    bytes.windows(part.len()).any(|window| window == part)
}
