//! Data sets and their diagnosis.

use std::sync::{Mutex, PoisonError};

use analysis::augmented::Between;
use analysis::contract::CommonModeImpedance;
use analysis::diagnosis::{
    DataSet as Runs, DiagnosisOptions, Fixture, Role, Run, RunData, Start, Sweep, SweepPoint,
    TimeRecord, diagnose as judge, report,
};
use pyo3::prelude::*;

use crate::error::{apart, json, refused};
use crate::model::Model;
use crate::series::Columns;
use crate::spectrum::Spectrum;

/// Information about a run beside its data.
#[derive(FromPyObject)]
pub(crate) struct About {
    name: String,
    held_out: bool,
    repeat_group: String,
    start_s: f64,
    #[pyo3(attribute("temperature_c"))]
    temperature_degc: f64,
    soc: Option<f64>,
    ocv_v: Option<f64>,
}

/// Runs of one cell.
#[pyclass(frozen, module = "eisbench")]
pub(crate) struct DataSet {
    runs: Mutex<Runs>,
}

#[pymethods]
impl DataSet {
    #[new]
    fn new(name: &str) -> Self {
        let runs = Runs {
            name: name.to_owned(),
            runs: Vec::new(),
            history: None,
            calibration: None,
        };
        Self {
            runs: Mutex::new(runs),
        }
    }

    /// Adds a record that begins at rest.
    fn add_series(
        &self,
        about: About,
        columns: Columns<'_>,
        linear: bool,
        compared_from_s: f64,
    ) -> PyResult<()> {
        let series = columns.series(&about.name)?;
        let between = if linear {
            Between::Linear
        } else {
            Between::Hold
        };
        let record = TimeRecord {
            series,
            between,
            compared_from_s,
            level_sigma_v: 0.0,
            sigma_v: None,
            averaged_s: None,
            current_errors_a: Vec::new(),
        };
        self.add(about, RunData::Time(record))
    }

    /// Adds a spectrum.
    fn add_spectrum(&self, about: About, spectrum: Spectrum) -> PyResult<()> {
        let sourced = spectrum.sourced;
        let points = sourced.spectrum.points.iter().map(|point| SweepPoint {
            freq_hz: point.freq_hz,
            z_ohm: point.z_ohm,
            sigma_ohm: point.covariance.is_valid().then(|| {
                let of = |variance: f64| variance.sqrt();
                (of(point.covariance.re_re), of(point.covariance.im_im))
            }),
            amplitude_a: Some(point.amplitude_a).filter(|amplitude| amplitude.is_finite()),
        });
        let sweep = Sweep {
            // The data set counts discharge positive, files of spectra charge.
            bias_a: -sourced.origin.bias_a.unwrap_or(0.0),
            common_mode: CommonModeImpedance::default(),
            elapsed_s: Vec::new(),
            charge_coulomb: Vec::new(),
            harmonics: Vec::new(),
            points: points.collect(),
        };
        self.add(about, RunData::Eis(sweep))
    }

    fn __len__(&self) -> usize {
        self.locked().runs.len()
    }

    /// Returns the diagnosis as JSON, and as text.
    fn diagnose(&self, py: Python<'_>, model: &Model) -> PyResult<(String, String)> {
        let runs = self.locked().clone();
        let (base, notes) = model.base(&runs).map_err(|error| refused(&error))?;
        apart(py, || {
            let outcome = judge(&runs, Vec::new(), &base, &DiagnosisOptions::default());
            let mut diagnosis = outcome.map_err(|error| error.to_string())?.diagnosis;
            diagnosis.notes.extend(notes.clone());
            Ok((json(&diagnosis)?, report::text(&diagnosis)))
        })
    }
}

impl DataSet {
    fn locked(&self) -> std::sync::MutexGuard<'_, Runs> {
        self.runs.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add(&self, about: About, data: RunData) -> PyResult<()> {
        let start = match (about.soc, about.ocv_v) {
            (Some(soc), None) => Start::Soc(soc),
            (None, Some(ocv_v)) => Start::Ocv(ocv_v),
            _ => {
                return Err(refused(&format!(
                    "run {:?}: expected soc or ocv_v, the state at its start, met {}",
                    about.name,
                    if about.soc.is_some() {
                        "both"
                    } else {
                        "neither"
                    }
                )));
            }
        };
        let mut runs = self.locked();
        if runs.runs.iter().any(|run| run.name == about.name) {
            return Err(refused(&format!(
                "run {:?}: expected a name of its own, met it twice",
                about.name
            )));
        }
        let order = runs.runs.len() as u32;
        runs.runs.push(Run {
            name: about.name,
            fixture: Fixture::Cell("cell".to_owned()),
            role: if about.held_out {
                Role::HeldOut
            } else {
                Role::Train
            },
            repeat_group: about.repeat_group,
            order,
            start_s: about.start_s,
            temperature_degc: about.temperature_degc,
            start,
            data,
        });
        Ok(())
    }
}
