//! Components of variance over a table.

use analysis::{
    mixed::{Estimate, Factor, Grouped, Level, Mixed, estimate_mixed, fit_mixed},
    numeric::stats,
};
use numpy::{IntoPyArray, PyReadonlyArray1};
use pyo3::{prelude::*, types::PyDict};

use crate::error::apart;

/// A table whose rows are grouped by factors, as passed from Python.
#[derive(FromPyObject)]
pub(crate) struct Rows<'py> {
    values: PyReadonlyArray1<'py, f64>,
    variances: Option<PyReadonlyArray1<'py, f64>>,
    covariates: Vec<PyReadonlyArray1<'py, f64>>,
    factors: Vec<String>,
    levels: Vec<PyReadonlyArray1<'py, i64>>,
}

/// Fixed part and components of variance of values: columns of each by their names. Without
/// `intervals` it takes a small part of the time.
#[pyfunction]
pub(crate) fn mixed<'py>(
    py: Python<'py>,
    rows: Rows<'py>,
    intervals: bool,
) -> PyResult<Bound<'py, PyDict>> {
    let values = rows.values.as_slice()?;
    let variances = rows.variances.as_ref().map(|column| column.as_slice());
    let covariates = rows.covariates.iter().map(|column| Ok(column.as_slice()?));
    let covariates: Vec<&[f64]> = covariates.collect::<PyResult<_>>()?;
    let levels = rows.levels.iter().map(|column| {
        let levels = column.as_slice()?.iter().map(|level| *level as usize);
        Ok(levels.collect())
    });
    let levels: Vec<Vec<usize>> = levels.collect::<PyResult<_>>()?;
    let factors = rows.factors.iter().zip(&levels);
    let factors: Vec<Factor<'_>> = factors
        .map(|(name, levels)| Factor { name, levels })
        .collect();
    let grouped = Grouped {
        values,
        variances: variances.transpose()?.unwrap_or_default(),
        covariates: &covariates,
        factors: &factors,
    };
    let found = apart(py, || {
        let found = match intervals {
            true => fit_mixed(&grouped),
            false => estimate_mixed(&grouped),
        };
        found.map_err(|error| error.to_string())
    })?;
    to_dict(py, found)
}

/// Returns the factor t with P(|T| ≤ t) = `level` for Student's distribution.
#[pyfunction]
pub(crate) fn t_factor(level: f64, freedom: f64) -> f64 {
    stats::t_factor(level, freedom)
}

fn to_dict(py: Python<'_>, found: Mixed) -> PyResult<Bound<'_, PyDict>> {
    let dict = PyDict::new(py);
    let pair = |one: &Estimate| (one.value, one.sigma);
    dict.set_item("fixed", found.fixed.iter().map(pair).collect::<Vec<_>>())?;
    let components = found.components.iter();
    let components = components.map(|one| (&one.name, one.sd, one.low, one.high, one.levels));
    dict.set_item("components", components.collect::<Vec<_>>())?;
    let levels = found.levels.iter().map(|levels| {
        let column = |of: fn(&Level) -> f64| {
            let values: Vec<f64> = levels.iter().map(of).collect();
            values.into_pyarray(py)
        };
        (
            column(|one| one.value),
            column(|one| one.sigma),
            column(|one| one.z),
        )
    });
    dict.set_item("levels", levels.collect::<Vec<_>>())?;
    Ok(dict)
}
