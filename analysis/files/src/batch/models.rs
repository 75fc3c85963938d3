//! Models from a table of fits.

use std::fs::File;
use std::path::Path;

use analysis_model::model::{Erm, RcBranch};
use polars::prelude::{
    CsvReadOptions, DataFrame, DataType, ParquetReader, PolarsResult, SerReader,
};

use super::columns::ID;
use super::error::BatchError;
use super::long_form::is_parquet;

/// Column of the series resistance of a model, Ω.
const SERIES: &str = "r_ohm";

/// A model of a table of fits, or the reason why the row holds none.
#[derive(Debug, Clone, PartialEq)]
pub struct TableModel {
    /// Value of `spectrum_id`.
    pub spectrum_id: String,
    /// The model.
    pub model: Result<Erm, String>,
}

/// Returns whether a file is a table of fits of extended Randles models: Parquet or CSV with the
/// columns `spectrum_id` and `r_ohm`.
pub fn is_table_of_models(path: &Path) -> bool {
    header(path).is_ok_and(|names| [ID, SERIES].iter().all(|n| names.iter().any(|m| m == n)))
}

/// Reads the models of a table that `fit --table` has written: `r_ohm`, then `r1_ohm`, `c1_f`, …
/// for all RC pairs. A row without a fit yields the reason in its column `error`.
///
/// # Errors
/// [`BatchError`] for a file that cannot be read or lacks a column.
pub fn read_models(path: &Path) -> Result<Vec<TableModel>, BatchError> {
    let failed = |source| BatchError::Parquet {
        path: path.to_path_buf(),
        action: "read it as a table of fits",
        source,
    };
    let names = header(path).map_err(failed)?;
    let has = |name: &str| names.iter().any(|met| met == name);
    for needed in [ID, SERIES] {
        if !has(needed) {
            return Err(BatchError::Column {
                path: path.to_path_buf(),
                column: needed.to_owned(),
                of: "",
                met: names.join(", "),
            });
        }
    }
    let branches: Vec<[String; 2]> = (1..)
        .map(|k| [format!("r{k}_ohm"), format!("c{k}_f")])
        .take_while(|pair| pair.iter().all(|name| has(name)))
        .collect();
    let mut wanted = vec![ID.to_owned(), SERIES.to_owned()];
    wanted.extend(branches.iter().flatten().cloned());
    wanted.extend(has("error").then(|| "error".to_owned()));
    let frame = read(path, &wanted).map_err(failed)?;
    let texts = |name: &str| -> PolarsResult<Vec<Option<String>>> {
        let column = frame.column(name)?.cast(&DataType::String)?;
        Ok(column.str()?.iter().map(|t| t.map(str::to_owned)).collect())
    };
    let numbers = |name: &str| -> PolarsResult<Vec<Option<f64>>> {
        let column = frame.column(name)?.cast(&DataType::Float64)?;
        Ok(column.f64()?.iter().collect())
    };
    let ids = texts(ID).map_err(failed)?;
    let errors = if has("error") {
        texts("error").map_err(failed)?
    } else {
        vec![None; ids.len()]
    };
    let series = numbers(SERIES).map_err(failed)?;
    let columns = branches
        .iter()
        .map(|[r, c]| Ok([numbers(r)?, numbers(c)?]))
        .collect::<PolarsResult<Vec<_>>>()
        .map_err(failed)?;
    let model = |row: usize| {
        let Some(r_ohm) = series[row] else {
            let reason = errors[row].clone().filter(|reason| !reason.is_empty());
            return Err(reason.unwrap_or_else(|| format!("{SERIES}: expected a number, met none")));
        };
        let branches = columns
            .iter()
            .map_while(|[r, c]| {
                let (r_ohm, c_f) = r[row].zip(c[row])?;
                Some(RcBranch { r_ohm, c_f })
            })
            .collect();
        Ok(Erm { r_ohm, branches })
    };
    Ok(ids
        .into_iter()
        .enumerate()
        .map(|(row, id)| TableModel {
            spectrum_id: id.unwrap_or_default(),
            model: model(row),
        })
        .collect())
}

/// Names of the columns.
fn header(path: &Path) -> PolarsResult<Vec<String>> {
    if is_parquet(path) {
        let schema = ParquetReader::new(File::open(path)?).schema()?;
        return Ok(schema.iter_names().map(ToString::to_string).collect());
    }
    let frame = CsvReadOptions::default()
        .with_n_rows(Some(0))
        .try_into_reader_with_file_path(Some(path.to_path_buf()))?
        .finish()?;
    Ok(frame
        .get_column_names()
        .into_iter()
        .map(ToString::to_string)
        .collect())
}

fn read(path: &Path, wanted: &[String]) -> PolarsResult<DataFrame> {
    if is_parquet(path) {
        return ParquetReader::new(File::open(path)?)
            .with_columns(Some(wanted.to_vec()))
            .finish();
    }
    let wanted = wanted.iter().map(|name| name.as_str().into()).collect();
    CsvReadOptions::default()
        .with_infer_schema_length(None)
        .with_columns(Some(wanted))
        .try_into_reader_with_file_path(Some(path.to_path_buf()))?
        .finish()
}
