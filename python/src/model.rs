//! Models: impedance, and simulation under a profile.

use std::path::{Path, PathBuf};

use analysis::diagnosis::{BaseModel, DataSet};
use analysis::formats::model::{CellModel, ModelFormat};
use analysis::forward::{
    CellWindow, OcvSource, Profile, SensitivityRow, SimModel, SimOptions, sensitivity, simulate,
};
use analysis::given::GivenModel;
use analysis::model::{Erm, RcBranch};
use analysis::ocv::OcvCurve;
use analysis::pack::Pack;
use analysis::sop::{CurrentLimits, SopOptions, most_power};
use numpy::{Complex64, IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::{prelude::*, types::PyDict};

use crate::error::{apart, caught, json, refused};
use crate::play::Play;
use crate::series::Curve;

/// A cell's model: a resistance and RC branches, with additions where a file holds some, and the
/// open-circuit voltage where it is known.
#[pyclass(frozen, module = "eisbench", from_py_object)]
#[derive(Clone)]
pub(crate) struct Model {
    given: GivenModel,
}

impl Model {
    /// Returns the base that a diagnosis of runs judges, without additions, and remarks on it: for a map
    /// its model at the state of the runs.
    pub(crate) fn base(&self, runs: &DataSet) -> Result<(BaseModel, Vec<String>), String> {
        let given = &self.given;
        let curve = given.ocv.as_ref();
        let curve =
            curve.ok_or("diagnose: expected a model with an OCV curve (with_ocv), met none")?;
        let mut base = BaseModel {
            name: given.name.clone(),
            erm: given.erm.clone(),
            ocv: curve.clone(),
        };
        if given.map.is_none() {
            return Ok((base, Vec::new()));
        }
        let state = runs.mean_state(curve);
        let state =
            state.ok_or("diagnose: expected runs with a state on the OCV curve, met none")?;
        let Some((model, notes)) = given.at_state(&state) else {
            return Ok((base, Vec::new()));
        };
        base.erm = model.erm;
        base.ocv = model.ocv.unwrap_or(base.ocv);
        Ok((base, notes))
    }

    /// Creates a model with a map.
    pub(crate) fn of_map(given: GivenModel) -> Self {
        Self { given }
    }

    /// Creates a model with an OCV curve.
    pub(crate) fn of(name: &str, erm: Erm, curve: OcvCurve) -> Result<Self, String> {
        let given = GivenModel::typed(name, erm).map_err(|error| error.to_string())?;
        Ok(Self {
            given: given.with_ocv(Some(curve)),
        })
    }

    fn played(&self, play: &Play<'_>) -> PyResult<Played> {
        let soc = play.soc;
        if play.ocv_v.is_none() && self.given.ocv.is_some() && soc.is_none() {
            return Err(refused(
                &"simulate: expected soc, the state of charge at the start, met none",
            ));
        }
        let (profile, pack, options) = play.read()?;
        Ok(Played {
            source: self.source(play.ocv_v)?,
            ambient_degc: play.ambient_c,
            soc: soc.unwrap_or(0.5),
            profile,
            pack,
            options,
        })
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

    fn sim_model(
        &self,
        source: OcvSource,
        pack: Pack,
        ambient_degc: f64,
    ) -> Result<SimModel, String> {
        if let Some(map) = &self.given.map {
            let OcvSource::Curve(curve) = source else {
                let expected =
                    "expected a state of charge for a model with a map, met a constant OCV";
                return Err(expected.to_owned());
            };
            return SimModel::mapped(map.clone(), curve, pack, ambient_degc)
                .map_err(|error| error.to_string());
        }
        let augmented = self.given.augmented().map_err(|e| e.to_string())?;
        let model = match &augmented {
            Some(augmented) => SimModel::augmented(augmented, source, pack),
            None => SimModel::pack(&self.given.erm, source, pack),
        };
        model.map_err(|e| e.to_string())
    }
}

/// Load, pack and options of a simulation.
struct Played {
    source: OcvSource,
    /// Temperature of the surroundings of a model with a map, °C.
    ambient_degc: f64,
    soc: f64,
    profile: Profile,
    pack: Pack,
    options: SimOptions,
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

    /// Returns the text of a file that the program and `read` take.
    fn to_json(&self) -> PyResult<String> {
        caught(|| self.given.to_json().map_err(|error| refused(&error)))
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

    /// Returns the names of the effects that were added to it.
    #[getter]
    fn additions(&self) -> Vec<String> {
        let additions = self.given.additions.iter();
        additions.map(|addition| addition.name.clone()).collect()
    }

    /// Returns notes on the model, in sentences: its limits, and how closely a ladder follows its
    /// circuit.
    #[getter]
    fn notes(&self) -> Vec<String> {
        let mut notes = self.given.warnings.clone();
        notes.extend(self.given.point_note());
        notes
    }

    #[getter]
    fn has_ocv(&self) -> bool {
        self.given.ocv.is_some()
    }

    /// Returns the same with an OCV curve through knots of state of charge, 0…1, and V; slopes, V,
    /// where they are known, else those of the monotone curve.
    #[pyo3(signature = (capacity_ah, soc, ocv_v, slope_v=None))]
    fn with_ocv(
        &self,
        capacity_ah: f64,
        soc: PyReadonlyArray1<'_, f64>,
        ocv_v: PyReadonlyArray1<'_, f64>,
        slope_v: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let curve = Curve {
            capacity_ah,
            soc,
            ocv_v,
            slope_v,
        };
        Ok(Self {
            given: self.given.clone().with_ocv(Some(curve.read()?)),
        })
    }

    /// Returns the text of the model for another program: `c`, `pybamm`, `casadi`, `simscape` or
    /// `modelica`.
    fn code(&self, to: &str, low_v: f64, high_v: f64, temperature_degc: f64) -> PyResult<String> {
        let format = match to {
            "c" => ModelFormat::CHeader,
            "pybamm" => ModelFormat::PyBamm,
            "casadi" => ModelFormat::CasAdi,
            "simscape" => ModelFormat::Simscape,
            "modelica" => ModelFormat::Modelica,
            met => {
                return Err(refused(&format!(
                    "to: expected c, pybamm, casadi, simscape or modelica, met {met:?}"
                )));
            }
        };
        caught(|| {
            let model = CellModel::new(&self.given, low_v..=high_v, temperature_degc);
            let text = model.map_err(|error| refused(&error))?.text(format);
            text.map_err(|error| refused(&error))
        })
    }

    /// Writes an FMU with a library, if the machine has a compiler; otherwise returns why it holds
    /// sources only.
    fn write_fmu(
        &self,
        path: PathBuf,
        low_v: f64,
        high_v: f64,
        temperature_degc: f64,
    ) -> PyResult<Option<String>> {
        caught(|| {
            let model = CellModel::new(&self.given, low_v..=high_v, temperature_degc);
            let fmu = model
                .and_then(|model| model.fmu())
                .map_err(|error| refused(&error))?;
            let folder = path.parent().unwrap_or(Path::new(""));
            let library = fmu.library(folder);
            let archive = fmu
                .archive(library.as_deref().ok())
                .map_err(|error| refused(&error))?;
            std::fs::write(&path, archive)
                .map_err(|error| refused(&format!("{}: {error}", path.display())))?;
            Ok(library.err())
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
        ambient_c: f64,
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
            let model = self.sim_model(source, pack, ambient_c)?;
            let start = model.rest(soc).map_err(|e| e.to_string())?;
            let limits = most_power(&model, &start, duration_s, &options);
            json(&limits.map_err(|e| e.to_string())?)
        })
    }

    /// Returns the impedance for small signals without additions, Ω.
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
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        play: Play<'py>,
    ) -> PyResult<(Bound<'py, PyDict>, String)> {
        let played = self.played(&play)?;
        let done = apart(py, || {
            let text = |error: &dyn std::fmt::Display| error.to_string();
            let model = self.sim_model(played.source, played.pack, played.ambient_degc)?;
            let start = model.rest(played.soc).map_err(|e| text(&e))?;
            simulate(&model, &start, &played.profile, &played.options).map_err(|e| text(&e))
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
        let of_map = [
            ("temperature_c", trace.temperature_degc),
            ("cell_sigma_v", trace.cell_sigma_v),
        ];
        let of_map = of_map.into_iter().filter(|(_, column)| !column.is_empty());
        let of_map = of_map.map(|(name, column)| (name.to_owned(), column));
        for (name, column) in all.into_iter().chain(of_map).chain(branches) {
            columns.set_item(name, column.into_pyarray(py))?;
        }
        let summary = json(&done.summary).map_err(|e| refused(&e))?;
        Ok((columns, summary))
    }

    /// Returns the time, voltage, and derivatives of the voltage: by a common factor of the demand,
    /// by R, R1, C1, … and an offset of the open-circuit voltage, by the state of charge at the
    /// start.
    fn sensitivities<'py>(&self, py: Python<'py>, play: Play<'py>) -> PyResult<Bound<'py, PyDict>> {
        let played = self.played(&play)?;
        let rows = apart(py, || {
            let text = |error: &dyn std::fmt::Display| error.to_string();
            let model = self.sim_model(played.source, played.pack, played.ambient_degc)?;
            let start = model.rest(played.soc).map_err(|e| text(&e))?;
            let SimOptions {
                beyond, max_step_s, ..
            } = played.options;
            let found = sensitivity(&model, &start, &played.profile, beyond, max_step_s);
            Ok(found.map_err(|e| text(&e))?.rows)
        })?;
        let branches = 1..=self.given.erm.branches.len();
        let names = std::iter::once("R".to_owned())
            .chain(branches.flat_map(|k| [format!("R{k}"), format!("C{k}")]))
            .chain(["ocv_v".to_owned()]);
        let columns = PyDict::new(py);
        let column = |of: &dyn Fn(&SensitivityRow) -> f64| {
            rows.iter().map(of).collect::<Vec<f64>>().into_pyarray(py)
        };
        columns.set_item("time_s", column(&|row| row.time_s))?;
        columns.set_item("ccv_v", column(&|row| row.ccv_v))?;
        columns.set_item("demand", column(&|row| row.by_scale_v))?;
        for (k, name) in names.enumerate() {
            let by = |row: &SensitivityRow| row.by_parameter.get(k).copied().unwrap_or(f64::NAN);
            columns.set_item(name, column(&by))?;
        }
        let by_soc = |row: &SensitivityRow| row.by_state.first().copied().unwrap_or(f64::NAN);
        columns.set_item("soc", column(&by_soc))?;
        Ok(columns)
    }
}
