//! Tables: many spectra from columns, many results as columns.

use analysis::fit::{ErmRequest, Objective, Slope};
use analysis::numeric::Covariance2;
use analysis::rows::{Cell, CircuitRows, ColumnKind, ErmRows, ResultRow, ResultRows, ValidityRows};
use analysis::spectrum::ImpedancePoint;
use numpy::{Complex64, IntoPyArray, PyReadonlyArray1};
use pyo3::{
    prelude::*,
    types::{PyDict, PyList},
};
use rayon::prelude::*;

use crate::error::{apart, refused};
use crate::fit::{CHUNK, CircuitWishes};
use crate::spectrum::Spectrum;

/// A spectrum, or the reason why it is invalid.
#[derive(FromPyObject)]
pub(crate) struct Given {
    spectrum_id: String,
    spectrum: Option<Spectrum>,
    error: Option<String>,
}

/// Columns of points, of one length, as passed from Python; columns that a table lacks are `None`.
#[derive(FromPyObject)]
pub(crate) struct PointColumns<'py> {
    freq_hz: PyReadonlyArray1<'py, f64>,
    z_ohm: PyReadonlyArray1<'py, Complex64>,
    sigma_ohm: Option<PyReadonlyArray1<'py, f64>>,
    sigma_re_ohm: Option<PyReadonlyArray1<'py, f64>>,
    sigma_im_ohm: Option<PyReadonlyArray1<'py, f64>>,
    cov_re_im_ohm2: Option<PyReadonlyArray1<'py, f64>>,
    amplitude_a: Option<PyReadonlyArray1<'py, f64>>,
}

/// Returns the points of the rows of a table, by the rule of tables in long form: the deviations of
/// either part, otherwise the common one.
fn points_of(columns: &PointColumns<'_>) -> PyResult<Vec<ImpedancePoint>> {
    let (freq_hz, z_ohm) = (columns.freq_hz.as_slice()?, columns.z_ohm.as_slice()?);
    let optional = |column: &Option<PyReadonlyArray1<'_, f64>>| -> PyResult<Vec<f64>> {
        let values = column
            .as_ref()
            .map(|column| Ok(column.as_slice()?.to_vec()));
        values.unwrap_or_else(|| Ok(vec![f64::NAN; freq_hz.len()]))
    };
    let sigma = optional(&columns.sigma_ohm)?;
    let (sigma_re, sigma_im) = (
        optional(&columns.sigma_re_ohm)?,
        optional(&columns.sigma_im_ohm)?,
    );
    let (cov, amplitude) = (
        optional(&columns.cov_re_im_ohm2)?,
        optional(&columns.amplitude_a)?,
    );
    let lengths = [&sigma, &sigma_re, &sigma_im, &cov, &amplitude].map(Vec::len);
    if z_ohm.len() != freq_hz.len() || lengths.iter().any(|length| *length != freq_hz.len()) {
        return Err(refused(
            &"table: expected columns of one length, met several",
        ));
    }
    let points = (0..freq_hz.len()).map(|k| ImpedancePoint {
        freq_hz: freq_hz[k],
        z_ohm: z_ohm[k],
        covariance: covariance([sigma[k], sigma_re[k], sigma_im[k], cov[k]]),
        amplitude_a: amplitude[k],
    });
    Ok(points.collect())
}

/// Returns the covariance of `sigma_ohm`, `sigma_re_ohm`, `sigma_im_ohm` and `cov_re_im_ohm2`; not
/// a number where unknown.
fn covariance([sigma, re, im, re_im]: [f64; 4]) -> Covariance2 {
    if !re.is_nan() && !im.is_nan() {
        return Covariance2 {
            re_re: re * re,
            im_im: im * im,
            re_im: if re_im.is_nan() { 0.0 } else { re_im },
        };
    }
    match sigma.is_nan() {
        true => Covariance2::UNKNOWN,
        false => Covariance2::circular(sigma * sigma),
    }
}

/// Returns the spectra of columns: spectrum k holds the rows from `ends[k - 1]` to `ends[k]`.
#[pyfunction]
pub(crate) fn spectra_of_columns(
    names: Vec<String>,
    ends: Vec<usize>,
    columns: PointColumns<'_>,
) -> PyResult<Vec<(Option<Spectrum>, Option<String>)>> {
    let points = points_of(&columns)?;
    let mut from = 0;
    let mut found = Vec::with_capacity(names.len());
    for (name, end) in names.iter().zip(ends) {
        let Some(rows) = points.get(from..end) else {
            return Err(refused(
                &"table: expected columns of one length, met several",
            ));
        };
        found.push(match Spectrum::of(name, rows.to_vec()) {
            Ok(spectrum) => (Some(spectrum), None),
            Err(reason) => (None, Some(reason)),
        });
        from = end;
    }
    Ok(found)
}

/// Returns the rows of one kind of results as columns: name → (kind, values). With `alone` this
/// thread does all the work, because the caller has its own threads.
fn columns<'py>(
    py: Python<'py>,
    given: &[Given],
    kind: &(impl ResultRows + Send),
    alone: bool,
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
            Ok(match alone {
                true => chunk.iter().map(row).collect::<Vec<_>>(),
                false => chunk.par_iter().map(row).collect(),
            })
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
#[expect(
    clippy::too_many_arguments,
    reason = "they are keyword arguments of Python"
)]
pub(crate) fn erm_rows<'py>(
    py: Python<'py>,
    given: Vec<Given>,
    rc: Option<usize>,
    objective: &str,
    ocv_slope: Option<&str>,
    seed: u64,
    starts: usize,
    alone: bool,
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
    columns(py, &given, &ErmRows { request }, alone)
}

/// Returns a fit of a circuit to each.
#[pyfunction]
pub(crate) fn circuit_rows<'py>(
    py: Python<'py>,
    given: Vec<Given>,
    wishes: CircuitWishes,
    alone: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let (circuit, options) = wishes.read()?;
    let kind = CircuitRows {
        circuit,
        options,
        slope: Slope::Left,
    };
    columns(py, &given, &kind, alone)
}

/// Tests of validity of each, perhaps with relaxation times.
#[pyfunction]
pub(crate) fn validity_rows<'py>(
    py: Python<'py>,
    given: Vec<Given>,
    drt: bool,
    alone: bool,
) -> PyResult<Bound<'py, PyDict>> {
    columns(py, &given, &ValidityRows { drt }, alone)
}
