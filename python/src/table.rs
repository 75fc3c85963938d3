//! Tables: many spectra from columns, many results as columns.

use analysis::fit::{ErmRequest, Objective, Slope};
use analysis::rows::{Cell, CircuitRows, ColumnKind, ErmRows, ResultRow, ResultRows, ValidityRows};
use numpy::{Complex64, IntoPyArray, PyReadonlyArray1};
use pyo3::{
    prelude::*,
    types::{PyDict, PyList},
};
use rayon::prelude::*;

use crate::error::{apart, refused};
use crate::fit::{CHUNK, CircuitWishes};
use crate::spectrum::Spectrum;

/// A spectrum, or the reason why it is none.
#[derive(FromPyObject)]
pub(crate) struct Given {
    spectrum_id: String,
    spectrum: Option<Spectrum>,
    error: Option<String>,
}

/// Spectra of columns: spectrum k holds the rows from `ends[k - 1]` to `ends[k]`.
#[pyfunction]
#[pyo3(signature = (names, ends, freq_hz, z_ohm, sigma_ohm))]
pub(crate) fn spectra_of_columns(
    names: Vec<String>,
    ends: Vec<usize>,
    freq_hz: PyReadonlyArray1<'_, f64>,
    z_ohm: PyReadonlyArray1<'_, Complex64>,
    sigma_ohm: Option<PyReadonlyArray1<'_, f64>>,
) -> PyResult<Vec<(Option<Spectrum>, Option<String>)>> {
    let (freq_hz, z_ohm) = (freq_hz.as_slice()?, z_ohm.as_slice()?);
    let sigma_ohm = sigma_ohm.as_ref().map(|sigma| sigma.as_slice());
    let sigma_ohm = sigma_ohm.transpose()?;
    let mut from = 0;
    let mut found = Vec::with_capacity(names.len());
    for (name, end) in names.iter().zip(ends) {
        let rows = from..end;
        let part = (
            freq_hz.get(rows.clone()),
            z_ohm.get(rows.clone()),
            sigma_ohm.map(|sigma| sigma.get(rows)),
        );
        let (Some(freq_hz), Some(z_ohm), Some(sigma)) =
            (part.0, part.1, part.2.map_or(Some(None), |s| s.map(Some)))
        else {
            return Err(refused(
                &"table: expected columns of one length, met several",
            ));
        };
        found.push(match Spectrum::of(name, freq_hz, z_ohm, sigma) {
            Ok(spectrum) => (Some(spectrum), None),
            Err(reason) => (None, Some(reason)),
        });
        from = end;
    }
    Ok(found)
}

/// Rows of a kind of results as columns: name → (kind, values, which are known).
fn columns<'py>(
    py: Python<'py>,
    given: &[Given],
    kind: &(impl ResultRows + Send),
) -> PyResult<Bound<'py, PyDict>> {
    let mut rows: Vec<ResultRow> = Vec::with_capacity(given.len());
    for chunk in given.chunks(CHUNK) {
        py.check_signals()?;
        rows.extend(apart(py, || {
            let row = |one: &Given| {
                let spectrum = one.spectrum.as_ref().map(|s| s.sourced.clone());
                let reason = || one.error.clone().unwrap_or_default();
                kind.row(&one.spectrum_id, &spectrum.ok_or_else(reason))
            };
            Ok(chunk.par_iter().map(row).collect::<Vec<_>>())
        })?);
    }
    let table = PyDict::new(py);
    for (index, column) in kind.columns().iter().enumerate() {
        let cells = rows.iter().filter_map(|row| row.cells.get(index));
        let values = match column.kind {
            ColumnKind::Text => {
                let text = |cell: &Cell| match cell {
                    Cell::Text(text) => text.clone(),
                    _ => None,
                };
                PyList::new(py, cells.map(text))?.into_any()
            }
            ColumnKind::Number | ColumnKind::Count => {
                let number = |cell: &Cell| match cell {
                    Cell::Number(value) => value.unwrap_or(f64::NAN),
                    Cell::Count(value) => value.map_or(f64::NAN, |value| value as f64),
                    Cell::Text(_) => f64::NAN,
                };
                cells
                    .map(number)
                    .collect::<Vec<f64>>()
                    .into_pyarray(py)
                    .into_any()
            }
        };
        table.set_item(&column.name, (kind_name(column.kind), values))?;
    }
    Ok(table)
}

fn kind_name(kind: ColumnKind) -> &'static str {
    match kind {
        ColumnKind::Number => "number",
        ColumnKind::Count => "count",
        ColumnKind::Text => "text",
    }
}

/// A fit of the extended Randles model to each.
#[pyfunction]
pub(crate) fn erm_rows<'py>(
    py: Python<'py>,
    given: Vec<Given>,
    rc: Option<usize>,
    objective: &str,
    ocv_slope: Option<&str>,
    seed: u64,
    starts: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let objective: Objective = objective.parse().map_err(|e| refused(&e))?;
    let slope = Slope::asked(ocv_slope, objective)
        .map_err(|e| refused(&format!("ocv_slope{e}").replace("--", "")))?;
    let request = ErmRequest {
        rc,
        objective,
        slope,
        seed,
        starts,
    };
    columns(py, &given, &ErmRows { request })
}

/// A fit of a circuit to each.
#[pyfunction]
pub(crate) fn circuit_rows<'py>(
    py: Python<'py>,
    given: Vec<Given>,
    wishes: CircuitWishes,
) -> PyResult<Bound<'py, PyDict>> {
    let (circuit, options) = wishes.read()?;
    let kind = CircuitRows {
        circuit,
        options,
        slope: Slope::Left,
    };
    columns(py, &given, &kind)
}

/// Tests of validity of each, perhaps with relaxation times.
#[pyfunction]
pub(crate) fn validity_rows<'py>(
    py: Python<'py>,
    given: Vec<Given>,
    drt: bool,
) -> PyResult<Bound<'py, PyDict>> {
    columns(py, &given, &ValidityRows { drt })
}
