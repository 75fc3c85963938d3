//! Parameters of any equivalent circuit from impedance spectra, without start values.
//!
//! Local fits (bounded Levenberg–Marquardt in the logarithms of the parameters, exponents as they
//! are) run from many starts that are drawn from ranges which the data give, until several of them
//! end at the same best optimum. The fit does not decide whether the circuit is the right one; the
//! corrected Akaike criterion compares circuits on the same data, objective and weight.

mod data;
mod fitted;
mod options;
mod order;
mod problem;
mod search;
mod starts;
mod uncertainty;
mod warnings;

pub use options::{CircuitFitError, CircuitOptions, MAX_STARTS, Search, Weight};

use super::cells::CellSweeps;
use super::clusters::Clusters;
use super::options::Objective;
use super::warning::{WarningCode, Warnings};
use analysis_model::model::{Circuit, ElementKind};
use analysis_numeric::Smooth;
use analysis_signal::spectrum::Spectrum;
use data::Data;
pub use fitted::{CircuitFit, State};
use problem::{Problem, is_log};
use starts::{Ranges, Starter};
use std::ops::RangeInclusive;
use uncertainty::Uncertainty;

/// A parameter this near to a bound counts as held by it: a fraction of its value, or, of an
/// exponent, a difference.
const NEAR_BOUND: f64 = 1e-6;

/// Fits a circuit to all points of all spectra together. The result depends on the data and the
/// options alone.
///
/// ```
/// use analysis_fit::fit::{CircuitOptions, fit_circuit};
/// use analysis_model::model::Circuit;
/// use analysis_numeric::Covariance2;
/// use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
///
/// // 15 mΩ and a depressed arc of 10 mΩ, from 10 mHz to 1 kHz without noise.
/// let circuit: Circuit = "R0-p(R1,CPE1)".parse()?;
/// let point = |k: i32| {
///     let freq_hz = 10.0_f64.powf(-2.0 + 0.2 * f64::from(k));
///     let z_ohm = circuit.impedance(&[0.015, 0.01, 20.0, 0.8], freq_hz);
///     ImpedancePoint { freq_hz, z_ohm, covariance: Covariance2::UNKNOWN, amplitude_a: 1.0 }
/// };
/// let spectrum = Spectrum { points: (0..26).map(point).collect(), ..Spectrum::default() };
/// let fit = fit_circuit(&[spectrum], &circuit, &CircuitOptions::default())?;
/// assert!((fit.values[1] - 0.01).abs() < 1e-6);
/// assert!((fit.values[3] - 0.8).abs() < 1e-4);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`CircuitFitError`] for data or options that cannot be fitted.
pub fn fit_circuit(
    spectra: &[Spectrum],
    circuit: &Circuit,
    options: &CircuitOptions,
) -> Result<CircuitFit, CircuitFitError> {
    fit(spectra, circuit, options, Clusters::sweeps(spectra.len()))
}

/// As [`fit_circuit`], with sigmas from the scatter of the cells if two or more are known.
///
/// # Errors
/// As [`fit_circuit`].
pub fn fit_circuit_cells(
    cells: &[CellSweeps],
    circuit: &Circuit,
    options: &CircuitOptions,
) -> Result<CircuitFit, CircuitFitError> {
    let (spectra, clusters) = Clusters::of_cells(cells);
    fit(&spectra, circuit, options, clusters)
}

fn fit(
    spectra: &[Spectrum],
    circuit: &Circuit,
    options: &CircuitOptions,
    clusters: Clusters,
) -> Result<CircuitFit, CircuitFitError> {
    check_values(circuit, options)?;
    let data = Data::new(spectra, clusters, options)?;
    let held = |i: &usize| options.constants.iter().any(|(c, _)| c == i);
    let free: Vec<usize> = (0..circuit.parameter_names().len())
        .filter(|i| !held(i))
        .collect();
    check_size(circuit, &data, free.len())?;
    let ranges = Ranges::of(&data);
    let bounds = ranges.all_bounds(circuit, &options.guess);
    let given: Vec<(usize, f64)> = options
        .guess
        .iter()
        .chain(&options.constants)
        .copied()
        .collect();
    let mut base = vec![1.0; circuit.parameter_names().len()];
    options
        .constants
        .iter()
        .for_each(|(i, value)| base[*i] = *value);
    let problem = Problem {
        circuit,
        data: &data,
        base,
        free,
        exact: false,
        corner: 0.0,
    };
    let starter = Starter {
        circuit,
        data: &data,
        ranges,
        given,
        bounds: &bounds,
    };
    let found = search::search(&problem, &starter, options).ok_or_else(|| {
        CircuitFitError::NoFiniteValue {
            circuit: circuit.to_string(),
        }
    })?;
    let mut values = problem.parameters(&found.minimum.x);
    order::order(circuit, &options.constants, &mut values);
    let mut fit = describe(&problem, values, &bounds);
    fit.spectra = spectra.iter().map(|s| s.name.clone()).collect();
    (fit.starts, fit.starts_at_optimum, fit.seed) = (found.starts, found.agreeing, options.seed);
    fit.warnings = warnings::warnings(&fit, &data, found.minimum.converged);
    let repeats = data.clusters.remark(data.is_chi2());
    fit.warnings
        .extend(repeats.map(|words| WarningCode::Repeats.says(words)));
    let signs = crate::validity::wrong_sign_remarks(spectra);
    fit.warnings
        .extend(signs.into_iter().map(|words| WarningCode::Sign.says(words)));
    if !has_inductance(circuit) {
        let loops = crate::validity::slow_loop_remarks(spectra);
        fit.warnings
            .extend(loops.into_iter().map(|words| WarningCode::Sign.says(words)));
    }
    fit.warnings.extend(super::outliers::remarks(spectra, None));
    Ok(fit)
}

fn has_inductance(circuit: &Circuit) -> bool {
    let mut found = false;
    circuit
        .root()
        .visit(&mut |element| found |= matches!(element.kind, ElementKind::L | ElementKind::La));
    found
}

fn check_values(circuit: &Circuit, options: &CircuitOptions) -> Result<(), CircuitFitError> {
    if let Some(met) = options
        .starts
        .filter(|starts| !(1..=MAX_STARTS).contains(starts))
    {
        return Err(CircuitFitError::BadStarts { met });
    }
    for (list, values) in [
        ("start values", &options.guess),
        ("constants", &options.constants),
    ] {
        for (index, value) in values {
            let range = circuit
                .parameter_kinds()
                .get(*index)
                .map(|kind| kind.bounds);
            if !range.is_some_and(|(lower, upper)| (lower..=upper).contains(value)) {
                return Err(CircuitFitError::BadValue {
                    circuit: circuit.to_string(),
                    list,
                    index: *index,
                    value: *value,
                });
            }
        }
    }
    Ok(())
}

fn check_size(circuit: &Circuit, data: &Data, parameters: usize) -> Result<(), CircuitFitError> {
    let frequencies = data.groups.len();
    let numbers = if data.kind == Objective::Modulus {
        frequencies
    } else {
        2 * frequencies
    };
    // Readings that repeat exactly are one reading. A fit through it has no residual, so no
    // uncertainty can be estimated.
    if parameters == numbers && data.points > frequencies && data.is_repeated() {
        return Err(CircuitFitError::Repeated {
            circuit: circuit.to_string(),
            parameters,
            points: data.points,
            frequencies,
            numbers,
        });
    }
    if parameters <= numbers {
        return Ok(());
    }
    Err(CircuitFitError::TooFewFrequencies {
        circuit: circuit.to_string(),
        parameters,
        numbers,
        frequencies,
        objective: data.kind,
    })
}

/// All that can be said of an optimum, without how it was found.
fn describe(problem: &Problem, values: Vec<f64>, bounds: &[(f64, f64)]) -> CircuitFit {
    let (circuit, data) = (problem.circuit, problem.data);
    let n = values.len();
    let x = problem.variables(&values);
    let states: Vec<State> = (0..n)
        .map(|i| {
            let (lower, upper) = bounds[i];
            state(problem, i, values[i], lower..=upper)
        })
        .collect();
    let at_bound: Vec<bool> = problem
        .free
        .iter()
        .map(|i| states[*i] != State::Free)
        .collect();
    let uncertainty = Uncertainty::of(problem, &x, &at_bound);
    let stretch = problem.stretch(&values);
    let place = |i: usize| problem.free.iter().position(|f| *f == i);
    let entry = |i: usize, j: usize| {
        let (a, b) = (place(i)?, place(j)?);
        uncertainty
            .covariance(a, b)
            .map(|c| c * stretch[a] * stretch[b])
    };
    let objective = problem.value(&x);
    let chi2 = data.is_chi2() && uncertainty.freedom > 0;
    CircuitFit {
        circuit: circuit.to_string(),
        names: circuit.parameter_names().to_vec(),
        sigmas: (0..n)
            .map(|i| entry(i, i).map(|v| v.max(0.0).sqrt()))
            .collect(),
        units: circuit
            .parameter_kinds()
            .iter()
            .map(|kind| kind.unit.to_owned())
            .collect(),
        states,
        bounds: bounds.to_vec(),
        covariance: (0..n)
            .map(|i| (0..n).map(|j| entry(i, j)).collect())
            .collect(),
        objective,
        objective_kind: data.kind,
        weight: data.weight,
        degrees_of_freedom: uncertainty.freedom,
        reduced_chi2: chi2.then(|| objective / uncertainty.freedom as f64),
        aicc: aicc(data, objective, problem.free.len()),
        rms_ohm: data.rms_ohm(&problem.seen(&values)),
        condition: uncertainty.condition,
        points: data.points,
        band_hz: band_hz(data),
        spectra: Vec::new(),
        starts: 0,
        starts_at_optimum: 0,
        seed: 0,
        warnings: Warnings::default(),
        values,
    }
}

/// Lowest and highest frequency of the data.
fn band_hz(data: &Data) -> Option<(f64, f64)> {
    let freqs = || data.groups.iter().map(|group| group.freq_hz);
    Some((
        freqs().min_by(f64::total_cmp)?,
        freqs().max_by(f64::total_cmp)?,
    ))
}

fn state(problem: &Problem, i: usize, value: f64, bounds: RangeInclusive<f64>) -> State {
    let near = if is_log(problem.circuit, i) {
        NEAR_BOUND * value
    } else {
        NEAR_BOUND
    };
    if !problem.free.contains(&i) {
        State::Constant
    } else if value <= bounds.start() + near {
        State::AtLowerBound
    } else if value >= bounds.end() - near {
        State::AtUpperBound
    } else {
        State::Free
    }
}

/// −2 ln likelihood + 2k with the correction for few numbers. The likelihood is normal for least
/// squares and ∝ exp(−|r|/b) for the sum of norms; a scale that the weights do not state counts as
/// a parameter.
fn aicc(data: &Data, objective: f64, free: usize) -> Option<f64> {
    let n = data.numbers() as f64;
    let (deviance, k) = match (data.kind, data.weight) {
        (Objective::SumAbs, _) => (2.0 * n * (objective / n).ln(), free + 1),
        (_, Weight::Covariance) => (objective, free),
        _ => (n * (objective / n).ln(), free + 1),
    };
    let k = k as f64;
    let correction = 2.0 * k * (k + 1.0) / (n - k - 1.0);
    Some(deviance + 2.0 * k + correction).filter(|a| a.is_finite() && n > k + 1.0)
}

#[cfg(test)]
mod tests;
