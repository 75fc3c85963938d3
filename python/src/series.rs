//! Current and voltage over time: files of cyclers, captures of a scope, the open-circuit voltage.

use std::path::PathBuf;

use analysis::dataset::read_capture as read_capture_file;
use analysis::formats::{CurrentSign, ReadSeries, SeriesOptions, read_record};
use analysis::ocv::{OcvCurve, OcvOptions, extract};
use analysis::series::TimeSeries;
use numpy::{IntoPyArray, PyReadonlyArray1};
use pyo3::{prelude::*, types::PyDict};

use crate::error::{apart, caught, json, refused};

/// Columns of a record, and remarks on how it was read.
#[pyfunction]
#[pyo3(signature = (path, sign=None))]
pub(crate) fn read_series<'py>(
    py: Python<'py>,
    path: PathBuf,
    sign: Option<&str>,
) -> PyResult<(Bound<'py, PyDict>, Vec<String>)> {
    let sign = sign.map(str::parse::<CurrentSign>).transpose();
    let options = SeriesOptions {
        sign: sign.map_err(|error| refused(&format!("sign: {error}")))?,
    };
    let ReadSeries {
        series,
        notes,
        state,
        ..
    } = apart(py, || {
        read_record(&path, &options).map_err(|error| error.to_string())
    })?;
    let columns = PyDict::new(py);
    columns.set_item("time_s", series.time_s.into_pyarray(py))?;
    columns.set_item("current_a", series.current_a.into_pyarray(py))?;
    columns.set_item("voltage_v", series.voltage_v.into_pyarray(py))?;
    if let Some(temperature_degc) = series.temperature_degc {
        columns.set_item("temperature_c", temperature_degc.into_pyarray(py))?;
    }
    if let Some(net_ah) = state.net_ah {
        columns.set_item("net_ah", net_ah.into_pyarray(py))?;
    }
    Ok((columns, notes))
}

/// Codes of the four channels of a capture, and their scaling as JSON.
#[pyfunction]
pub(crate) fn read_capture<'py>(
    py: Python<'py>,
    path: PathBuf,
) -> PyResult<(Bound<'py, PyDict>, String)> {
    let capture = apart(py, || {
        read_capture_file(&path).map_err(|error| error.to_string())
    })?;
    let about = json(&capture.meta).map_err(|error| refused(&error))?;
    let columns = PyDict::new(py);
    for (index, codes) in capture.codes.into_iter().enumerate() {
        columns.set_item(format!("code_c{}", index + 1), codes.into_pyarray(py))?;
    }
    Ok((columns, about))
}

/// A record by its columns.
#[derive(FromPyObject)]
pub(crate) struct Columns<'py> {
    time_s: PyReadonlyArray1<'py, f64>,
    current_a: PyReadonlyArray1<'py, f64>,
    voltage_v: PyReadonlyArray1<'py, f64>,
}

impl Columns<'_> {
    /// The record as the analysis has it, discharge positive.
    pub(crate) fn series(&self, name: &str) -> PyResult<TimeSeries> {
        let series = TimeSeries {
            name: name.to_owned(),
            time_s: self.time_s.as_array().to_vec(),
            current_a: self.current_a.as_array().to_vec(),
            voltage_v: self.voltage_v.as_array().to_vec(),
            temperature_degc: None,
        };
        series.validate().map_err(|error| refused(&error))?;
        Ok(series)
    }
}

/// An OCV curve by its knots.
#[derive(FromPyObject)]
pub(crate) struct Curve<'py> {
    pub(crate) capacity_ah: f64,
    pub(crate) soc: PyReadonlyArray1<'py, f64>,
    pub(crate) ocv_v: PyReadonlyArray1<'py, f64>,
    pub(crate) slope_v: Option<PyReadonlyArray1<'py, f64>>,
}

impl Curve<'_> {
    /// Returns the curve; through its knots alone if no slopes are given.
    pub(crate) fn read(&self) -> PyResult<OcvCurve> {
        let list = |values: &PyReadonlyArray1<'_, f64>| values.as_array().to_vec();
        let (soc, ocv_v) = (list(&self.soc), list(&self.ocv_v));
        caught(|| {
            let curve = match &self.slope_v {
                None => OcvCurve::monotone(self.capacity_ah, soc, ocv_v),
                Some(slope_v) => {
                    let curve = OcvCurve {
                        capacity_ah: self.capacity_ah,
                        soc,
                        ocv_v,
                        slope_v: list(slope_v),
                    };
                    curve.validate().map(|()| curve)
                }
            };
            curve.map_err(|error| refused(&error))
        })
    }
}

/// Returns the open-circuit voltage of a slow discharge, and of a charge where there is one, as
/// JSON.
#[pyfunction]
pub(crate) fn ocv(
    py: Python<'_>,
    discharge: Columns<'_>,
    charge: Option<Columns<'_>>,
    dcir_ohm: f64,
    low_v: f64,
    high_v: f64,
    mean: bool,
) -> PyResult<String> {
    let discharge = discharge.series("discharge")?;
    let charge = charge.map(|charge| charge.series("charge")).transpose()?;
    let options = OcvOptions {
        dcir_ohm,
        limits_v: (low_v, high_v),
        mean,
        ..OcvOptions::default()
    };
    apart(py, || {
        let found = extract(&discharge, charge.as_ref(), &options);
        json(&found.map_err(|error| error.to_string())?)
    })
}
