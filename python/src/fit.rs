//! Fits of models and circuits, tests of validity, relaxation times.

use analysis::drt as times;
use analysis::fit::{
    CellSweeps, ChargeStorage, CircuitOptions, ErmAnswer, ErmRequest, FitEntry, Objective,
    OrderSelection, Search, Slope, Weight, fit_circuit_cells,
};
use analysis::model::{Circuit, WrittenCircuit};
use analysis::spectrum::{SourcedSpectrum, Spectrum as Points};
use analysis::validity::{self, Noise};
use numpy::{Complex64, IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::error::{apart, caught, json, refused};
use crate::spectrum::Spectrum;

/// Number of groups that are processed before the interpreter is checked for an interrupt.
pub(crate) const CHUNK: usize = 64;

/// Fit of one group, with the choice of its order if there was one.
#[derive(serde::Serialize)]
struct Fitted {
    #[serde(flatten)]
    entry: FitEntry,
    /// Covariance of the logarithms of the parameters.
    log_covariance: Option<Vec<Vec<f64>>>,
    charge_storage: Option<ChargeStorage>,
    order: Option<OrderSelection>,
}

fn groups(spectra: Vec<Spectrum>, pool: bool) -> Vec<Vec<SourcedSpectrum>> {
    let sourced = spectra.into_iter().map(|spectrum| spectrum.sourced);
    if pool {
        vec![sourced.collect()]
    } else {
        sourced.map(|sourced| vec![sourced]).collect()
    }
}

/// JSON text of a result, or the reason for its absence.
type Each = (Option<String>, Option<String>);

/// Works on groups in parallel; Ctrl-C ends it between two chunks.
fn each(
    py: Python<'_>,
    groups: &[Vec<SourcedSpectrum>],
    work: impl Fn(&[SourcedSpectrum]) -> Result<String, String> + Sync + Send,
) -> PyResult<Vec<Each>> {
    let of = |group: &Vec<SourcedSpectrum>| match work(group) {
        Ok(text) => (Some(text), None),
        Err(reason) => (None, Some(reason)),
    };
    // Other threads cost more than a fit of one spectrum.
    if let [one] = groups {
        return Ok(vec![apart(py, || Ok(of(one)))?]);
    }
    let mut done = Vec::with_capacity(groups.len());
    for chunk in groups.chunks(CHUNK) {
        py.check_signals()?;
        done.extend(apart(py, || {
            Ok(chunk.par_iter().map(of).collect::<Vec<Each>>())
        })?);
    }
    Ok(done)
}

fn named(group: &[SourcedSpectrum], error: &dyn std::fmt::Display) -> String {
    let name = group
        .first()
        .map_or("", |first| first.spectrum.name.as_str());
    format!("{name}: {error}")
}

#[pyfunction]
#[pyo3(signature = (spectra, rc, objective, ocv_slope, seed, starts, pool))]
#[expect(
    clippy::too_many_arguments,
    reason = "they are keyword arguments of Python"
)]
pub(crate) fn fit_erm(
    py: Python<'_>,
    spectra: Vec<Spectrum>,
    rc: Option<usize>,
    objective: &str,
    ocv_slope: Option<&str>,
    seed: u64,
    starts: usize,
    pool: bool,
) -> PyResult<Vec<Each>> {
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
    each(py, &groups(spectra, pool), |group| {
        let ErmAnswer { fit, order } = request.fit(group).map_err(|e| named(group, &e))?;
        let names = group.iter().map(|s| s.spectrum.name.clone()).collect();
        json(&Fitted {
            entry: FitEntry::new(&fit, names),
            log_covariance: fit.log_covariance,
            charge_storage: fit.charge_storage,
            order,
        })
    })
}

/// A circuit and wishes for its fit, as Python gives them.
#[derive(FromPyObject)]
pub(crate) struct CircuitWishes {
    circuit: String,
    objective: String,
    weight: Option<String>,
    guess: Vec<(String, f64)>,
    constants: Vec<(String, f64)>,
    starts: Option<usize>,
    search: String,
    seed: u64,
}

impl CircuitWishes {
    /// Returns the circuit and the options of its fit.
    pub(crate) fn read(&self) -> PyResult<(Circuit, CircuitOptions)> {
        let written = caught(|| WrittenCircuit::read(&self.circuit).map_err(|e| refused(&e)))?;
        let circuit = written.circuit.clone();
        let names = circuit.parameter_names().to_vec();
        let indices = |of: &str, values: &[(String, f64)]| {
            let place = |(name, value): &(String, f64)| {
                let index = names.iter().position(|n| n == name);
                let met = || format!("{of}: expected one of {}, met {name:?}", names.join(", "));
                Ok((index.ok_or_else(|| refused(&met()))?, *value))
            };
            values.iter().map(place).collect::<PyResult<Vec<_>>>()
        };
        let weight = self.weight.as_deref().map(str::parse::<Weight>).transpose();
        let options = CircuitOptions {
            objective: self.objective.parse().map_err(|e| refused(&e))?,
            weight: weight.map_err(|e| refused(&e))?,
            guess: indices("guess", &self.guess)?,
            constants: indices("constants", &self.constants)?,
            starts: self.starts,
            search: self.search.parse::<Search>().map_err(|e| refused(&e))?,
            seed: self.seed,
        };
        Ok((circuit, options.with_written(&written)))
    }
}

#[pyfunction]
pub(crate) fn fit_circuit(
    py: Python<'_>,
    spectra: Vec<Spectrum>,
    wishes: CircuitWishes,
    pool: bool,
) -> PyResult<Vec<Each>> {
    let (circuit, options) = wishes.read()?;
    each(py, &groups(spectra, pool), |group| {
        let fit = fit_circuit_cells(&CellSweeps::sort(group), &circuit, &options)
            .map_err(|e| named(group, &e))?;
        json(&fit)
    })
}

/// Returns the impedance of a circuit with these values, in the order of its parameters.
#[pyfunction]
pub(crate) fn circuit_impedance<'py>(
    py: Python<'py>,
    circuit: &str,
    values: Vec<f64>,
    freq_hz: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<Complex64>>> {
    let circuit: Circuit = caught(|| circuit.parse().map_err(|e| refused(&e)))?;
    let expected = circuit.parameter_names().len();
    if values.len() != expected {
        return Err(refused(&format!(
            "expected {expected} values, met {}",
            values.len()
        )));
    }
    let freq_hz: Vec<f64> = freq_hz.as_array().to_vec();
    let z_ohm = apart(py, || {
        Ok(freq_hz
            .iter()
            .map(|freq_hz| circuit.impedance(&values, *freq_hz))
            .collect::<Vec<Complex64>>())
    })?;
    Ok(z_ohm.into_pyarray(py))
}

/// Kramers–Kronig test, Z-HIT and verdicts of the spectra of one cell, in order of time.
#[pyfunction]
pub(crate) fn assess(py: Python<'_>, spectra: Vec<Spectrum>) -> PyResult<String> {
    let spectra: Vec<Points> = spectra.into_iter().map(|s| s.sourced.spectrum).collect();
    apart(py, || {
        let assessment = validity::assess(&spectra, &[]).map_err(|e| e.to_string())?;
        json(&assessment)
    })
}

/// Distribution of relaxation times of each spectrum.
#[pyfunction]
pub(crate) fn drt(py: Python<'_>, spectra: Vec<Spectrum>) -> PyResult<Vec<Each>> {
    each(py, &groups(spectra, false), |group| {
        let given = &group[0].spectrum;
        // As `kk --drt`: uses no more points than are judged.
        let spectrum = &validity::thinned(given).unwrap_or_else(|| given.clone());
        let noise = Noise::of(spectrum, std::slice::from_ref(spectrum));
        let noise = noise.map_err(|e| named(group, &e))?.with_shared(spectrum);
        let found = times::drt(spectrum, &noise).map_err(|e| named(group, &e))?;
        json(&found)
    })
}
