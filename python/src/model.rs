//! Models: impedance, and simulation under a profile.

use std::path::PathBuf;

use analysis::formats::model::{CellModel, ModelFormat};
use analysis::forward::{
    Beyond, CellWindow, Demand, Interpolation, OcvSource, Profile, SimModel, SimOptions, simulate,
};
use analysis::given::GivenModel;
use analysis::model::{Erm, RcBranch};
use analysis::ocv::OcvCurve;
use analysis::pack::Pack;
use analysis::sop::{CurrentLimits, SopOptions, most_power};
use numpy::{Complex64, IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::{prelude::*, types::PyDict};

use crate::error::{apart, caught, json, refused};

/// A cell's model: a resistance and RC branches, with additions where a file holds some, and the
/// open-circuit voltage where it is known.
#[pyclass(frozen, module = "eisbench", from_py_object)]
#[derive(Clone)]
pub(crate) struct Model {
    given: GivenModel,
}

impl Model {
    /// Name, model and open-circuit voltage without additions.
    pub(crate) fn parts(&self) -> (String, Erm, Option<OcvCurve>) {
        let given = &self.given;
        (given.name.clone(), given.erm.clone(), given.ocv.clone())
    }

    fn source(&self, ocv_v: Option<f64>) -> PyResult<OcvSource> {
        match (ocv_v, &self.given.ocv) {
            (Some(ocv_v), _) => Ok(OcvSource::Constant(ocv_v)),
            (None, Some(curve)) => Ok(OcvSource::Curve(curve.clone())),
            (None, None) => Err(refused(
                &"expected ocv_v, or a model with an OCV curve (with_ocv), met neither",
            )),
        }
    }

    fn sim_model(&self, source: OcvSource, pack: Pack) -> Result<SimModel, String> {
        let augmented = self.given.augmented().map_err(|e| e.to_string())?;
        let model = match &augmented {
            Some(augmented) => SimModel::augmented(augmented, source, pack),
            None => SimModel::pack(&self.given.erm, source, pack),
        };
        model.map_err(|e| e.to_string())
    }
}

#[pymethods]
impl Model {
    /// From a resistance, Ω, and branches of Ω and F.
    #[new]
    #[pyo3(signature = (r_ohm, branches, name="cell"))]
    fn new(r_ohm: f64, branches: Vec<(f64, f64)>, name: &str) -> PyResult<Self> {
        let branches = branches.into_iter();
        let branches = branches
            .map(|(r_ohm, c_f)| RcBranch { r_ohm, c_f })
            .collect();
        let typed = || GivenModel::typed(name, Erm { r_ohm, branches }).map_err(|e| refused(&e));
        let given = caught(typed)?;
        Ok(Self { given })
    }

    /// From the file of a model, of a typed model or of a fitted circuit.
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        let place = path.display();
        let text = std::fs::read_to_string(&path)
            .map_err(|error| refused(&format!("{place}: expected a readable file: {error}")))?;
        let name = path.file_stem().map(|name| name.to_string_lossy());
        let given = caught(|| {
            GivenModel::from_json(&text, &name.unwrap_or_default(), None)
                .map_err(|error| refused(&format!("{place}: {error}")))
        })?;
        Ok(Self { given })
    }

    #[getter]
    fn name(&self) -> &str {
        &self.given.name
    }

    #[getter]
    fn r_ohm(&self) -> f64 {
        self.given.erm.r_ohm
    }

    /// Ω and F of each branch, by rising time constant.
    #[getter]
    fn branches(&self) -> Vec<(f64, f64)> {
        let branches = self.given.erm.branches.iter();
        branches.map(|branch| (branch.r_ohm, branch.c_f)).collect()
    }

    #[getter]
    fn dc_resistance_ohm(&self) -> f64 {
        self.given.erm.dc_resistance_ohm()
    }

    /// Names of the effects that were added to it.
    #[getter]
    fn additions(&self) -> Vec<String> {
        let additions = self.given.additions.iter();
        additions.map(|addition| addition.name.clone()).collect()
    }

    /// What is to be known of the model, in sentences: where it stops, how far a ladder follows its
    /// circuit.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.given.warnings.clone()
    }

    #[getter]
    fn has_ocv(&self) -> bool {
        self.given.ocv.is_some()
    }

    /// The same with an OCV curve through knots of state of charge, 0…1, and V.
    fn with_ocv(
        &self,
        capacity_ah: f64,
        soc: PyReadonlyArray1<'_, f64>,
        ocv_v: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Self> {
        let (soc, ocv_v) = (soc.as_array().to_vec(), ocv_v.as_array().to_vec());
        let curve = caught(|| {
            OcvCurve::monotone(capacity_ah, soc, ocv_v).map_err(|error| refused(&error))
        })?;
        Ok(Self {
            given: self.given.clone().with_ocv(Some(curve)),
        })
    }

    /// Text of the model for another program: `c`, `pybamm` or `casadi`.
    fn code(&self, to: &str, low_v: f64, high_v: f64, temperature_c: f64) -> PyResult<String> {
        let format = match to {
            "c" => ModelFormat::CHeader,
            "pybamm" => ModelFormat::PyBamm,
            "casadi" => ModelFormat::CasAdi,
            met => {
                return Err(refused(&format!(
                    "to: expected c, pybamm or casadi, met {met:?}"
                )));
            }
        };
        caught(|| {
            let model = CellModel::new(&self.given, low_v..=high_v, temperature_c);
            Ok(model.map_err(|error| refused(&error))?.text(format))
        })
    }

    /// The largest powers that can be held for a duration from rest, as JSON: discharge, charge.
    #[expect(
        clippy::too_many_arguments,
        reason = "they are keyword arguments of Python"
    )]
    fn sop(
        &self,
        py: Python<'_>,
        duration_s: f64,
        soc: f64,
        ocv_v: Option<f64>,
        series: u32,
        parallel: u32,
        interconnect_ohm: f64,
        low_v: f64,
        high_v: f64,
        discharge_a: f64,
        charge_a: f64,
    ) -> PyResult<String> {
        let pack = Pack::new(series, parallel, interconnect_ohm).map_err(|e| refused(&e))?;
        let source = self.source(ocv_v)?;
        let options = SopOptions {
            window: CellWindow { low_v, high_v },
            currents: CurrentLimits {
                discharge_a,
                charge_a,
            },
            ..SopOptions::default()
        };
        apart(py, || {
            let model = self.sim_model(source, pack)?;
            let start = model.rest(soc).map_err(|e| e.to_string())?;
            let limits = most_power(&model, &start, duration_s, &options);
            json(&limits.map_err(|e| e.to_string())?)
        })
    }

    /// Impedance for small signals without additions, Ω.
    fn impedance<'py>(
        &self,
        py: Python<'py>,
        freq_hz: PyReadonlyArray1<'py, f64>,
    ) -> Bound<'py, PyArray1<Complex64>> {
        let freq_hz = freq_hz.as_array();
        let z_ohm: Vec<Complex64> = freq_hz
            .iter()
            .map(|freq_hz| self.given.erm.impedance(*freq_hz))
            .collect();
        z_ohm.into_pyarray(py)
    }

    /// Columns of the trace and the summary as JSON.
    #[pyo3(signature = (demand, time_s, value, soc, ocv_v, linear, series, parallel,
        interconnect_ohm, beyond, fraction, low_v, high_v, max_step_s))]
    #[expect(
        clippy::too_many_arguments,
        reason = "they are keyword arguments of Python"
    )]
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        demand: &str,
        time_s: PyReadonlyArray1<'py, f64>,
        value: PyReadonlyArray1<'py, f64>,
        soc: Option<f64>,
        ocv_v: Option<f64>,
        linear: bool,
        series: u32,
        parallel: u32,
        interconnect_ohm: f64,
        beyond: &str,
        fraction: f64,
        low_v: f64,
        high_v: f64,
        max_step_s: f64,
    ) -> PyResult<(Bound<'py, PyDict>, String)> {
        let demand = match demand {
            "power" => Demand::Power,
            "current" => Demand::Current,
            "resistance" => Demand::Resistance,
            met => {
                let expected = "expected power, current or resistance";
                return Err(refused(&format!("demand: {expected}, met {met:?}")));
            }
        };
        let beyond = match beyond {
            "stop" => Beyond::Stop,
            "clamp" => Beyond::Clamp,
            "extrapolate" => Beyond::Extrapolate { fraction },
            met => {
                let expected = "expected stop, clamp or extrapolate";
                return Err(refused(&format!("beyond: {expected}, met {met:?}")));
            }
        };
        let (time_s, value) = (time_s.as_array(), value.as_array());
        if time_s.len() != value.len() {
            return Err(refused(&format!(
                "profile: expected a value for each of {} times, met {}",
                time_s.len(),
                value.len()
            )));
        }
        let rows: Vec<(f64, f64)> = time_s.iter().copied().zip(value.iter().copied()).collect();
        let interpolation = if linear {
            Interpolation::Linear
        } else {
            Interpolation::Hold
        };
        let profile =
            Profile::new("profile", demand, interpolation, &rows).map_err(|e| refused(&e))?;
        let pack = Pack::new(series, parallel, interconnect_ohm).map_err(|e| refused(&e))?;
        if ocv_v.is_none() && self.given.ocv.is_some() && soc.is_none() {
            return Err(refused(
                &"simulate: expected soc, the state of charge at the start, met none",
            ));
        }
        let source = self.source(ocv_v)?;
        let options = SimOptions {
            beyond,
            max_step_s,
            window: CellWindow { low_v, high_v },
            ..SimOptions::default()
        };
        let done = apart(py, || {
            let text = |error: &dyn std::fmt::Display| error.to_string();
            let model = self.sim_model(source, pack)?;
            let start = model.rest(soc.unwrap_or(0.5)).map_err(|e| text(&e))?;
            simulate(&model, &start, &profile, &options).map_err(|e| text(&e))
        })?;
        let (trace, columns) = (done.trace, PyDict::new(py));
        let branches = trace.v_rc_v.into_iter().enumerate();
        let branches = branches.map(|(k, v_v)| (format!("v_rc{}_v", k + 1), v_v));
        let all = [
            ("time_s", trace.time_s),
            ("demand_w", trace.demand_w),
            ("power_w", trace.power_w),
            ("current_a", trace.current_a),
            ("ccv_v", trace.ccv_v),
            ("cell_v", trace.cell_v),
            ("ocv_v", trace.ocv_v),
            ("soc", trace.soc),
        ]
        .map(|(name, column)| (name.to_owned(), column));
        for (name, column) in all.into_iter().chain(branches) {
            columns.set_item(name, column.into_pyarray(py))?;
        }
        let summary = json(&done.summary).map_err(|e| refused(&e))?;
        Ok((columns, summary))
    }
}
