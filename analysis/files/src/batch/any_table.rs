//! Any columns of numbers and texts as a table.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use polars::prelude::{Column, CsvWriter, DataFrame, KeyValueMetadata, ParquetWriter, SerWriter};

use super::error::BatchError;
use crate::dataset::write_atomically;

/// Values of a column.
#[derive(Debug, Clone, PartialEq)]
pub enum Cells {
    /// Numbers; `None` where one is unknown.
    Numbers(Vec<Option<f64>>),
    /// Whole numbers.
    Counts(Vec<u32>),
    /// Texts; `None` where one is unknown.
    Texts(Vec<Option<String>>),
}

/// A column with its name, which holds its unit.
#[derive(Debug, Clone, PartialEq)]
pub struct TableColumn {
    /// Its name.
    pub name: &'static str,
    /// One value for each row.
    pub cells: Cells,
}

impl TableColumn {
    fn column(&self) -> Column {
        let name = self.name.into();
        match &self.cells {
            Cells::Numbers(values) => {
                let known = |value: &Option<f64>| value.filter(|value| !value.is_nan());
                Column::new(name, values.iter().map(known).collect::<Vec<_>>())
            }
            Cells::Counts(values) => Column::new(name, values),
            Cells::Texts(values) => Column::new(name, values),
        }
    }

    fn signed(&self) -> Column {
        match &self.cells {
            Cells::Counts(values) => {
                let signed: Vec<i64> = values.iter().copied().map(i64::from).collect();
                Column::new(self.name.into(), signed)
            }
            _ => self.column(),
        }
    }

    fn len(&self) -> usize {
        match &self.cells {
            Cells::Numbers(values) => values.len(),
            Cells::Counts(values) => values.len(),
            Cells::Texts(values) => values.len(),
        }
    }
}

/// Returns the CSV of columns, which must have the same length.
///
/// # Errors
/// [`BatchError`]: columns of different lengths.
pub fn csv_text(columns: &[TableColumn]) -> Result<String, BatchError> {
    let bytes = encoded(Path::new("the table"), columns, false)?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Writes columns as a table: Parquet for a file named `.parquet`, else CSV. All must have the same
/// length.
///
/// # Errors
/// [`BatchError`]: columns of different lengths, a file that cannot be written.
pub fn write_table(path: &Path, columns: &[TableColumn]) -> Result<(), BatchError> {
    let is_parquet = path.extension().is_some_and(|end| end == "parquet");
    let bytes = encoded(path, columns, is_parquet)?;
    Ok(write_atomically(path, &bytes)?)
}

/// Encodes a table for other programs as Parquet, with metadata of the whole table by key. Integers
/// become signed, because not every reader supports unsigned ones.
///
/// # Errors
/// [`BatchError`]: columns of different lengths.
pub fn parquet_bytes(
    columns: &[TableColumn],
    remarks: &BTreeMap<String, String>,
) -> Result<Vec<u8>, BatchError> {
    let failed = |source| BatchError::Parquet {
        path: PathBuf::from("the table"),
        action: "write the table",
        source,
    };
    let height = columns.first().map_or(0, TableColumn::len);
    let columns = columns.iter().map(TableColumn::signed).collect();
    let mut frame = DataFrame::new(height, columns).map_err(failed)?;
    let remarks = remarks.clone().into_iter().collect();
    let mut bytes = Vec::new();
    ParquetWriter::new(&mut bytes)
        .with_key_value_metadata(Some(KeyValueMetadata::from_static(remarks)))
        .finish(&mut frame)
        .map_err(failed)?;
    Ok(bytes)
}

fn encoded(path: &Path, columns: &[TableColumn], is_parquet: bool) -> Result<Vec<u8>, BatchError> {
    let failed = |source| BatchError::Parquet {
        path: path.to_path_buf(),
        action: "write the table",
        source,
    };
    let height = columns.first().map_or(0, TableColumn::len);
    let columns = columns.iter().map(TableColumn::column).collect();
    let mut frame = DataFrame::new(height, columns).map_err(failed)?;
    let mut bytes = Vec::new();
    if is_parquet {
        let writer = ParquetWriter::new(&mut bytes);
        writer.finish(&mut frame).map_err(failed)?;
    } else {
        CsvWriter::new(&mut bytes)
            .finish(&mut frame)
            .map_err(failed)?;
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_and_unknown_numbers_have_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let columns = [
            TableColumn {
                name: "cell",
                cells: Cells::Texts(vec![Some("a, \"b\"".to_owned()), None]),
            },
            TableColumn {
                name: "r_ohm",
                cells: Cells::Numbers(vec![Some(0.5), Some(f64::NAN)]),
            },
            TableColumn {
                name: "rc",
                cells: Cells::Counts(vec![1, 2]),
            },
        ];
        write_table(&path, &columns).unwrap();
        let text = std::fs::read_to_string(path).unwrap();
        assert_eq!(text, "cell,r_ohm,rc\n\"a, \"\"b\"\"\",0.5,1\n,,2\n");
    }
}
