//! Lines and fields of a text file, with their numbers. Knows nothing of columns.

use super::error::FormatError;
use std::path::{Path, PathBuf};

/// Longest excerpt of a file in a message, characters.
const EXCERPT: usize = 80;

/// The lines of a file that are neither blank nor comments.
#[derive(Debug)]
pub(super) struct Text<'a> {
    pub(super) path: &'a Path,
    pub(super) rows: Vec<Row<'a>>,
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
            FormatError::NotText { file: path.to_owned(), line, byte: rest.first().copied().unwrap_or(0) }
        })?;
        let rows = text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty() && !l.starts_with('#'));
        let rows = rows.map(|(line, raw)| Row { line, raw, fields: split(raw) }).collect();
        Ok(Self { path, rows, has_content: !text.trim().is_empty() })
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

fn split(line: &str) -> Vec<&str> {
    line.split(',').map(unquote).collect()
}

fn unquote(field: &str) -> &str {
    let field = field.trim();
    field.strip_prefix('"').and_then(|f| f.strip_suffix('"')).map_or(field, str::trim)
}
