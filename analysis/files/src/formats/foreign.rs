//! Recognises files that are not text with spectra, by their first bytes, else by their extension.

use super::error::FormatError;
use std::path::Path;

/// First bytes and the format that begins with them.
const MAGIC: [(&[u8], &str); 21] = [
    (
        b"PAR1",
        "Parquet, which is read for time series, with BDF's columns of impedance (Frequency / Hz, Real \
         Impedance / ohm, Imaginary Impedance / ohm) as a spectrum, and with --table as spectra in long \
         form",
    ),
    (
        b"\x89HDF\r\n\x1a\n",
        "HDF5; export its table as CSV or Parquet",
    ),
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
    (b"\0\x01\0\0Standard Jet DB", RES),
    (
        b"\0\x01\0\0Standard ACE DB",
        "an Access database; export its table as CSV",
    ),
    (
        b"SQLite format 3\0",
        "an SQLite database; export its table as CSV",
    ),
    (
        b"\x93NUMPY",
        "a NumPy array; write it as text with numpy.savetxt",
    ),
    (b"TDSm", "LabVIEW's TDMS; export its channels as CSV"),
    (b"NEWARE", "a Neware .nda, which is read for time series"),
    (b"%!PS", "PostScript"),
    (b"II*\0", "a picture"),
];

/// Bytes in which a two-byte code page is detected, and the number of consecutive accented letters
/// that indicate one.
const CODE_PAGE_HEAD: usize = 4096;
const CODE_PAGE_RUN: usize = 4;

/// Bytes in which the first member of an OpenDocument file states its type.
const FIRST_MEMBER: usize = 200;

/// Arbin's database.
const RES: &str = "an Arbin .res (an Access database); export its table of rows with `mdb-export FILE \
                   Channel_Normal_Table > FILE.csv` (mdbtools), or as CSV or Excel from MITS Pro";
/// Neware's archive of binary tables.
const NDAX: &str = "a Neware .ndax, which is read for time series; if it has no data.ndc, export it as CSV or \
                    Excel from BTSDA";

/// Extensions of formats that are known but not supported, including text formats.
const EXTENSIONS: [(&str, &str); 8] = [
    (
        "mpr",
        "bytes that are not an EC-Lab .mpr; export it as .mpt",
    ),
    (
        "isw",
        "a Zahner .isw, which is binary; export it as a text list",
    ),
    ("res", RES),
    (
        "nda",
        "bytes that are not a Neware .nda; export it as CSV or Excel from BTSDA",
    ),
    ("ndax", NDAX),
    (
        "sr",
        "a sigrok session, which `replay` reads as the capture of a scope",
    ),
    ("mat", "a MATLAB .mat that is not of Level 5 (`save -v7`)"),
    (
        "fods",
        "an OpenDocument spreadsheet that cannot be decoded; export the table as CSV",
    ),
];

/// Detects formats by first bytes that no text has. Runs before all other readers.
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
        // Text contains no zero byte.
        None if bytes.contains(&0) => {
            by_extension(path).unwrap_or("a binary file of unknown kind; export the data as text")
        }
        None => return None,
    };
    Some(error(path, kind))
}

/// Detects text formats without any supported content.
pub(super) fn text(path: &Path, bytes: &[u8]) -> Option<FormatError> {
    by_content(bytes)
        .or_else(|| by_extension(path))
        .or_else(|| code_page(bytes))
        .map(|kind| error(path, kind))
}

/// Detects text in a code page with two bytes per character: decoded with a single-byte page it has
/// runs of accented letters that occur in no word.
fn code_page(bytes: &[u8]) -> Option<&'static str> {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(CODE_PAGE_HEAD)]);
    let is_high = |c: char| ('\u{80}'..='\u{ff}').contains(&c);
    let mut runs = head.split(|c: char| !is_high(c));
    runs.any(|run| run.chars().count() >= CODE_PAGE_RUN).then_some(
        "text in a code page of two bytes for a character, such as GBK or Shift-JIS; save it as UTF-8",
    )
}

/// Detects texts that contain no table, even if a line looks like names of columns.
pub(super) fn markup(path: &Path, bytes: &[u8]) -> Option<FormatError> {
    by_content(bytes).map(|kind| error(path, kind))
}

fn by_content(bytes: &[u8]) -> Option<&'static str> {
    let bytes = bytes
        .strip_prefix(b"\xEF\xBB\xBF")
        .unwrap_or(bytes)
        .trim_ascii_start();
    match bytes {
        [b'{', ..] => Some("JSON, which is not read as a table; export the data as CSV"),
        _ if bytes.starts_with(b"EC-LAB SETTING FILE")
            || bytes.starts_with(b"BT-LAB SETTING FILE") =>
        {
            Some("settings of EC-Lab (.mps), which hold no data; take the .mpr or .mpt beside them")
        }
        _ if bytes.starts_with(b"<") && has(bytes, b"<office:document") => {
            by_extension(Path::new("a.fods"))
        }
        _ if bytes.starts_with(b"<?xml")
            || bytes.starts_with(b"<!DOCTYPE")
            || bytes.starts_with(b"<html") =>
        {
            Some("XML or HTML; export its table as CSV")
        }
        _ => None,
    }
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

/// Returns the format of a ZIP archive from the names of its members and the content of the first
/// one.
fn archive(bytes: &[u8]) -> &'static str {
    let names: Vec<&[u8]> = members(bytes).collect();
    let first = &bytes[..bytes.len().min(FIRST_MEMBER)];
    if has(first, b"opendocument.spreadsheet") {
        "an OpenDocument spreadsheet that cannot be decoded; export the table as CSV"
    } else if names.iter().any(|name| name.starts_with(b"xl/")) {
        "an Excel workbook that cannot be decoded; export the table as CSV"
    } else if names.iter().any(|name| name.ends_with(b".ndc")) {
        NDAX
    } else {
        "a ZIP archive; unpack it"
    }
}

/// Returns the names of the members of a ZIP archive from their local headers.
fn members(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let starts = bytes.windows(4).enumerate();
    let headers = starts.filter(|(_, window)| *window == b"PK\x03\x04");
    headers.filter_map(|(at, _)| {
        let length = bytes.get(at + 26..at + 28)?;
        let length = usize::from(u16::from_le_bytes([length[0], length[1]]));
        bytes.get(at + 30..at + 30 + length)
    })
}

fn has(bytes: &[u8], part: &[u8]) -> bool {
    bytes.windows(part.len()).any(|window| window == part)
}
