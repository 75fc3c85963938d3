//! Limits that a workbook must meet before it is decoded. A file of some kilobytes can expand to any
//! size: by parts that are compressed a thousandfold, by counts that the decoder allocates for, and
//! by repeated cells. A failed allocation aborts the program, so it must be prevented.

use std::io::{BufRead, BufReader, Cursor, Read};

use zip::ZipArchive;

/// Maximum size of all parts of a workbook: a million rows of 20 columns are 1 GB of XML.
const MOST_UNPACKED: u64 = 4 << 30;
/// Maximum number of fields of a sheet: some hundred megabytes as text.
pub(super) const MOST_FIELDS: usize = 50_000_000;
/// Maximum number of fields after the repetition of OpenDocument cells: the decoder holds two lists
/// of them.
const MOST_REPEATED: usize = 20_000_000;
/// Maximum size of the text of a sheet: a million rows of 20 columns have some 200 MB.
pub(super) const MOST_TEXT: usize = 1 << 29;
/// Maximum size of one tag with the text before it.
const MOST_TAG: u64 = 1 << 24;
/// Maximum number of columns of a sheet, to which the decoder limits repetitions.
const MOST_COLUMNS: usize = 16_384;
const MOST_ROWS: usize = 1 << 20;
/// Bytes of a part that are searched for a count of strings.
const ROOT: usize = 4096;

/// Refuses a workbook that exceeds the limits.
///
/// # Errors
/// Describes the exceeded limit.
pub(super) fn check(bytes: &[u8]) -> Result<(), String> {
    check_within(bytes, MOST_UNPACKED)
}

/// Like [`check`], with the maximum unpacked size of all parts.
fn check_within(bytes: &[u8], most: u64) -> Result<(), String> {
    let Ok(mut archive) = ZipArchive::new(Cursor::new(bytes)) else {
        return check_old(bytes);
    };
    let is_workbook = archive
        .file_names()
        .flatten()
        .any(|name| name.starts_with("xl/") || name == CONTENT);
    if !is_workbook {
        return Ok(());
    }
    let mut left = most;
    for index in 0..archive.len() {
        // The decoder reports parts that cannot be decoded.
        let Ok(part) = archive.by_index(index) else {
            continue;
        };
        let name = part
            .name()
            .map(|name| name.into_owned())
            .unwrap_or_default();
        let mut reader = Counted {
            inner: part,
            left: &mut left,
        };
        let checked = if name == CONTENT {
            check_content(&mut BufReader::new(&mut reader))
        } else if name.ends_with("sharedStrings.xml") {
            check_strings(&mut reader)
        } else {
            Ok(())
        };
        checked.map_err(|reason| format!("{name}: {reason}"))?;
        // The decoder reports truncated parts.
        let _ = std::io::copy(&mut reader, &mut std::io::sink());
        if left == 0 {
            return Err(format!(
                "its parts unpack to more than {most} bytes; export the table as CSV"
            ));
        }
    }
    Ok(())
}

/// Tags that end the part with the sheets, in an archive and in one XML.
const ROOT_ENDS: [&[u8]; 2] = [b"</office:document-content>", b"</office:document>"];
/// OpenDocument's part with the sheets.
const CONTENT: &str = "content.xml";

/// A reader that fails when all parts together exceed their maximum size.
struct Counted<'a, R> {
    inner: R,
    left: &'a mut u64,
}

impl<R: Read> Read for Counted<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let most = usize::try_from(*self.left).unwrap_or(usize::MAX);
        let wanted = buffer.len().min(most);
        let count = self.inner.read(&mut buffer[..wanted])?;
        *self.left -= count as u64;
        Ok(count)
    }
}

/// Refuses a count of strings that its part cannot contain.
fn check_strings(reader: &mut impl Read) -> Result<(), String> {
    let mut root = Vec::new();
    // The decoder reports truncated parts.
    let _ = reader.take(ROOT as u64).read_to_end(&mut root);
    let rest = std::io::copy(reader, &mut std::io::sink()).unwrap_or(0);
    let length = root.len() as u64 + rest;
    let text = String::from_utf8_lossy(&root);
    let claimed = attribute(&text, "uniqueCount").and_then(|count| count.parse::<u64>().ok());
    match claimed {
        Some(count) if count > length => Err(format!(
            "it announces {count} strings and has {length} bytes; save the workbook again, or export \
             the table as CSV"
        )),
        _ => Ok(()),
    }
}

/// Returns the value of an attribute in a text of XML.
fn attribute<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let (_, behind) = text.split_once(name)?;
    let behind = behind.trim_start().strip_prefix('=')?.trim_start();
    let quote = behind.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    behind[1..].split_once(quote).map(|(value, _)| value)
}

/// Counts of the cells and texts that an OpenDocument sheet expands to.
#[derive(Default)]
struct Repeated {
    fields: usize,
    text: usize,
    /// Empty cells that count only where another one follows.
    pending: usize,
    row_text: usize,
    row_repeats: usize,
    /// Number of repetitions of the text of the open cell.
    open: usize,
}

impl Repeated {
    /// Processes a tag with the text before it.
    fn take(&mut self, piece: &str) {
        let repeats = |name: &str, most: usize| {
            let count = attribute(piece, name).and_then(|count| count.parse::<usize>().ok());
            count.unwrap_or(1).min(most)
        };
        let tag = piece.rfind('<').map_or(piece, |at| &piece[at..]);
        // Numeric cells do not hold text; the text of a cell precedes its closing tag.
        self.row_text += (piece.len() - tag.len()) * self.open;
        if tag.starts_with("<table:table-row") {
            self.row_repeats = repeats("number-rows-repeated", MOST_ROWS);
            (self.pending, self.row_text) = (0, 0);
        } else if tag.starts_with("</table:table-row") {
            self.text = self
                .text
                .saturating_add(self.row_text.saturating_mul(self.row_repeats));
        } else if tag.starts_with("</table:") {
            self.open = 0;
        } else if piece.contains("number-columns-repeated") || tag.starts_with("<table:table-cell")
        {
            let count = repeats("number-columns-repeated", MOST_COLUMNS);
            let is_cell = tag.starts_with("<table:table-cell") || tag.starts_with("<table:covered");
            let is_empty = is_cell && !tag.contains("office:") && !tag.contains("table:formula");
            if tag.starts_with("<table:table-column") {
                return;
            }
            if is_empty {
                self.pending = count;
            } else {
                self.fields = self.fields.saturating_add(count + self.pending);
                self.pending = 0;
                let texts = [
                    "office:string-value",
                    "office:date-value",
                    "office:time-value",
                ];
                let texts = texts.iter().filter_map(|name| attribute(tag, name));
                self.row_text += texts.map(str::len).sum::<usize>() * count;
                self.open = if tag.ends_with("/>") { 0 } else { count };
            }
        }
    }
}

/// Refuses sheets of OpenDocument that expand beyond the limits.
fn check_content(reader: &mut impl BufRead) -> Result<(), String> {
    let mut counts = Repeated::default();
    let mut piece = Vec::new();
    let mut is_whole = false;
    loop {
        piece.clear();
        // The decoder reports truncated parts.
        let read = reader
            .take(MOST_TAG)
            .read_until(b'>', &mut piece)
            .unwrap_or(0);
        if read == 0 {
            // The decoder hangs on a table that is truncated.
            return match is_whole {
                true => Ok(()),
                false => Err("it breaks off before the end of the document".to_owned()),
            };
        }
        if !piece.trim_ascii().is_empty() {
            is_whole = ROOT_ENDS.iter().any(|end| piece.ends_with(end));
        }
        if read as u64 == MOST_TAG {
            return Err(format!(
                "a tag of more than {MOST_TAG} bytes; export the table as CSV"
            ));
        }
        counts.take(&String::from_utf8_lossy(&piece));
        if counts.fields > MOST_REPEATED || counts.text > MOST_TEXT || counts.row_text > MOST_TEXT {
            return Err(format!(
                "its sheets have more than {MOST_REPEATED} fields or {} MiB of text; export the \
                 table as CSV",
                MOST_TEXT >> 20
            ));
        }
    }
}

/// Refuses a workbook of Excel before 2007 whose sheet announces more than its 65536 rows: its record
/// `DIMENSIONS` has 14 bytes, of which the last two are 0.
fn check_old(bytes: &[u8]) -> Result<(), String> {
    const RECORD: &[u8] = &[0, 2, 14, 0];
    const LENGTH: usize = 18;
    let word = |record: &[u8], at: usize| {
        let part: Option<[u8; 4]> = record.get(at..at + 4).and_then(|part| part.try_into().ok());
        part.map_or(0, u32::from_le_bytes)
    };
    let claimed = bytes
        .windows(LENGTH)
        .filter(|record| record.starts_with(RECORD) && record.ends_with(&[0, 0]))
        .map(|record| (word(record, 4), word(record, 8)))
        .find(|(first, last)| *last > 1 << 16 && last > first);
    claimed.map_or(Ok(()), |(_, rows)| {
        Err(format!(
            "a sheet that announces {rows} rows, where this kind of workbook has 65536 at most; save it \
             again, or export the table as CSV"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn counted(rows: &str) -> (usize, usize) {
        let mut counts = Repeated::default();
        for piece in rows.split_inclusive('>') {
            counts.take(piece);
        }
        (counts.fields, counts.text)
    }

    #[test]
    fn repeated_cells_count_as_often_as_they_are_repeated() {
        let cell = "<table:table-cell office:value-type=\"float\" office:value=\"1\"/>";
        let row = |cells: &str| format!("<table:table-row>{cells}</table:table-row>");
        assert_eq!(counted(&row(cell)).0, 1);
        let many = cell.replace(
            "office:value=",
            "table:number-columns-repeated='300' office:value=",
        );
        assert_eq!(counted(&row(&many)).0, 300);
        // Empty cells count if another one follows, up to the columns of a sheet.
        let empty = "<table:table-cell table:number-columns-repeated=\"99999\"/>";
        assert_eq!(counted(&row(empty)).0, 0);
        assert_eq!(counted(&row(&format!("{empty}{cell}"))).0, MOST_COLUMNS + 1);
        // The text of a cell is repeated with its row and its column.
        let word = "<table:table-cell table:number-columns-repeated=\"10\" office:value-type=\"string\">\
                    <text:p>0123456789</text:p></table:table-cell>";
        let text = format!(
            "<table:table-row table:number-rows-repeated=\"1000\">{word}</table:table-row>"
        );
        assert_eq!(counted(&text), (10, 100_000));
        let given = word.replace(
            "office:value-type",
            "office:string-value=\"01234\" office:value-type",
        );
        let text = text.replace(word, &given);
        assert_eq!(counted(&text).1, 150_000);
        // A number has no text.
        assert_eq!(counted(&row(&many)).1, 0);
    }

    #[test]
    fn parts_are_counted_as_they_unpack() {
        let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for name in ["xl/a.xml", "xl/media/b.png"] {
            let options = zip::write::SimpleFileOptions::default();
            archive.start_file(name, options).unwrap();
            archive.write_all(&[0; 500_000]).unwrap();
        }
        let bytes = archive.finish().unwrap().into_inner();
        assert!(bytes.len() < 5000, "{}", bytes.len());
        assert_eq!(check_within(&bytes, 1_000_001), Ok(()));
        let refused = check_within(&bytes, 999_999).unwrap_err();
        assert!(
            refused.starts_with("its parts unpack to more than 999999 bytes"),
            "{refused}"
        );
    }

    #[test]
    fn attributes_are_read_in_either_quotes() {
        assert_eq!(
            attribute("<sst count=\"7\" uniqueCount = '12'>", "uniqueCount"),
            Some("12")
        );
        assert_eq!(attribute("<sst uniqueCount>", "uniqueCount"), None);
        assert_eq!(attribute("<sst uniqueCount=\"12", "uniqueCount"), None);
    }
}
