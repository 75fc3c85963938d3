//! Tables of plain numbers, row by row, as CSV and Parquet, for all kinds of rows.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use polars::prelude::{Column, DataFrame, DataType};

use super::disk::{append_line, io_error, write_atomically};
use super::frame::{parquet_error, read_frame, write_frame};
use super::{ColumnSpec, DatasetError, FLAGS, shared};

/// Begin of the conditions of a point, in a CSV header.
const BIAS: &str = ",bias_a";

/// A row of numbers.
pub(super) trait Row: Sized {
    /// Its columns, in order.
    const COLUMNS: &'static [ColumnSpec];
    /// Number of columns that every file must have; a value of a further column that a file lacks
    /// is unknown.
    const NEEDED: usize = Self::COLUMNS.len();

    /// One number per column.
    fn values(&self) -> Vec<f64>;

    /// Creates the row if there is one number per column.
    fn from_values(values: &[f64]) -> Option<Self>;
}

pub(super) fn write_csv<R: Row>(path: &Path, rows: &[R]) -> Result<(), DatasetError> {
    let mut text = header::<R>();
    text.push('\n');
    for row in rows {
        text.push_str(&line(row));
        text.push('\n');
    }
    write_atomically(path, text.as_bytes())
}

pub(super) fn append_csv<R: Row>(path: &Path, row: &R) -> Result<(), DatasetError> {
    append_line(path, &header::<R>(), &line(row))
}

pub(super) fn read_csv<R: Row>(path: &Path) -> Result<Vec<R>, DatasetError> {
    let bytes = fs::read(path).map_err(|source| io_error(path, "read the file", source))?;
    let whole = bytes.iter().rposition(|byte| *byte == b'\n').unwrap_or(0);
    let text = String::from_utf8_lossy(&bytes[..whole]);
    let mut lines = text.split('\n').map(|line| line.trim_end_matches('\r'));
    let (expected, found) = (header::<R>(), lines.next().unwrap_or(""));
    // Conditions of a point and errors that rows share follow the columns of every row; another
    // reader parses them.
    let own = [&format!(",{}", shared::RE), FLAGS, BIAS]
        .into_iter()
        .filter_map(|more| found.find(more))
        .min()
        .map_or(found, |at| &found[..at]);
    let columns =
        (R::NEEDED..=R::COLUMNS.len()).find(|columns| own == names(&R::COLUMNS[..*columns]));
    let Some(columns) = columns else {
        return Err(DatasetError::Header {
            path: path.to_path_buf(),
            expected,
            found: found.to_owned(),
        });
    };
    let fields = if own.len() < found.len() {
        columns
    } else {
        usize::MAX
    };
    let cut = |line| first_fields(line, fields);
    lines
        .enumerate()
        .filter(|(_, line)| !line.is_empty())
        .map(|(index, line)| parse_line(path, index + 2, columns, cut(line)))
        .collect()
}

pub(super) fn write_parquet<R: Row>(path: &Path, rows: &[R]) -> Result<(), DatasetError> {
    write_frame(path, &mut frame(path, rows, None)?, R::COLUMNS, Vec::new())
}

/// Writes rows with one more column after them, one text per row.
pub(super) fn write_parquet_with<R: Row>(
    path: &Path,
    rows: &[R],
    spec: ColumnSpec,
    texts: &[String],
) -> Result<(), DatasetError> {
    let specs: Vec<ColumnSpec> = R::COLUMNS.iter().copied().chain([spec]).collect();
    let mut frame = frame(path, rows, Some(Column::new(spec.name.into(), texts)))?;
    write_frame(path, &mut frame, &specs, Vec::new())
}

/// Converts rows to columns, with one more column if given.
fn frame<R: Row>(path: &Path, rows: &[R], more: Option<Column>) -> Result<DataFrame, DatasetError> {
    let values: Vec<Vec<f64>> = rows.iter().map(Row::values).collect();
    let column = |(index, spec): (usize, &ColumnSpec)| {
        let cells: Vec<f64> = values
            .iter()
            .filter_map(|row| row.get(index).copied())
            .collect();
        Column::new(spec.name.into(), cells)
    };
    let columns = R::COLUMNS
        .iter()
        .enumerate()
        .map(column)
        .chain(more)
        .collect();
    DataFrame::new(rows.len(), columns)
        .map_err(|source| parquet_error(path, "arrange the columns", source))
}

pub(super) fn write_columns(
    path: &Path,
    columns: &[(ColumnSpec, &[f64])],
) -> Result<(), DatasetError> {
    let specs: Vec<ColumnSpec> = columns.iter().map(|(spec, _)| *spec).collect();
    let height = columns.first().map_or(0, |(_, values)| values.len());
    let columns = columns
        .iter()
        .map(|(spec, values)| Column::new(spec.name.into(), values))
        .collect();
    let mut frame = DataFrame::new(height, columns)
        .map_err(|source| parquet_error(path, "arrange the columns", source))?;
    write_frame(path, &mut frame, &specs, Vec::new())
}

pub(super) fn read_parquet<R: Row>(path: &Path) -> Result<Vec<R>, DatasetError> {
    let (frame, _) = read_frame(path)?;
    let column = |(index, spec): (usize, &ColumnSpec)| {
        let is_present = index < R::NEEDED || frame.column(spec.name).is_ok();
        if is_present {
            numbers(path, &frame, spec)
        } else {
            Ok(vec![f64::NAN; frame.height()])
        }
    };
    let columns: Vec<Vec<f64>> = R::COLUMNS
        .iter()
        .enumerate()
        .map(column)
        .collect::<Result<_, _>>()?;
    let row = |index: usize| {
        let values: Vec<f64> = columns
            .iter()
            .filter_map(|column| column.get(index).copied())
            .collect();
        R::from_values(&values)
    };
    Ok((0..frame.height()).filter_map(row).collect())
}

fn numbers(path: &Path, frame: &DataFrame, spec: &ColumnSpec) -> Result<Vec<f64>, DatasetError> {
    let wrong = |expected: &str, found: String| DatasetError::Column {
        path: path.to_path_buf(),
        column: spec.name.to_owned(),
        expected: expected.to_owned(),
        found,
    };
    let column = frame
        .column(spec.name)
        .map_err(|_| wrong("a column of 64-bit floats", "no such column".into()))?;
    if column.dtype() != &DataType::Float64 {
        return Err(wrong("64-bit floats", column.dtype().to_string()));
    }
    let cells = column
        .f64()
        .map_err(|error| wrong("64-bit floats", error.to_string()))?;
    // An empty cell and NaN both mean unknown.
    Ok(cells.iter().map(|cell| cell.unwrap_or(f64::NAN)).collect())
}

/// The first fields of a line.
fn first_fields(line: &str, count: usize) -> &str {
    line.match_indices(',')
        .nth(count.saturating_sub(1))
        .map_or(line, |(at, _)| &line[..at])
}

/// Writes rows with more columns after them, one text per row.
pub(super) fn write_csv_with<R: Row>(
    path: &Path,
    rows: &[R],
    more_header: &str,
    more: &[String],
) -> Result<(), DatasetError> {
    let mut text = header::<R>() + more_header + "\n";
    for (row, more) in rows.iter().zip(more) {
        text.push_str(&line(row));
        text.push_str(more);
        text.push('\n');
    }
    write_atomically(path, text.as_bytes())
}

fn header<R: Row>() -> String {
    names(R::COLUMNS)
}

fn names(columns: &[ColumnSpec]) -> String {
    let names: Vec<&str> = columns.iter().map(|spec| spec.name).collect();
    names.join(",")
}

fn line<R: Row>(row: &R) -> String {
    let mut text = String::new();
    for (index, value) in row.values().iter().enumerate() {
        let comma = if index > 0 { "," } else { "" };
        // Debug is the shortest text that reads back to the same bits, with an exponent where
        // digits would run long. Writing to a string cannot fail.
        let _ = write!(text, "{comma}{value:?}");
    }
    text
}

fn parse_line<R: Row>(
    path: &Path,
    line: usize,
    columns: usize,
    text: &str,
) -> Result<R, DatasetError> {
    let wrong = |column: &str, expected, found: &str| DatasetError::Field {
        path: path.to_path_buf(),
        line,
        column: column.to_owned(),
        expected,
        found: found.to_owned(),
    };
    let mut fields = text.split(',');
    let mut values = Vec::with_capacity(R::COLUMNS.len());
    for spec in &R::COLUMNS[..columns] {
        let field = fields
            .next()
            .ok_or_else(|| wrong(spec.name, "a number", "end of line"))?;
        let value = if field.trim().is_empty() {
            Ok(f64::NAN)
        } else {
            field.trim().parse()
        };
        values.push(value.map_err(|_| wrong(spec.name, "a number", field))?);
    }
    values.resize(R::COLUMNS.len(), f64::NAN);
    let last = R::COLUMNS[..columns].last().map_or("", |spec| spec.name);
    if let Some(extra) = fields.next() {
        return Err(wrong(last, "the end of the line after it", extra));
    }
    R::from_values(&values).ok_or_else(|| wrong(last, "one number per column", text))
}
