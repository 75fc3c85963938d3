//! Lines and fields of a text file, with their numbers. Knows nothing of columns.
//!
//! Fields are separated by semicolons where the first line that is no comment has one, else by
//! tabulators where it has one, else by commas. Between semicolons and tabulators a comma is a
//! decimal point; one file has one decimal mark.

use super::error::FormatError;
use super::write::WITH_SIGMA;
use std::path::{Path, PathBuf};

/// Longest excerpt of a file in a message, characters.
const EXCERPT: usize = 80;

/// The lines of a file that are neither blank nor comments.
#[derive(Debug)]
pub(super) struct Text<'a> {
    pub(super) path: &'a Path,
    pub(super) rows: Vec<Row<'a>>,
    /// Character between two fields.
    pub(super) separator: char,
    /// True when the file has characters at all.
    pub(super) has_content: bool,
}

/// One line.
#[derive(Debug, Clone)]
pub(super) struct Row<'a> {
    /// From 1, comments and blank lines counted.
    pub(super) line: usize,
    pub(super) raw: &'a str,
    /// Fields without surrounding blanks and quotes.
    pub(super) fields: Vec<&'a str>,
}

impl<'a> Text<'a> {
    pub(super) fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self, FormatError> {
        let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
        let text = std::str::from_utf8(bytes).map_err(|e| {
            let (valid, rest) = bytes.split_at(e.valid_up_to());
            let line = 1 + valid.iter().filter(|b| **b == b'\n').count();
            FormatError::NotText {
                file: path.to_owned(),
                line,
                byte: rest.first().copied().unwrap_or(0),
            }
        })?;
        let lines: Vec<(usize, &str)> = lines(text)
            .map(|(number, line)| (number, announced(line).unwrap_or(line)))
            .filter(|(_, line)| !is_comment(line))
            .collect();
        let separator = separator(lines.first().map_or("", |(_, first)| first));
        let rows = lines
            .into_iter()
            .map(|(line, raw)| Row {
                line,
                raw: raw.trim(),
                fields: split(raw, separator),
            })
            .collect();
        Ok(Self {
            path,
            rows,
            separator,
            has_content: !text.trim().is_empty(),
        })
    }

    /// Refuses a file in which one number has a decimal comma and another a decimal point: one of
    /// them would be wrong by a factor.
    pub(super) fn one_mark(&self) -> Result<(), FormatError> {
        if self.separator == ',' {
            return Ok(());
        }
        let mut known = None;
        for row in &self.rows {
            for mark in row
                .fields
                .iter()
                .filter_map(|field| mark(field, self.separator))
            {
                if *known.get_or_insert(mark) != mark {
                    let expected = "one decimal mark in all numbers, a comma or a point".to_owned();
                    return Err(FormatError::Header {
                        file: self.file(),
                        line: row.line,
                        expected,
                        met: format!("both in {}", row.excerpt()),
                    });
                }
            }
        }
        Ok(())
    }

    pub(super) fn file(&self) -> PathBuf {
        self.path.to_owned()
    }
}

impl Row<'_> {
    /// The line in quotes, shortened for a message.
    pub(super) fn excerpt(&self) -> String {
        shorten(self.raw)
    }
}

/// Text in quotes, shortened for a message.
pub(super) fn shorten(text: &str) -> String {
    let mut short: String = text.chars().take(EXCERPT).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    format!("\"{short}\"")
}

/// The names of columns that a comment announces, as files of impedance.py with uncertainties have
/// them.
fn announced(line: &str) -> Option<&str> {
    let names = line.strip_prefix('#')?.trim();
    (names == WITH_SIGMA).then_some(names)
}

fn split(line: &str, separator: char) -> Vec<&str> {
    fields(line, separator).collect()
}

/// A text in UTF-16 with a byte order mark, as UTF-8; nothing for any other bytes. What is no
/// character becomes a mark that no reader takes for a number.
pub(super) fn utf_16(bytes: &[u8]) -> Option<String> {
    let unit: fn([u8; 2]) -> u16 = match bytes {
        [0xFF, 0xFE, ..] => u16::from_le_bytes,
        [0xFE, 0xFF, ..] => u16::from_be_bytes,
        _ => return None,
    };
    let pairs = bytes.get(2..)?.chunks_exact(2);
    let units = pairs.filter_map(|pair| Some(unit(pair.try_into().ok()?)));
    let characters = char::decode_utf16(units);
    Some(
        characters
            .map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER))
            .collect(),
    )
}

/// Fields of a line without surrounding blanks and quotes.
pub(crate) fn fields(line: &str, separator: char) -> impl Iterator<Item = &str> {
    line.split(separator).map(unquote)
}

/// Lines of a text that are not blank, with their numbers from 1.
pub(crate) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    (1..)
        .zip(text.lines().map(|line| line.trim_end_matches('\r')))
        .filter(|(_, line)| !line.trim().is_empty())
}

/// Whether a line is a comment.
pub(crate) fn is_comment(line: &str) -> bool {
    line.trim_start().starts_with('#')
}

/// Character between two fields, as the first line that is no comment tells it.
pub(crate) fn separator(first: &str) -> char {
    [';', '\t']
        .into_iter()
        .find(|separator| first.contains(*separator))
        .unwrap_or(',')
}

/// The number in a field. Where fields are not separated by commas, a comma is a decimal point;
/// thousands are not grouped.
pub(crate) fn number(field: &str, separator: char) -> Option<f64> {
    if separator == ',' || !field.contains(',') {
        return field.parse().ok();
    }
    // A comma without a digit behind it parts fields.
    let decimal = field
        .split_once(',')
        .is_some_and(|(_, digits)| digits.starts_with(|c: char| c.is_ascii_digit()));
    let plain = decimal && !field.contains('.') && field.matches(',').count() == 1;
    plain
        .then(|| field.replacen(',', ".", 1))
        .and_then(|field| field.parse().ok())
}

/// The decimal mark of a field that is a number with one.
pub(super) fn mark(field: &str, separator: char) -> Option<char> {
    let mark = [',', '.'].into_iter().find(|mark| field.contains(*mark))?;
    number(field, separator).map(|_| mark)
}

pub(super) fn unquote(field: &str) -> &str {
    let field = field.trim();
    field
        .strip_prefix('"')
        .and_then(|f| f.strip_suffix('"'))
        .map_or(field, str::trim)
}
