//! Maps over state of charge, temperature and current.

use analysis::given::PlainModel;
use analysis::map::{MapData, MapLog, MapOptions, MapPoint, MapSpectrum, fit_map as fit};
use analysis::series::Role;
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;

use crate::error::{apart, json};
use crate::model::Model;
use crate::series::{Columns, Curve};
use crate::spectrum::Spectrum;

/// Temperature whose node gives the model for tasks that know one point only, °C.
const AMBIENT_DEGC: f64 = 25.0;

/// A record and its circumstances.
#[derive(FromPyObject)]
pub(crate) struct MapRecord<'py> {
    name: String,
    held_out: bool,
    columns: Columns<'py>,
    temperature_c: Option<PyReadonlyArray1<'py, f64>>,
    net_ah: Option<PyReadonlyArray1<'py, f64>>,
    at_c: Option<f64>,
    soc_start: Option<f64>,
}

/// A spectrum and the state of its cell.
#[derive(FromPyObject)]
pub(crate) struct MapSweep {
    spectrum: Spectrum,
    held_out: bool,
    soc: f64,
    temperature_c: f64,
}

/// Form of the map.
#[derive(FromPyObject)]
pub(crate) struct MapWishes {
    name: String,
    time_constants_s: Option<Vec<f64>>,
    ocv_temperature_c: f64,
}

/// Fits a map: its fit as JSON, and its model.
#[pyfunction]
pub(crate) fn fit_map(
    py: Python<'_>,
    records: Vec<MapRecord<'_>>,
    sweeps: Vec<MapSweep>,
    curve: Curve<'_>,
    wishes: MapWishes,
) -> PyResult<(String, Model)> {
    let data = MapData {
        logs: records.iter().map(log).collect::<PyResult<_>>()?,
        spectra: sweeps.iter().map(spectrum).collect(),
    };
    let curve = curve.read()?;
    let standard = MapOptions::default();
    let options = MapOptions {
        time_constants_s: wishes
            .time_constants_s
            .unwrap_or_else(|| standard.time_constants_s.clone()),
        ocv_temperature_degc: wishes.ocv_temperature_c,
        ..standard
    };
    apart(py, || {
        let fit = fit(&data, &curve, &options).map_err(|error| error.to_string())?;
        let model = PlainModel {
            warnings: fit.notes.clone(),
            ..PlainModel::of_map(&wishes.name, &fit.map, &curve, AMBIENT_DEGC)
        };
        Ok((json(&fit)?, Model::of_map(model.into())))
    })
}

fn role(held_out: bool) -> Role {
    if held_out { Role::HeldOut } else { Role::Train }
}

fn log(record: &MapRecord<'_>) -> PyResult<MapLog> {
    let list = |values: &PyReadonlyArray1<'_, f64>| values.as_array().to_vec();
    let mut series = record.columns.series(&record.name)?;
    series.temperature_degc = record.temperature_c.as_ref().map(list);
    Ok(MapLog {
        series,
        soc_start: record.soc_start,
        net_ah: record.net_ah.as_ref().map(list),
        temperature_degc: record.at_c,
        role: role(record.held_out),
    })
}

fn spectrum(sweep: &MapSweep) -> MapSpectrum {
    let spectrum = &sweep.spectrum.sourced.spectrum;
    let points = spectrum.points.iter().map(|point| MapPoint {
        freq_hz: point.freq_hz,
        z_ohm: point.z_ohm,
        sigma_ohm: Some(point.covariance.re_re.max(point.covariance.im_im).sqrt())
            .filter(|sigma_ohm| sigma_ohm.is_finite()),
    });
    MapSpectrum {
        name: spectrum.name.clone(),
        role: role(sweep.held_out),
        soc: sweep.soc,
        temperature_degc: sweep.temperature_c,
        points: points.collect(),
    }
}
