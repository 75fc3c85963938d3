//! A Parquet table in long form, a group of rows at a time.

use std::collections::VecDeque;
use std::fs::File;
use std::path::{Path, PathBuf};

use polars::prelude::{DataFrame, DataType, ParquetReader, PolarsError, SerReader};

use super::columns::{ID, NEEDED, Rows, names, place};
use super::error::BatchError;

/// Maximum number of rows that are decoded at once: 8 columns of this length are 64 MB.
const MOST_ROWS: usize = 1 << 20;

/// Reader of a Parquet table.
#[derive(Debug)]
pub(super) struct ParquetRows {
    path: PathBuf,
    columns: Vec<String>,
    /// First row and number of rows of the part that is still to be read.
    groups: VecDeque<(usize, usize)>,
    /// Rows of the table.
    total: usize,
}

impl ParquetRows {
    /// Opens a file and checks its columns.
    pub(super) fn open(path: &Path) -> Result<Self, BatchError> {
        let failed = |source| failed(path, "read it as Parquet", source);
        let mut reader = reader(path)?;
        let schema = reader.schema().map_err(failed)?;
        let met: Vec<String> = schema.iter_names().map(ToString::to_string).collect();
        for needed in NEEDED {
            if !met.iter().any(|column| column == needed) {
                return Err(BatchError::Column {
                    path: path.to_path_buf(),
                    column: needed.to_owned(),
                    of: "",
                    met: met.join(", "),
                });
            }
        }
        let known = |column: &String| column == ID || names().any(|name| name == column);
        let metadata = reader.get_metadata().map_err(failed)?;
        let (mut groups, mut total) = (VecDeque::new(), 0);
        for group in &metadata.row_groups {
            let rows = group.num_rows();
            for from in (0..rows).step_by(MOST_ROWS) {
                groups.push_back((total + from, MOST_ROWS.min(rows - from)));
            }
            total += rows;
        }
        Ok(Self {
            path: path.to_path_buf(),
            columns: met.into_iter().filter(known).collect(),
            groups,
            total,
        })
    }

    /// Share of the table that is read.
    pub(super) fn share(&self) -> f64 {
        let left: usize = self.groups.iter().map(|group| group.1).sum();
        1.0 - left as f64 / self.total.max(1) as f64
    }

    /// Returns the next rows; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Rows>, BatchError> {
        let Some((from, count)) = self.groups.pop_front() else {
            return Ok(None);
        };
        let frame = reader(&self.path)?
            .with_columns(Some(self.columns.clone()))
            .with_slice(Some((from, count)))
            .finish()
            .map_err(|source| failed(&self.path, "decode the table", source))?;
        let mut rows = Rows {
            first: from + 1,
            ..Rows::default()
        };
        if self.columns.iter().any(|column| column == ID) {
            rows.ids = self.ids(&frame, from)?;
        }
        for (index, name) in names().enumerate() {
            if self.columns.iter().any(|column| column == name) {
                rows.numbers[index] = self.numbers(&frame, name, &mut rows)?;
            }
        }
        Ok(Some(rows))
    }

    fn ids(&self, frame: &DataFrame, from: usize) -> Result<Vec<String>, BatchError> {
        let failed = |source| failed(&self.path, "read the column spectrum_id as text", source);
        let column = frame.column(ID).map_err(failed)?;
        let texts = column.cast(&DataType::String).map_err(failed)?;
        let texts = texts.str().map_err(failed)?;
        texts
            .iter()
            .enumerate()
            .map(|(row, text)| {
                text.map(str::to_owned).ok_or_else(|| BatchError::Row {
                    path: self.path.clone(),
                    place: place("row", from + row + 1),
                    expected: "a spectrum_id",
                    met: "none".to_owned(),
                })
            })
            .collect()
    }

    fn numbers(
        &self,
        frame: &DataFrame,
        name: &'static str,
        rows: &mut Rows,
    ) -> Result<Vec<f64>, BatchError> {
        let failed = |source| failed(&self.path, "read a column", source);
        let column = frame.column(name).map_err(failed)?;
        if !column.dtype().is_primitive_numeric() {
            return Err(BatchError::Column {
                path: self.path.clone(),
                column: name.to_owned(),
                of: " of numbers",
                met: format!("{:?}", column.dtype()),
            });
        }
        let column = column.cast(&DataType::Float64).map_err(failed)?;
        let values = column.f64().map_err(failed)?;
        let mut numbers = Vec::with_capacity(values.len());
        for (row, value) in values.iter().enumerate() {
            if value.is_none() && NEEDED.contains(&name) {
                let at = place("row", rows.first + row);
                let what = format!("{at}: column {name}: expected a number, met none");
                rows.refused.entry(row).or_insert(what);
            }
            numbers.push(value.unwrap_or(f64::NAN));
        }
        Ok(numbers)
    }
}

/// Returns whether two files are Parquet tables of the same columns and rows, whichever program wrote them.
pub fn has_same_rows(one: &Path, other: &Path) -> bool {
    let table = |path: &Path| reader(path).ok()?.finish().ok();
    match (table(one), table(other)) {
        (Some(one), Some(other)) => one.equals_missing(&other),
        _ => false,
    }
}

fn reader(path: &Path) -> Result<ParquetReader<File>, BatchError> {
    let file = File::open(path).map_err(|source| BatchError::Io {
        path: path.to_path_buf(),
        action: "read the file",
        source,
    })?;
    Ok(ParquetReader::new(file))
}

fn failed(path: &Path, action: &'static str, source: PolarsError) -> BatchError {
    BatchError::Parquet {
        path: path.to_path_buf(),
        action,
        source,
    }
}
