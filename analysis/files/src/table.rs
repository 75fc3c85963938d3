//! Tables that a person writes: a header in the first line, and fields as in other tables
//! (`formats::text`), separated by commas, semicolons or tabs, with or without quotes.

use std::path::{Path, PathBuf};

use crate::formats::text;

/// A table with the places of its fields in the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// Number of the header's line in the file, from 1.
    pub header_line: usize,
    /// Names of the columns, in order.
    pub columns: Vec<String>,
    /// Rows, in order; each may have more or fewer fields than the header.
    pub rows: Vec<Row>,
}

/// A row of a [`Table`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Row {
    /// Number of its line in the file, from 1.
    pub line: usize,
    text: String,
    separator: char,
}

/// Meaning of a line that begins with `#`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hash {
    /// A comment, which is skipped.
    Comment,
    /// A normal row: its first field may be a name such as `#12`.
    Row,
}

/// A table that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
pub struct TableError {
    path: PathBuf,
    source: std::io::Error,
}

impl Table {
    /// Reads a file; blank lines are skipped.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read or is not text.
    pub fn read(path: &Path, hash: Hash) -> Result<Self, TableError> {
        let text = std::fs::read_to_string(path).map_err(|source| TableError {
            path: path.to_path_buf(),
            source,
        })?;
        Ok(Self::parse(&text, hash))
    }

    fn parse(text: &str, hash: Hash) -> Self {
        let mut lines = text::lines(text.trim_start_matches('\u{feff}'))
            .filter(|(_, line)| hash == Hash::Row || !text::is_comment(line));
        let (header_line, header) = lines.next().unwrap_or((1, ""));
        let separator = text::separator(header);
        let columns = text::fields(header, separator).map(str::to_owned).collect();
        let row = |(line, text): (usize, &str)| Row {
            line,
            text: text.to_owned(),
            separator,
        };
        Self {
            header_line,
            columns,
            rows: lines.map(row).collect(),
        }
    }

    /// Returns the index of a column, from 0.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }
}

impl Row {
    /// Returns the number of its fields.
    pub fn width(&self) -> usize {
        text::fields(&self.text, self.separator).count()
    }

    /// Returns the text of a field; empty if the row ends before it.
    pub fn field(&self, column: usize) -> &str {
        text::fields(&self.text, self.separator)
            .nth(column)
            .unwrap_or("")
    }

    /// Parses the number in a field. Accepts a decimal comma if the fields are not separated by
    /// commas.
    pub fn number(&self, column: usize) -> Option<f64> {
        text::number(self.field(column), self.separator)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows<'a>(table: &'a Table) -> Vec<(usize, usize, &'a str, &'a str)> {
        let row = |row: &'a Row| (row.line, row.width(), row.field(0), row.field(1));
        table.rows.iter().map(row).collect()
    }

    #[test]
    fn fields_come_without_blanks_marks_and_comments() {
        let text = "\u{feff}# made by hand\r\nfreq_hz , \"name\"\r\n  # a comment\n\n 1.5, a \n2\n";
        let table = Table::parse(text, Hash::Comment);
        assert_eq!((table.header_line, table.columns.len()), (2, 2));
        assert_eq!(table.column("name"), Some(1));
        assert_eq!(rows(&table), [(5, 2, "1.5", "a"), (6, 1, "2", "")]);
    }

    #[test]
    fn a_name_may_begin_with_a_hash_where_there_are_no_comments() {
        let table = Table::parse("name,group\n#12,1\n", Hash::Row);
        assert_eq!(rows(&table), [(2, 2, "#12", "1")]);
    }

    #[test]
    fn between_semicolons_a_comma_is_a_decimal_point() {
        let table = Table::parse("a;b\n1,5;2\n", Hash::Comment);
        assert_eq!(table.rows[0].number(0), Some(1.5));
        let table = Table::parse("a,b\n1,5\n", Hash::Comment);
        assert_eq!(table.rows[0].number(0), Some(1.0));
    }
}
