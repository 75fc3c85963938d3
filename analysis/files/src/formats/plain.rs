//! Normalises the text of a file for the readers: UTF-8, ASCII punctuation, and no separator within a
//! field.
//!
//! * UTF-16 with a byte order mark, UTF-8, else a code page of one byte (the first half is ASCII, and
//!   the second Latin)
//! * the minus U+2212 becomes `-`; non-breaking blanks between digits group thousands and are removed
//! * a table by RFC 4180 whose quoted fields contain the separator gets tabs as separators. In a
//!   column of numbers with decimal points, commas before groups of three digits group thousands and
//!   are removed

use super::text;
use std::borrow::Cow;

/// Minimum number of fields of a row of a table.
const FIELDS: usize = 3;
/// Non-breaking blanks.
const FIXED_BLANKS: [char; 3] = ['\u{a0}', '\u{202f}', '\u{2009}'];

/// Decodes bytes to text. Lines keep their numbers.
pub(super) fn text(bytes: &[u8]) -> Cow<'_, str> {
    let decoded = match text::utf_16(bytes) {
        Some(decoded) => Cow::Owned(decoded.trim_start_matches('\u{feff}').to_owned()),
        None => {
            let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
            std::str::from_utf8(bytes).map_or_else(
                |_| Cow::Owned(bytes.iter().map(|byte| char::from(*byte)).collect()),
                Cow::Borrowed,
            )
        }
    };
    let is_odd = |c: char| c == '\u{2212}' || FIXED_BLANKS.contains(&c);
    let typed = if decoded.is_ascii() || !decoded.contains(is_odd) {
        decoded
    } else {
        Cow::Owned(typed(&decoded))
    };
    if !typed.contains('"') {
        return typed;
    }
    let unquoted = [';', '\t', ',']
        .into_iter()
        .find_map(|separator| without_quotes(&typed, separator));
    unquoted.map_or(typed, Cow::Owned)
}

/// Replaces typographic characters by ASCII.
fn typed(text: &str) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut characters = text.chars().peekable();
    let mut before = '\n';
    while let Some(c) = characters.next() {
        let next = characters.peek().copied().unwrap_or('\n');
        let grouping = before.is_ascii_digit() && next.is_ascii_digit();
        match c {
            '\u{2212}' => kept.push('-'),
            blank if FIXED_BLANKS.contains(&blank) && grouping => {}
            blank if FIXED_BLANKS.contains(&blank) => kept.push(' '),
            other => kept.push(other),
        }
        before = c;
    }
    kept
}

/// Returns the table with tabs as separators if quoted fields of its rows contain the separator;
/// else `None`.
fn without_quotes(text: &str, separator: char) -> Option<String> {
    if !may_hold(text, separator) {
        return None;
    }
    let byte = u8::try_from(separator).ok()?;
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(byte)
        .has_headers(false)
        .flexible(true)
        .from_reader(text.as_bytes());
    let mut records: Vec<(usize, Vec<String>)> = Vec::new();
    let (mut holds, mut line, mut counted) = (false, 1, 0);
    for record in reader.records() {
        let record = record.ok()?;
        // A record begins after preceding blank lines.
        let start = record.position().map_or(0, csv::Position::byte);
        let start = usize::try_from(start).ok()?;
        let blank = text
            .get(start..)?
            .find(|c| !matches!(c, '\n' | '\r'))
            .unwrap_or(0);
        line += text.get(counted..start + blank)?.matches('\n').count();
        counted = start + blank;
        let fields: Vec<String> = record.iter().map(plain).collect();
        holds |= fields.len() >= FIELDS && record.iter().any(|field| field.contains(separator));
        records.push((line, fields));
    }
    if !holds {
        return None;
    }
    let width = records
        .iter()
        .map(|(_, fields)| fields.len())
        .max()
        .unwrap_or(0);
    for column in 0..width {
        ungroup(&mut records, column);
    }
    let mut lines = String::with_capacity(text.len());
    let mut at = 1;
    for (line, fields) in &records {
        // A field over several lines leaves blank lines, so that line numbers stay.
        while at < *line {
            lines.push('\n');
            at += 1;
        }
        lines.push_str(&fields.join("\t"));
        lines.push('\n');
        at += 1;
    }
    Some(lines)
}

/// Returns whether a quoted field of some line contains the separator.
fn may_hold(text: &str, separator: char) -> bool {
    text.lines().any(|line| {
        let mut quoted = false;
        line.chars().any(|c| {
            quoted ^= c == '"';
            quoted && c == separator
        })
    })
}

/// Joins a field to one line without tabs.
fn plain(field: &str) -> String {
    field.trim().replace(['\t', '\n', '\r'], " ")
}

/// Removes the thousands commas of a column: some of its numbers have a decimal point, and every comma
/// precedes three digits.
fn ungroup(records: &mut [(usize, Vec<String>)], column: usize) {
    let fields = || records.iter().filter_map(|(_, fields)| fields.get(column));
    let number = |field: &&String| {
        field.contains(|c: char| c.is_ascii_digit())
            && field
                .chars()
                .all(|c| c.is_ascii_digit() || "+-.,eE".contains(c))
    };
    let has_point = fields().filter(number).any(|field| field.contains('.'));
    let mut with_comma = fields()
        .filter(number)
        .filter(|field| field.contains(','))
        .peekable();
    let grouped = has_point
        && with_comma.peek().is_some()
        && with_comma.all(|field| text::is_grouped(field, ','));
    if !grouped {
        return;
    }
    for (_, fields) in records {
        if let Some(field) = fields
            .get_mut(column)
            .filter(|field| text::is_grouped(field, ','))
        {
            *field = field.replace(',', "");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quoted_separators_become_tabulators_and_lines_keep_their_numbers() {
        assert_eq!(
            text(b"\"a, b\",c,d\n\n\"1,5\",\"2,5\",3\n\"x\ny\",1,2\nz,3,4\n"),
            "a, b\tc\td\n\n1,5\t2,5\t3\nx y\t1\t2\n\nz\t3\t4\n"
        );
        // Quotes without a separator inside stay.
        assert_eq!(
            text(b"\"a\",\"b\",\"c\"\n1,2,3\n"),
            "\"a\",\"b\",\"c\"\n1,2,3\n"
        );
        assert_eq!(
            text(b"\"f\",\"re\",\"im\"\n\"31,622.78\",\"0.1\",\"0\"\n\"1,000\",\"0.2\",\"0\"\n"),
            "f\tre\tim\n31622.78\t0.1\t0\n1000\t0.2\t0\n"
        );
    }

    #[test]
    fn signs_of_a_typesetter_become_those_of_a_typewriter() {
        assert_eq!(
            text("1\u{a0}000;\u{2212}2;a\u{a0}b".as_bytes()),
            "1000;-2;a b"
        );
        assert_eq!(text(b"Imagin\xE4rteil"), "Imaginärteil");
    }
}
