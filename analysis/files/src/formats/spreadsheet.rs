//! Converts sheets of a spreadsheet to tab-separated texts for the other readers: Excel (`.xlsx`,
//! `.xlsm`, `.xlsb`, `.xls`) and OpenDocument (`.ods`, and `.fods`, which is one XML file).
//!
//! Lines and fields of a text are rows and columns of the sheet. Times of day and durations become
//! `h:mm:ss`.

mod bounds;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};
use std::path::{Path, PathBuf};

use self::bounds::{MOST_FIELDS, MOST_TEXT};
use super::error::FormatError;
use calamine::{
    Cell, Data, DataRef, Ods, Range, Reader as _, Sheets, XlsxError, open_workbook_auto_from_rs,
};

/// First bytes of a ZIP archive, and of the files of Excel before 2007.
const MAGIC: [&[u8]; 2] = [b"PK\x03\x04", b"\xD0\xCF\x11\xE0\xA1\xB1\x1A\xE1"];
/// Bytes of an XML file that are searched for its root element.
const ROOT: usize = 4096;
/// Media type of an OpenDocument spreadsheet.
const OPEN_DOCUMENT: &str = "application/vnd.oasis.opendocument.spreadsheet";
/// Maximum number of cells of a sheet that are not in the order of rows and columns.
const MOST_DISORDERED: usize = 5_000_000;

/// A workbook in memory.
type Book<'a> = Sheets<Cursor<Cow<'a, [u8]>>>;

/// One sheet.
#[derive(Debug)]
pub(super) struct Sheet {
    pub(super) name: String,
    /// Returns the file with the name of the sheet, for messages: `data.xlsx [Sheet1]`.
    pub(super) path: PathBuf,
    pub(super) text: String,
}

/// Returns the sheets of a file that are not empty; `None` if it is not a spreadsheet.
///
/// # Errors
/// [`FormatError::Decode`] if it cannot be decoded.
pub(super) fn sheets(path: &Path, bytes: &[u8]) -> Option<Result<Vec<Sheet>, FormatError>> {
    let failed = |reason: &dyn std::fmt::Display| FormatError::Decode {
        file: path.to_owned(),
        kind: "a spreadsheet",
        reason: reason.to_string(),
    };
    let mut book: Book<'_> = if is_flat(bytes) {
        let packed = packed_flat(bytes);
        if let Err(reason) = bounds::check(&packed) {
            return Some(Err(failed(&reason)));
        }
        match Ods::new(Cursor::new(Cow::Owned(packed))) {
            Ok(book) => Sheets::Ods(book),
            Err(error) => return Some(Err(failed(&error))),
        }
    } else if MAGIC.iter().any(|magic| bytes.starts_with(magic)) {
        if let Err(reason) = bounds::check(bytes) {
            return Some(Err(failed(&reason)));
        }
        // Other archives and compound files are reported by their format.
        open_workbook_auto_from_rs(Cursor::new(Cow::Borrowed(bytes))).ok()?
    } else {
        return None;
    };
    let names = book.sheet_names();
    let read = names.into_iter().map(|name| {
        let text = sheet(&mut book, &name).map_err(|reason| failed(&reason))?;
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

/// Returns whether bytes are an OpenDocument spreadsheet in one XML file.
fn is_flat(bytes: &[u8]) -> bool {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(ROOT)]);
    head.trim_start().starts_with('<')
        && head.contains("<office:document ")
        && head.contains(OPEN_DOCUMENT)
}

/// Packs an OpenDocument spreadsheet in one XML file into the equivalent archive.
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
        // Writing to memory cannot fail; an incomplete archive is refused by its reader.
        let _ = archive
            .start_file(name, stored)
            .and_then(|()| Ok(archive.write_all(content)?));
    }
    archive.finish().map(Cursor::into_inner).unwrap_or_default()
}

/// Removes the blanks between the tags of an XML file, which the decoder does not skip.
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

/// Returns the text of a sheet. Cells of the newer formats are read one by one, so that two cells
/// at opposite corners of a sheet do not allocate a table of 17 thousand million fields.
fn sheet(book: &mut Book<'_>, name: &str) -> Result<String, String> {
    let message = |error: &dyn std::fmt::Display| error.to_string();
    match book {
        Sheets::Xlsx(book) => {
            let mut cells = match book.worksheet_cells_reader(name) {
                Ok(cells) => cells,
                // A sheet that contains only a chart.
                Err(XlsxError::NotAWorksheet(_)) => return Ok(String::new()),
                Err(error) => return Err(message(&error)),
            };
            of_cells(|| cells.next_cell().map_err(|error| message(&error)))
        }
        Sheets::Xlsb(book) => {
            let cells = book.worksheet_cells_reader(name);
            let mut cells = cells.map_err(|error| message(&error))?;
            of_cells(|| cells.next_cell().map_err(|error| message(&error)))
        }
        book => {
            let range = book.worksheet_range(name);
            text(&range.map_err(|error| message(&error))?)
        }
    }
}

/// Returns the text of cells.
///
/// # Errors
/// Returns an error if a cell cannot be decoded or the text exceeds the limit.
fn of_cells<'a>(
    mut next: impl FnMut() -> Result<Option<Cell<DataRef<'a>>>, String>,
) -> Result<String, String> {
    let mut text = String::new();
    let (mut row, mut column) = (0, 0);
    // Cells that come before one that was already written.
    let mut late: BTreeMap<(u32, u32), String> = BTreeMap::new();
    let mut late_bytes = 0;
    while let Some(cell) = next()? {
        let at = cell.get_position();
        let field = field(&Data::from(cell.get_value().clone()));
        if field.is_empty() {
            continue;
        }
        if at < (row, column) || at == (row, column) && !text.is_empty() {
            late_bytes += field.len();
            late.insert(at, field);
            if late.len() > MOST_DISORDERED || late_bytes > MOST_TEXT {
                return Err(format!(
                    "more than {MOST_DISORDERED} cells that do not stand in the order of rows and \
                     columns; save it again, or export the table as CSV"
                ));
            }
            continue;
        }
        let rows = (at.0 - row) as usize;
        let columns = if rows > 0 { at.1 } else { at.1 - column } as usize;
        if text.len() + rows + columns + field.len() > MOST_TEXT {
            return Err(format!(
                "a sheet of more than {} MiB of text; export the table as CSV",
                MOST_TEXT >> 20
            ));
        }
        text.extend(std::iter::repeat_n('\n', rows));
        text.extend(std::iter::repeat_n('\t', columns));
        text.push_str(&field);
        (row, column) = at;
    }
    if !text.is_empty() {
        text.push('\n');
    }
    Ok(if late.is_empty() {
        text
    } else {
        with_late(&text, &late)
    })
}

/// Inserts cells that came too late for their place in the text.
fn with_late(text: &str, late: &BTreeMap<(u32, u32), String>) -> String {
    let mut merged = String::with_capacity(text.len());
    for (row, line) in (0..).zip(text.lines()) {
        let mut fields: Vec<&str> = line.split('\t').collect();
        for ((_, column), field) in late.range((row, 0)..=(row, u32::MAX)) {
            let column = *column as usize;
            if fields.len() <= column {
                fields.resize(column + 1, "");
            }
            fields[column] = field;
        }
        merged.push_str(&fields.join("\t"));
        merged.push('\n');
    }
    merged
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
            // A date is a number of days since 1900: a value below one has no date.
            if at.is_duration() || days.abs() < 1.0 {
                clock(days * 86_400.0)
            } else {
                days.to_string()
            }
        }
        Data::DurationIso(text) => duration_s(text).map_or_else(|| plain(text), clock),
        Data::String(text) | Data::DateTimeIso(text) => plain(text),
        // `#DIV/0!` and similar: not a number; the reader of the column reports it.
        other => plain(&other.to_string()),
    }
}

/// Formats seconds as `h:mm:ss`, to the microsecond, because days are stored with 15 digits.
fn clock(seconds: f64) -> String {
    let whole = (seconds * 1.0e6).round();
    let (minutes, seconds) = ((whole / 6.0e7).floor(), whole.rem_euclid(6.0e7) / 1.0e6);
    let (hours, minutes) = ((minutes / 60.0).floor(), minutes.rem_euclid(60.0));
    format!("{hours}:{minutes:02}:{seconds}")
}

/// Parses a duration by ISO 8601, `PT1H2M3.5S`, to seconds.
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
mod tests;
