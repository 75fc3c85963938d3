//! Spectra.

use std::path::PathBuf;

use analysis::formats;
use analysis::numeric::Covariance2;
use analysis::spectrum::{ImpedancePoint, Origin, SourcedSpectrum, Spectrum as Points};
use numpy::{Complex64, IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray1};
use pyo3::prelude::*;

use crate::error::{apart, caught, of_file, refused};

/// Impedance over frequency of one fixture in one run; points by rising frequency.
#[pyclass(frozen, module = "eisbench", from_py_object)]
#[derive(Clone)]
pub(crate) struct Spectrum {
    pub(crate) sourced: SourcedSpectrum,
}

impl Spectrum {
    fn points(&self) -> &[ImpedancePoint] {
        &self.sourced.spectrum.points
    }

    /// Creates a spectrum of points in any order.
    pub(crate) fn of(name: &str, points: Vec<ImpedancePoint>) -> Result<Self, String> {
        let mut spectrum = Points {
            name: name.to_owned(),
            points,
            ..Points::default()
        };
        spectrum.sort();
        spectrum.validate().map_err(|error| error.to_string())?;
        Ok(Self {
            sourced: SourcedSpectrum {
                origin: Origin::default(),
                spectrum,
                flagged: Vec::new(),
            },
        })
    }

    /// Returns a spectrum of columns of one length.
    fn of_columns(
        name: &str,
        freq_hz: &[f64],
        z_ohm: &[Complex64],
        sigma_ohm: Option<&[f64]>,
    ) -> Result<Self, String> {
        let counts = [Some(z_ohm.len()), sigma_ohm.map(<[f64]>::len)];
        if counts.iter().flatten().any(|count| *count != freq_hz.len()) {
            return Err(format!(
                "spectrum {name:?}: expected an impedance and, if any, a sigma for each of {} \
                frequencies, met {} and {}",
                freq_hz.len(),
                z_ohm.len(),
                sigma_ohm.map_or_else(
                    || "none".to_owned(),
                    |sigma_ohm| sigma_ohm.len().to_string()
                )
            ));
        }
        let points = freq_hz.iter().zip(z_ohm).enumerate();
        let points = points.map(|(k, (freq_hz, z_ohm))| ImpedancePoint {
            freq_hz: *freq_hz,
            z_ohm: *z_ohm,
            covariance: sigma_ohm
                .and_then(|sigma_ohm| sigma_ohm.get(k))
                .map_or(Covariance2::UNKNOWN, |sigma_ohm| {
                    Covariance2::circular(sigma_ohm.powi(2))
                }),
            amplitude_a: f64::NAN,
        });
        Self::of(name, points.collect())
    }

    fn column<'py, T: numpy::Element>(
        &self,
        py: Python<'py>,
        value: impl Fn(&ImpedancePoint) -> T,
    ) -> Bound<'py, PyArray1<T>> {
        let values: Vec<T> = self.points().iter().map(value).collect();
        values.into_pyarray(py)
    }
}

#[pymethods]
impl Spectrum {
    #[new]
    #[pyo3(signature = (name, freq_hz, z_ohm, sigma_ohm=None))]
    fn new(
        name: &str,
        freq_hz: PyReadonlyArray1<'_, f64>,
        z_ohm: PyReadonlyArray1<'_, Complex64>,
        sigma_ohm: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let (freq_hz, z_ohm) = (freq_hz.as_array().to_vec(), z_ohm.as_array().to_vec());
        let sigma_ohm = sigma_ohm.map(|sigma_ohm| sigma_ohm.as_array().to_vec());
        let made = caught(|| {
            Ok(Self::of_columns(
                name,
                &freq_hz,
                &z_ohm,
                sigma_ohm.as_deref(),
            ))
        })?;
        made.map_err(|reason| refused(&reason))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.sourced.spectrum.name
    }

    #[getter]
    fn fixture(&self) -> Option<&str> {
        self.sourced.origin.fixture.as_deref()
    }

    #[getter]
    fn cell(&self) -> Option<&str> {
        self.sourced.cell()
    }

    #[getter]
    fn repeat(&self) -> Option<&str> {
        self.sourced.origin.repeat.as_deref()
    }

    #[getter]
    fn bias_a(&self) -> Option<f64> {
        self.sourced.origin.bias_a
    }

    #[getter]
    fn is_unbiased_cell(&self) -> bool {
        self.sourced.origin.is_unbiased_cell()
    }

    /// Frequencies that the quality gate of the measurement has refused, Hz.
    #[getter]
    fn flagged_hz(&self) -> Vec<f64> {
        self.sourced.flagged.iter().map(|p| p.freq_hz).collect()
    }

    #[getter]
    fn freq_hz<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.column(py, |p| p.freq_hz)
    }

    #[getter]
    fn z_ohm<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<Complex64>> {
        self.column(py, |p| p.z_ohm)
    }

    #[getter]
    fn amplitude_a<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.column(py, |p| p.amplitude_a)
    }

    /// Returns the variance of Re, covariance, variance of Im, Ω²; one row for each point.
    #[getter]
    fn covariance_ohm2<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let flat: Vec<f64> = self
            .points()
            .iter()
            .flat_map(|p| [p.covariance.re_re, p.covariance.re_im, p.covariance.im_im])
            .collect();
        flat.into_pyarray(py).reshape([self.points().len(), 3])
    }

    fn __len__(&self) -> usize {
        self.points().len()
    }

    /// The points of a band, both ends included, Hz.
    fn between(&self, from_hz: f64, to_hz: f64) -> PyResult<Self> {
        let mut sourced = self.sourced.clone();
        sourced
            .spectrum
            .keep(|p| (from_hz..=to_hz).contains(&p.freq_hz));
        sourced
            .flagged
            .retain(|p| (from_hz..=to_hz).contains(&p.freq_hz));
        if sourced.spectrum.points.is_empty() {
            return Err(refused(&format!(
                "spectrum {:?}: expected points from {from_hz} to {to_hz} Hz, met none",
                self.name()
            )));
        }
        Ok(Self { sourced })
    }

    /// Returns the spectrum without the points that the quality gate of the measurement has
    /// refused.
    fn without_flagged(&self) -> Self {
        let mut sourced = self.sourced.clone();
        sourced.leave_out_flagged();
        Self { sourced }
    }
}

/// All spectra of a file, and remarks on how it was read.
#[pyfunction]
pub(crate) fn read_spectra(
    py: Python<'_>,
    path: PathBuf,
) -> PyResult<(Vec<Spectrum>, Vec<String>)> {
    let read = apart(py, || Ok(formats::read_file(&path)))?;
    let file = read.map_err(|e| of_file(py, &e))?;
    let spectra = file.spectra.into_iter().map(|sourced| Spectrum { sourced });
    Ok((spectra.collect(), file.notes))
}
