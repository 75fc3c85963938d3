//! Rows of results as a data frame.

use polars::prelude::{Column, DataFrame, PolarsResult};

use analysis_fit::rows::{Cell, ColumnKind, ResultColumn, ResultRow};

/// Converts rows to columns; a value whose type differs from its column becomes missing.
pub(super) fn frame(columns: &[ResultColumn], rows: &[ResultRow]) -> PolarsResult<DataFrame> {
    let cell = |row: usize, index: usize| rows[row].cells.get(index);
    let column = |(index, column): (usize, &ResultColumn)| {
        let all = 0..rows.len();
        let name = column.name.as_str().into();
        match column.kind {
            ColumnKind::Number => {
                let values = all.map(|row| match cell(row, index) {
                    Some(Cell::Number(value)) => *value,
                    _ => None,
                });
                Column::new(name, values.collect::<Vec<Option<f64>>>())
            }
            ColumnKind::Count => {
                let values = all.map(|row| match cell(row, index) {
                    Some(Cell::Count(value)) => *value,
                    _ => None,
                });
                Column::new(name, values.collect::<Vec<Option<u64>>>())
            }
            ColumnKind::Text => {
                let values = all.map(|row| match cell(row, index) {
                    Some(Cell::Text(value)) => value.as_deref(),
                    _ => None,
                });
                Column::new(name, values.collect::<Vec<Option<&str>>>())
            }
        }
    };
    DataFrame::new(rows.len(), columns.iter().enumerate().map(column).collect())
}
