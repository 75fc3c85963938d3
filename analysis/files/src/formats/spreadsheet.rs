//! Sheets of a spreadsheet as texts with tabulators, which the other readers take: Excel (`.xlsx`,
//! `.xlsm`, `.xlsb`, `.xls`) and OpenDocument (`.ods`, and `.fods`, which is one XML).
//!
//! Line and field of a text are row and column of the sheet. Times of a day and durations become
//! `h:mm:ss`.

use std::borrow::Cow;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};

use calamine::{Data, Ods, Range, Reader as _, Sheets, open_workbook_auto_from_rs};

use super::error::FormatError;

/// First bytes of a ZIP archive, and of the files of Excel before 2007.
const MAGIC: [&[u8]; 2] = [b"PK\x03\x04", b"\xD0\xCF\x11\xE0\xA1\xB1\x1A\xE1"];
/// Bytes of an XML in which its root element is sought.
const ROOT: usize = 4096;
/// Kind of an OpenDocument spreadsheet.
const OPEN_DOCUMENT: &str = "application/vnd.oasis.opendocument.spreadsheet";
/// Most fields of a sheet: as text some hundred megabytes. Excel's rows and columns are 17 thousand
/// million, which a file of some kilobytes may claim to fill.
const MOST_FIELDS: usize = 50_000_000;

/// One sheet.
#[derive(Debug)]
pub(super) struct Sheet {
    pub(super) name: String,
    /// The file with the name of the sheet, for messages: `data.xlsx [Sheet1]`.
    pub(super) path: PathBuf,
    pub(super) text: String,
}

/// The sheets of a file that are not empty; nothing where it is no spreadsheet.
///
/// # Errors
/// [`FormatError::Decode`] for one that cannot be decoded.
pub(super) fn sheets(path: &Path, bytes: &[u8]) -> Option<Result<Vec<Sheet>, FormatError>> {
    let failed = |reason: &dyn std::fmt::Display| FormatError::Decode {
        file: path.to_owned(),
        kind: "a spreadsheet",
        reason: reason.to_string(),
    };
    let mut book: Sheets<Cursor<Cow<'_, [u8]>>> = if is_flat(bytes) {
        match Ods::new(Cursor::new(Cow::Owned(packed_flat(bytes)))) {
            Ok(book) => Sheets::Ods(book),
            Err(error) => return Some(Err(failed(&error))),
        }
    } else if MAGIC.iter().any(|magic| bytes.starts_with(magic)) {
        // Another archive or compound file is told by its kind.
        open_workbook_auto_from_rs(Cursor::new(Cow::Borrowed(bytes))).ok()?
    } else {
        return None;
    };
    let names = book.sheet_names();
    let read = names.into_iter().map(|name| {
        let range = book
            .worksheet_range(&name)
            .map_err(|error| failed(&error))?;
        let text = text(&range).map_err(|reason| failed(&reason))?;
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        let path = path.with_file_name(format!("{file} [{name}]"));
        Ok(Sheet { name, path, text })
    });
    let all: Result<Vec<Sheet>, FormatError> = read.collect();
    Some(all.map(|mut all| {
        all.retain(|sheet| !sheet.text.trim().is_empty());
        all
    }))
}

/// Whether bytes are an OpenDocument spreadsheet in one XML.
fn is_flat(bytes: &[u8]) -> bool {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(ROOT)]);
    head.trim_start().starts_with('<')
        && head.contains("<office:document ")
        && head.contains(OPEN_DOCUMENT)
}

/// The archive that an OpenDocument spreadsheet in one XML would be.
fn packed_flat(bytes: &[u8]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let stored =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    let manifest = "<manifest:manifest xmlns:manifest=\"urn\"/>";
    for (name, content) in [
        ("mimetype", OPEN_DOCUMENT.as_bytes()),
        ("META-INF/manifest.xml", manifest.as_bytes()),
        ("content.xml", &without_indentation(bytes)),
    ] {
        // Writing to memory cannot fail; an archive that is not whole is refused where it is read.
        let _ = archive
            .start_file(name, stored)
            .and_then(|()| Ok(archive.write_all(content)?));
    }
    archive.finish().map(Cursor::into_inner).unwrap_or_default()
}

/// An XML without the blanks between its marks, which the decoder does not pass over.
fn without_indentation(bytes: &[u8]) -> Vec<u8> {
    let mut kept = Vec::with_capacity(bytes.len());
    for part in bytes.split_inclusive(|byte| *byte == b'>') {
        let text = part.trim_ascii_start();
        kept.extend_from_slice(if text.first() == Some(&b'<') {
            text
        } else {
            part
        });
    }
    kept
}

fn text(range: &Range<Data>) -> Result<String, String> {
    let Some((row, column)) = range.start() else {
        return Ok(String::new());
    };
    let (height, width) = range.get_size();
    let fields = (height + row as usize).saturating_mul(width + column as usize);
    if fields > MOST_FIELDS {
        return Err(format!(
            "a sheet of {height} rows and {width} columns; export the table as CSV"
        ));
    }
    let mut text = "\n".repeat(row as usize);
    for cells in range.rows() {
        let mut line = "\t".repeat(column as usize);
        for (place, cell) in cells.iter().enumerate() {
            if place > 0 {
                line.push('\t');
            }
            line.push_str(&field(cell));
        }
        text.push_str(line.trim_end_matches('\t'));
        text.push('\n');
    }
    Ok(text)
}

fn field(cell: &Data) -> String {
    let plain = |text: &str| text.replace(['\t', '\n', '\r'], " ");
    match cell {
        Data::Empty => String::new(),
        Data::Int(number) => number.to_string(),
        Data::Float(number) => number.to_string(),
        Data::Bool(value) => value.to_string(),
        Data::DateTime(at) => {
            let days = at.as_f64();
            // A day is a number of whole days since 1900: what is less than one has no date.
            if at.is_duration() || days.abs() < 1.0 {
                clock(days * 86_400.0)
            } else {
                days.to_string()
            }
        }
        Data::DurationIso(text) => duration_s(text).map_or_else(|| plain(text), clock),
        Data::String(text) | Data::DateTimeIso(text) => plain(text),
        // `#DIV/0!` and the like: no number, which the reader of the column tells.
        other => plain(&other.to_string()),
    }
}

/// Seconds as `h:mm:ss`, to the microsecond: days are stored with 15 digits.
fn clock(seconds: f64) -> String {
    let whole = (seconds * 1.0e6).round();
    let (minutes, seconds) = ((whole / 6.0e7).floor(), whole.rem_euclid(6.0e7) / 1.0e6);
    let (hours, minutes) = ((minutes / 60.0).floor(), minutes.rem_euclid(60.0));
    format!("{hours}:{minutes:02}:{seconds}")
}

/// Seconds of a duration by ISO 8601, `PT1H2M3.5S`.
fn duration_s(text: &str) -> Option<f64> {
    let mut rest = text.strip_prefix("PT")?;
    let mut seconds = 0.0;
    for (unit, factor) in [('H', 3600.0), ('M', 60.0), ('S', 1.0)] {
        if let Some((number, after)) = rest.split_once(unit) {
            seconds += factor * number.replace(',', ".").parse::<f64>().ok()?;
            rest = after;
        }
    }
    rest.is_empty().then_some(seconds)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_become_clocks() {
        assert_eq!(clock(3723.5), "1:02:3.5");
        assert_eq!(clock(90_000.0), "25:00:0");
        // One third of a second as a share of a day comes back without a tail.
        assert_eq!(clock(0.25 / 86_400.0 * 86_400.0), "0:00:0.25");
        assert_eq!(duration_s("PT01H02M03.5S"), Some(3723.5));
        assert_eq!(duration_s("PT5S"), Some(5.0));
        assert_eq!(duration_s("5 s"), None);
    }

    #[test]
    fn a_cell_is_one_field_of_one_line() {
        assert_eq!(field(&Data::String("a\tb\nc".to_owned())), "a b c");
        assert_eq!(field(&Data::Float(0.1 + 0.2)), "0.30000000000000004");
        assert_eq!(field(&Data::Float(1e-9)), "0.000000001");
        let mut range = Range::new((2, 1), (3, 2));
        range.set_value((2, 1), Data::Int(7));
        range.set_value((3, 2), Data::Int(8));
        assert_eq!(text(&range).unwrap(), "\n\n\t7\n\t\t8\n");
        let huge = Range::new((1_000_000, 16_000), (1_000_000, 16_000));
        assert!(text(&huge).unwrap_err().contains("export the table as CSV"));
    }
}
