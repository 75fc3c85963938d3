//! A CSV table in long form, a block of lines at a time.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use super::columns::{ID, NEEDED, NUMBERS, Rows, names, place};
use super::error::BatchError;
use crate::formats::text;

/// Lines of one block: some megabytes.
const BLOCK: usize = 1 << 16;

/// Reader of a CSV table.
#[derive(Debug)]
pub(super) struct CsvRows {
    path: PathBuf,
    file: BufReader<File>,
    separator: char,
    width: usize,
    id: Option<usize>,
    numbers: [Option<usize>; NUMBERS],
    /// Lines read.
    line: usize,
    /// Bytes read, and bytes of the file.
    bytes: (u64, u64),
}

impl CsvRows {
    /// Opens a file and reads its header.
    pub(super) fn open(path: &Path) -> Result<Self, BatchError> {
        let failed = |source| io(path, source);
        let file = File::open(path).map_err(failed)?;
        let size = file.metadata().map_err(failed)?.len();
        let mut rows = Self {
            path: path.to_path_buf(),
            file: BufReader::new(file),
            separator: ',',
            width: 0,
            id: None,
            numbers: [None; NUMBERS],
            line: 0,
            bytes: (0, size),
        };
        let header = rows.line()?.unwrap_or_default();
        let header = header.trim_start_matches('\u{feff}');
        rows.separator = text::separator(header);
        let columns: Vec<&str> = text::fields(header, rows.separator).collect();
        let at = |name: &str| columns.iter().position(|column| *column == name);
        for needed in NEEDED {
            if at(needed).is_none() {
                return Err(BatchError::Column {
                    path: rows.path,
                    column: needed.to_owned(),
                    of: "",
                    met: columns.join(", "),
                });
            }
        }
        (rows.id, rows.width) = (at(ID), columns.len());
        for (place, name) in rows.numbers.iter_mut().zip(names()) {
            *place = at(name);
        }
        Ok(rows)
    }

    /// Whether a column identifies the spectrum of a row.
    pub(super) fn has_ids(&self) -> bool {
        self.id.is_some()
    }

    /// Returns the share of the file that has been read.
    pub(super) fn share(&self) -> f64 {
        self.bytes.0 as f64 / self.bytes.1.max(1) as f64
    }

    /// Returns the next rows; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Rows>, BatchError> {
        let mut rows = Rows::default();
        while rows.len() < BLOCK {
            let Some(line) = self.line()? else { break };
            if line.trim().is_empty() || text::is_comment(&line) {
                continue;
            }
            if rows.len() == 0 {
                rows.first = self.line;
            }
            self.take(&line, &mut rows);
        }
        Ok((rows.len() > 0).then_some(rows))
    }

    fn take(&self, line: &str, rows: &mut Rows) {
        let fields: Vec<&str> = text::fields(line, self.separator).collect();
        let nth = rows.len();
        let refuse = |what: String| format!("{}: {what}", place("line", self.line));
        if fields.len() != self.width {
            let (expected, met) = (self.width, fields.len());
            let reason = refuse(format!("expected {expected} fields, met {met}"));
            rows.refused.entry(nth).or_insert(reason);
        }
        if let Some(id) = self.id {
            rows.ids
                .push(fields.get(id).copied().unwrap_or_default().to_owned());
        }
        for ((column, list), name) in self.numbers.iter().zip(&mut rows.numbers).zip(names()) {
            let Some(column) = column else { continue };
            let field = fields.get(*column).copied().unwrap_or_default();
            let value = text::number(field, self.separator);
            let may_be_empty = !NEEDED.contains(&name);
            if value.is_none() && !(field.is_empty() && may_be_empty) {
                let what = format!("column {name}: expected a number, met {field:?}");
                rows.refused.entry(nth).or_insert(refuse(what));
            }
            list.push(value.unwrap_or(f64::NAN));
        }
    }

    fn line(&mut self) -> Result<Option<String>, BatchError> {
        let mut bytes = Vec::new();
        let count = self
            .file
            .read_until(b'\n', &mut bytes)
            .map_err(|source| io(&self.path, source))?;
        if count == 0 {
            return Ok(None);
        }
        self.line += 1;
        self.bytes.0 += count as u64;
        let line = String::from_utf8(bytes).map_err(|_| BatchError::Row {
            path: self.path.clone(),
            place: place("line", self.line),
            expected: "UTF-8 text",
            met: "other bytes".to_owned(),
        })?;
        Ok(Some(line.trim_end_matches(['\n', '\r']).to_owned()))
    }
}

fn io(path: &Path, source: std::io::Error) -> BatchError {
    BatchError::Io {
        path: path.to_path_buf(),
        action: "read the file",
        source,
    }
}
