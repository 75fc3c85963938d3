//! Tables that a person writes: fields separated by commas, a header in the first line. Lines that
//! are empty or begin with `#` are comments.

use std::path::{Path, PathBuf};

/// A table as it stands in its file; every field without the blanks around it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
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
}

/// A table that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {source}", path.display())]
pub struct TableError {
    path: PathBuf,
    source: std::io::Error,
}

impl Table {
    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read or is no text.
    pub fn read(path: &Path) -> Result<Self, TableError> {
        let text = std::fs::read_to_string(path).map_err(|source| TableError {
            path: path.to_path_buf(),
            source,
        })?;
        Ok(Self::parse(&text))
    }

    fn parse(text: &str) -> Self {
        let mut rows = text
            .trim_start_matches('\u{feff}')
            .lines()
            .enumerate()
            .filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'))
            .map(|(index, line)| Row {
                line: index + 1,
                text: line.to_owned(),
            });
        let columns = rows
            .next()
            .map_or_else(Vec::new, |row| row.fields().map(str::to_owned).collect());
        Self {
            columns,
            rows: rows.collect(),
        }
    }

    /// Place of a column, from 0.
    pub fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }
}

impl Row {
    fn fields(&self) -> impl Iterator<Item = &str> {
        self.text.split(',').map(str::trim)
    }

    /// Number of its fields.
    pub fn width(&self) -> usize {
        self.fields().count()
    }

    /// Text of a field; empty where the row ends before it.
    pub fn field(&self, column: usize) -> &str {
        self.fields().nth(column).unwrap_or("")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_come_without_blanks_marks_and_comments() {
        let table = Table::parse("\u{feff}freq_hz , name\r\n# a comment\n\n 1.5, a \n2\n");
        assert_eq!(table.columns, ["freq_hz", "name"]);
        let rows: Vec<(usize, usize, &str, &str)> = table
            .rows
            .iter()
            .map(|row| (row.line, row.width(), row.field(0), row.field(1)))
            .collect();
        assert_eq!(rows, [(4, 2, "1.5", "a"), (5, 1, "2", "")]);
    }
}
