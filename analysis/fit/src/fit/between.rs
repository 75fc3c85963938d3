//! Sigmas of a model of several cells whose points have stated covariances. These covariances
//! describe the noise of a sweep, but the cells differ by far more. Every cell is therefore fitted
//! on its own. The scatter of the cells' parameters gives the uncertainty of their mean, as the
//! mean of all such cells. Errors that the points of all cells share move all cells alike, and are
//! added.

use nalgebra::{DMatrix, SymmetricEigen};

use super::clusters::Clusters;
use super::options::FitOptions;
use super::problem::{Problem, to_erm};
use super::search::{log_bounds, polish};
use super::uncertainty::{Uncertainty, own_noise, sigma_of};
use analysis_model::model::Erm;
use analysis_signal::spectrum::Spectrum;

/// One cell fitted on its own.
struct Own {
    x: Vec<f64>,
    /// Covariance of the logarithmic parameters.
    full: DMatrix<f64>,
    /// The same as if common errors were known.
    noise: DMatrix<f64>,
    value: f64,
    freedom: f64,
}

/// The mean of the cells, each counting once however often and well it was measured.
pub(super) struct Between {
    pub(super) erm: Erm,
    /// χ² per degree of freedom within the cells.
    pub(super) reduced_chi2: Option<f64>,
}

/// Returns the mean of the cells' logarithmic parameters, with their scatter instead of the widened
/// noise of sweeps. Returns `None` and changes nothing if a cell does not determine all parameters.
/// `x` is the start of the fits to the cells.
pub(super) fn between_cells(
    spectra: &[Spectrum],
    options: &FitOptions,
    clusters: &Clusters,
    x: &[f64],
    uncertainty: &mut Uncertainty,
) -> Option<Between> {
    let of_cell = |cell: usize| -> Vec<Spectrum> {
        spectra
            .iter()
            .enumerate()
            .filter(|(sweep, _)| clusters.of(*sweep) == cell)
            .map(|(_, spectrum)| spectrum.clone())
            .collect()
    };
    let cells: Vec<Own> = (0..clusters.count)
        .map(|cell| alone(&of_cell(cell), options, x))
        .collect::<Option<_>>()?;
    let (count, n) = (cells.len() as f64, x.len());
    let mean = |of: fn(&Own) -> &DMatrix<f64>| {
        cells
            .iter()
            .fold(DMatrix::zeros(n, n), |sum, cell| sum + of(cell))
            / count
    };
    let centre: Vec<f64> = (0..n)
        .map(|i| cells.iter().map(|cell| cell.x[i]).sum::<f64>() / count)
        .collect();
    let scatter = cells.iter().fold(DMatrix::zeros(n, n), |sum, cell| {
        let off = DMatrix::from_fn(n, 1, |i, _| cell.x[i] - centre[i]);
        sum + &off * off.transpose()
    }) / (count - 1.0);
    let noise = mean(|cell| &cell.noise);
    let shared = mean(|cell| &cell.full) - &noise;
    let covariance = filled(&scatter, &noise)? / count + shared;
    let entry = |i: usize, j: usize| Some(covariance[(i, j)]);
    let erm = to_erm(&centre);
    uncertainty.sigma = sigma_of(&erm, &entry);
    uncertainty.log_covariance = Some(
        (0..n)
            .map(|i| (0..n).map(|j| covariance[(i, j)]).collect())
            .collect(),
    );
    let (value, freedom) = cells.iter().fold((0.0, 0.0), |(value, freedom), cell| {
        (value + cell.value, freedom + cell.freedom)
    });
    Some(Between {
        erm,
        reduced_chi2: Some(value / freedom).filter(|chi2| chi2.is_finite()),
    })
}

fn alone(sweeps: &[Spectrum], options: &FitOptions, x: &[f64]) -> Option<Own> {
    let problem = Problem::new(sweeps, options.objective);
    let minimum = polish(&problem, x, &log_bounds(options));
    let erm = to_erm(&minimum.x);
    let (n, own) = (x.len(), Clusters::sweeps(sweeps.len()));
    let uncertainty = Uncertainty::of(&problem, &erm, options, &own);
    let rows = uncertainty
        .log_covariance
        .filter(|rows| rows.iter().flatten().all(|entry| entry.is_finite()))?;
    let noise = own_noise(&problem, &minimum.x, uncertainty.freedom, &own)?;
    let full = DMatrix::from_fn(n, n, |i, j| rows[i][j]);
    Some(Own {
        x: minimum.x,
        full,
        noise: DMatrix::from_row_slice(n, n, &noise),
        value: minimum.value,
        freedom: uncertainty.freedom,
    })
}

/// Returns the scatter; the directions that the few cells do not determine are filled with the
/// noise. The variance of each parameter stays that of the scatter. `None` if the noise is not
/// positive definite.
fn filled(scatter: &DMatrix<f64>, noise: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let root = noise.clone().cholesky()?.l();
    let whitened =
        root.solve_lower_triangular(&root.solve_lower_triangular(scatter)?.transpose())?;
    let eigen = SymmetricEigen::new((&whitened + whitened.transpose()) * 0.5);
    let raised = &eigen.eigenvectors
        * DMatrix::from_diagonal(&eigen.eigenvalues.map(|value| value.max(1.0)))
        * eigen.eigenvectors.transpose();
    let full = &root * raised * root.transpose();
    let scale: Vec<f64> = (0..full.nrows())
        .map(|i| (scatter[(i, i)] / full[(i, i)]).sqrt())
        .collect();
    Some(DMatrix::from_fn(full.nrows(), full.ncols(), |i, j| {
        scale[i] * scale[j] * full[(i, j)]
    }))
}
