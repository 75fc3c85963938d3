//! The minima beside the best: which are distinct, the proof that they are minima, and how often
//! seeds and descents end in each.

use super::options::{FitError, FitOptions, check_spectra};
use super::problem::{Problem, to_erm};
use super::search::{Basin, Basins, log_bounds, same_minimum, search, sharp};
use analysis_model::model::Erm;
use analysis_numeric::{Smooth, linalg::cholesky};
use analysis_signal::spectrum::Spectrum;
use nalgebra::{DMatrix, SymmetricEigen};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// A resistance within this ratio of its lower bound makes a branch that is not there: a minimum of
/// a lower order.
const GONE: f64 = 1.02;

/// A minimum of the objective within the bounds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LocalMinimum {
    /// Value of the objective, in the unit of its kind.
    pub objective: f64,
    /// The model there, branches by rising time constant.
    pub parameters: Erm,
    /// Share of the descents that ended here.
    pub found_from_fraction: f64,
    /// Decrease that the gradient and the Hessian still promise, as a fraction of the objective:
    /// zero at a stationary point.
    pub promised_decrease: f64,
    /// Smallest eigenvalue of the Hessian over the logarithmic parameters that no bound holds, as a
    /// fraction of the objective: above zero at a minimum.
    pub smallest_curvature: f64,
    /// Names of the parameters held by a bound.
    pub held_by_bounds: Vec<String>,
}

impl LocalMinimum {
    /// Stationary and curved upwards in every direction the bounds leave.
    pub fn is_proven(&self) -> bool {
        self.promised_decrease < 1e-9 && self.smallest_curvature > 0.0
    }
}

/// Results of a search over many seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SeedSurvey {
    /// Number of RC branches.
    pub rc: usize,
    /// Number of seeds tried, upwards from the options' seed.
    pub seeds: u64,
    /// Seeds that reached the best objective of all within 1e-6 of it.
    pub at_best: u64,
    /// The best minimum known.
    pub best: LocalMinimum,
    /// Other minima met by any seed, deepest first.
    pub other_minima: Vec<LocalMinimum>,
}

/// Repeats a fit's search with `seeds` seeds, on all cores; `done` is called behind each of them.
///
/// # Errors
/// As [`super::fit_erm`].
pub fn survey_seeds(
    spectra: &[Spectrum],
    options: &FitOptions,
    seeds: u64,
    done: &(dyn Fn() + Sync),
) -> Result<SeedSurvey, FitError> {
    options.check()?;
    check_spectra(spectra)?;
    let problem = Problem::new(spectra, options.objective);
    options.check_size(problem.groups.len())?;
    let coarse = Problem::coarse(spectra, options.objective);
    let one = |k: u64| {
        let options = FitOptions {
            seed: options.seed.wrapping_add(k),
            ..*options
        };
        let found = search(&problem, &coarse, &options, 0);
        done();
        found
    };
    let found: Vec<Basins> = (0..seeds.max(1)).into_par_iter().map(one).collect();
    let best_value = found
        .iter()
        .map(|f| f.deepest.minimum.value)
        .fold(f64::INFINITY, f64::min);
    let reached = |f: &&Basins| f.deepest.minimum.value <= best_value + 1e-6 * best_value.abs();
    let at_best = found.iter().filter(reached).count() as u64;
    let descents: usize = found.iter().map(|f| f.descents).sum();
    let mut basins: Vec<Basin> = Vec::new();
    for basin in found
        .into_iter()
        .flat_map(|f| std::iter::once(f.deepest).chain(f.others))
    {
        match basins
            .iter_mut()
            .find(|b| same_minimum(&problem, &b.minimum, &basin.minimum))
        {
            Some(known) => known.descents += basin.descents,
            None => basins.push(basin),
        }
    }
    basins.sort_by(|a, b| a.minimum.value.total_cmp(&b.minimum.value));
    let mut described = basins
        .iter()
        .map(|b| describe(&problem, options, b, descents));
    let Some(best) = described.next() else {
        return Err(FitError::NoPoints {
            spectra: spectra.len(),
        });
    };
    let other_minima = described.filter(|m| is_distinct(m, options)).collect();
    Ok(SeedSurvey {
        rc: options.rc,
        seeds: seeds.max(1),
        at_best,
        best,
        other_minima,
    })
}

/// Returns the proven minima of a search except the deepest.
pub(super) fn other_minima(
    problem: &Problem,
    options: &FitOptions,
    found: &Basins,
) -> Vec<LocalMinimum> {
    let described = found
        .others
        .iter()
        .map(|b| describe(problem, options, b, found.descents));
    described.filter(|m| is_distinct(m, options)).collect()
}

/// Returns whether a minimum is proven and of this order: none of its branches has vanished.
fn is_distinct(minimum: &LocalMinimum, options: &FitOptions) -> bool {
    minimum.is_proven()
        && minimum
            .parameters
            .branches
            .iter()
            .all(|b| b.r_ohm > GONE * options.bounds.r_ohm.0)
}

fn describe(
    problem: &Problem,
    options: &FitOptions,
    basin: &Basin,
    descents: usize,
) -> LocalMinimum {
    let x = to_erm(&basin.minimum.x).ordered().log_parameters();
    let parameters = to_erm(&x);
    let bounds = log_bounds(options);
    let n = x.len();
    let (mut gradient, mut hessian) = (vec![0.0; n], vec![0.0; n * n]);
    let value = sharp(problem).expand(&x, &mut gradient, &mut hessian);
    let free: Vec<usize> = (0..n)
        .filter(|i| x[*i] > bounds[*i].0 + 1e-9 && x[*i] < bounds[*i].1 - 1e-9)
        .collect();
    let names = parameters.parameter_names();
    let held_by_bounds = (0..n)
        .filter(|i| !free.contains(i))
        .map(|i| names[i].clone())
        .collect();
    let m = free.len();
    let kept: Vec<f64> = free
        .iter()
        .flat_map(|i| free.iter().map(|j| hessian[i * n + j]).collect::<Vec<_>>())
        .collect();
    let pull: Vec<f64> = free.iter().map(|i| gradient[*i]).collect();
    let scale = value.abs().max(f64::MIN_POSITIVE);
    LocalMinimum {
        objective: basin.minimum.value,
        found_from_fraction: basin.descents as f64 / descents.max(1) as f64,
        promised_decrease: promised(&kept, &pull, m) / scale,
        smallest_curvature: smallest_eigenvalue(&kept, m) / scale,
        parameters,
        held_by_bounds,
    }
}

/// ½gᵀH⁻¹g; infinite when H is not positive definite.
fn promised(hessian: &[f64], gradient: &[f64], m: usize) -> f64 {
    let mut factor = hessian.to_vec();
    if !cholesky(&mut factor, m) {
        return f64::INFINITY;
    }
    let mut step = gradient.to_vec();
    analysis_numeric::linalg::cholesky_substitute(&factor, m, &mut step);
    0.5 * step.iter().zip(gradient).map(|(s, g)| s * g).sum::<f64>()
}

fn smallest_eigenvalue(hessian: &[f64], m: usize) -> f64 {
    if m == 0 {
        return f64::INFINITY;
    }
    SymmetricEigen::new(DMatrix::from_row_slice(m, m, hessian))
        .eigenvalues
        .min()
}
