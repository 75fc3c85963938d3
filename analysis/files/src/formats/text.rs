//! Lines and fields of a text file, with their numbers. Independent of columns.
//!
//! The first line that is not a comment determines the separator: a semicolon, else a tab, else a
//! comma. With semicolons and tabs, a comma is a decimal point; a file has one decimal mark.

use super::error::FormatError;
use super::write::WITH_SIGMA;
use std::path::{Path, PathBuf};

/// Maximum length of an excerpt of a file in a message, characters.
const EXCERPT: usize = 80;

/// The lines of a file that are neither blank nor comments.
#[derive(Debug)]
pub(super) struct Text<'a> {
    pub(super) path: &'a Path,
    pub(super) rows: Vec<Row<'a>>,
    /// Character between two fields.
    pub(super) separator: char,
    /// Whether the file has any characters.
    pub(super) has_content: bool,
}

/// One line.
#[derive(Debug, Clone)]
pub(super) struct Row<'a> {
    /// Its number from 1, including comments and blank lines.
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

    /// Refuses a file in which one number has a decimal comma and another a decimal point, because
    /// one of them would be wrong by a factor.
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
    /// Returns the line in quotes, shortened for a message.
    pub(super) fn excerpt(&self) -> String {
        shorten(self.raw)
    }
}

/// Returns text in quotes, shortened for a message.
pub(super) fn shorten(text: &str) -> String {
    let mut short: String = text.chars().take(EXCERPT).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    format!("\"{short}\"")
}

/// Returns the names of columns in a comment, as in files of impedance.py with uncertainties.
pub(super) fn announced(line: &str) -> Option<&str> {
    let names = line.strip_prefix('#')?.trim();
    (names == WITH_SIGMA).then_some(names)
}

fn split(line: &str, separator: char) -> Vec<&str> {
    fields(line, separator).collect()
}

/// Decodes UTF-16 with a byte order mark; returns `None` for any other bytes. Invalid characters
/// become the replacement character, which no reader accepts in a number.
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

/// Splits a line into fields without surrounding blanks and quotes. Consecutive blanks count as one
/// separator.
pub(crate) fn fields(line: &str, separator: char) -> impl Iterator<Item = &str> {
    let by_blanks = separator == ' ';
    let parts = line.split(move |c| c == separator || by_blanks && c == '\t');
    parts
        .map(unquote)
        .filter(move |field| !by_blanks || !field.is_empty())
}

/// Returns the lines of a text that are not blank, with their numbers from 1.
pub(crate) fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    (1..)
        .zip(text.lines().map(|line| line.trim_end_matches('\r')))
        .filter(|(_, line)| !line.trim().is_empty())
}

/// Returns whether a line is a comment.
pub(crate) fn is_comment(line: &str) -> bool {
    line.trim_start().starts_with('#')
}

/// Returns the separator from the first line that is not a comment: a semicolon, a tab, a comma, or
/// blanks if there is none of these or each word is a number.
pub(crate) fn separator(first: &str) -> char {
    let found = [';', '\t', ',']
        .into_iter()
        .find(|separator| first.contains(*separator));
    let mut words = first.split_whitespace();
    let several = words.clone().count() > 1;
    match found {
        None if several => ' ',
        // With a decimal comma.
        Some(',') if several && words.all(|word| number(word, ' ').is_some()) => ' ',
        found => found.unwrap_or(','),
    }
}

/// Parses the number in a field. If fields are not separated by commas, a comma is a decimal point.
/// If a number has a comma and a point, the first one groups thousands, as does an apostrophe. An
/// exponent may be written with `D`, as in Fortran.
pub(crate) fn number(field: &str, separator: char) -> Option<f64> {
    if !field.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '+' | '.' | ',')) {
        return field.parse().ok();
    }
    if separator == ',' || !field.contains([',', '\'', '’']) {
        return plain_number(field);
    }
    let ungrouped = |mark: char| is_grouped(field, mark).then(|| field.replace(mark, ""));
    if let Some(field) = ungrouped('\'').or_else(|| ungrouped('’')) {
        return number(&field, separator);
    }
    let (commas, points) = (field.matches(',').count(), field.matches('.').count());
    // A comma without a digit after it separates fields.
    let decimal = field
        .rsplit_once(',')
        .is_some_and(|(_, digits)| digits.starts_with(|c: char| c.is_ascii_digit()));
    match (commas, points) {
        (1, 0) if decimal => plain_number(&field.replacen(',', ".", 1)),
        (2.., 0) | (1.., 1) if is_grouped(field, ',') => plain_number(&field.replace(',', "")),
        (1, 1..) if is_grouped(field, '.') => {
            plain_number(&field.replace('.', "").replacen(',', ".", 1))
        }
        _ => None,
    }
}

fn plain_number(field: &str) -> Option<f64> {
    let fortran = || {
        let (mantissa, exponent) = field.split_once(['D', 'd'])?;
        format!("{mantissa}e{exponent}").parse().ok()
    };
    field.parse().ok().or_else(fortran)
}

/// Returns whether each of these marks in a number precedes three digits of its integer part.
pub(super) fn is_grouped(field: &str, mark: char) -> bool {
    let field = field.trim_start_matches(['-', '+']);
    let ends = |c: char| c != mark && matches!(c, '.' | ',' | 'e' | 'E' | 'D');
    let whole = field.split(ends).next().unwrap_or_default();
    let mut groups = whole.split(mark);
    let first = groups.next().unwrap_or_default();
    let digits = |group: &str| !group.is_empty() && group.chars().all(|c| c.is_ascii_digit());
    let mut rest = groups.peekable();
    let within = rest.peek().is_some();
    within
        && digits(first)
        && first.len() <= 3
        && !first.starts_with('0')
        && rest.all(|group| group.len() == 3 && digits(group))
        && field.matches(mark).count() == whole.matches(mark).count()
}

/// Smallest number that means overload or not measured: SCPI writes 9.9E37 and 9.91E37.
const OVERLOAD: f64 = 9.0e37;

/// Returns whether a number can be a measurement.
pub(crate) fn is_measured(value: f64) -> bool {
    value.abs() < OVERLOAD
}

/// Words for a value that was not measured.
const MISSING: [&str; 21] = [
    "",
    "nan",
    "na",
    "n/a",
    "#n/a",
    "null",
    "none",
    "-",
    "--",
    "---",
    "ol",
    "o.l",
    "ovl",
    "ovld",
    "ovrld",
    "over",
    "+over",
    "-over",
    "overrange",
    "overload",
    "overflow",
];

/// Returns whether a field marks a missing measurement.
pub(crate) fn is_missing(field: &str) -> bool {
    let short = field.len() <= 9 && !field.starts_with(|c: char| c.is_ascii_digit());
    short && MISSING.iter().any(|word| field.eq_ignore_ascii_case(word))
}

/// Returns the decimal mark of a number, if it has one: the last comma or point.
pub(super) fn mark(field: &str, separator: char) -> Option<char> {
    let at = field.rfind([',', '.'])?;
    let mark = field[at..].chars().next()?;
    let alone = field.matches(mark).count() == 1;
    number(field, separator).filter(|_| alone).map(|_| mark)
}

pub(super) fn unquote(field: &str) -> &str {
    let field = field.trim();
    field
        .strip_prefix('"')
        .and_then(|f| f.strip_suffix('"'))
        .map_or(field, str::trim)
}
