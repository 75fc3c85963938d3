//! Test for correlated neighbouring residuals. A model that lacks a branch leaves waves over ln f;
//! noise does not.
//!
//! The statistic is Moran's I of neighbours over ln f (lag-1 autocorrelation of the weighted
//! residuals, real and imaginary parts each in their own row). Fitted residuals are never
//! independent, so mean and variance are those of least-squares residuals (Cliff and Ord, *Spatial
//! Processes*, 1981, section 8.3.2), from the projection that the parameters span.

use super::problem::Problem;
use super::result::ErmFit;
use nalgebra::DMatrix;

/// Lag-1 autocorrelation of one spectrum's residuals, and its excess over that of noise, in
/// standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lag1 {
    pub(super) correlation: f64,
    pub(super) z: f64,
}

/// Returns the autocorrelation of the residuals of a complex least-squares fit; `None` if the
/// parameters leave no degrees of freedom.
pub(super) fn lag1(problem: &Problem, fit: &ErmFit) -> Option<Lag1> {
    let (residuals, slopes) = weighted(problem, fit)?;
    let n = residuals.len();
    let span = orthonormal(slopes);
    let freedom = n as f64 - span.ncols() as f64;
    if freedom < 3.0 {
        return None;
    }
    let moved = neighbours(&span);
    let inner = span.transpose() * &moved;
    let pairs = n as f64 - 2.0;
    let trace = -inner.trace();
    // tr(MAMA) of the projection M = 1 − QQᵀ and the neighbour matrix A, whose entries are ½.
    let square = pairs / 2.0 - 2.0 * moved.norm_squared() + (&inner * &inner).trace();
    let mean = trace / freedom;
    let variance = 2.0 * (freedom * square - trace * trace) / (freedom * freedom * (freedom + 2.0));
    let column = DMatrix::from_column_slice(n, 1, &residuals);
    let correlation = column.dot(&neighbours(&column)) / column.norm_squared();
    let z = (correlation - mean) / variance.sqrt();
    z.is_finite().then_some(Lag1 { correlation, z })
}

/// Residuals times the root of their weight, real parts first, and the slopes of the parameters
/// treated alike.
fn weighted(problem: &Problem, fit: &ErmFit) -> Option<(Vec<f64>, DMatrix<f64>)> {
    let groups = problem.groups.len();
    let parameters = fit.erm.parameter_count();
    let mut residuals = vec![0.0; 2 * groups];
    let mut slopes = DMatrix::zeros(2 * groups, parameters);
    let seen = problem.seen(&fit.erm.log_parameters());
    for (k, g) in problem.groups.iter().enumerate() {
        // Cholesky of the weight: |root·r|² = rᵀWr.
        let [xx, xy, yy] = g.weight;
        let (a, b) = (xx.sqrt(), xy / xx.sqrt());
        let c = (yy - b * b).max(0.0).sqrt();
        let root = |z: num_complex::Complex64| (a * z.re + b * z.im, c * z.im);
        (residuals[k], residuals[groups + k]) =
            root(g.mean - seen[k].first().copied().unwrap_or_default());
        for (i, slope) in fit.erm.log_gradient(g.freq_hz).into_iter().enumerate() {
            (slopes[(k, i)], slopes[(groups + k, i)]) = root(slope);
        }
    }
    residuals
        .iter()
        .all(|r| r.is_finite())
        .then_some((residuals, slopes))
}

/// An orthonormal basis of what the columns span.
fn orthonormal(columns: DMatrix<f64>) -> DMatrix<f64> {
    let (rows, svd) = (columns.nrows(), columns.svd(true, false));
    let largest = svd.singular_values.max();
    let kept: Vec<usize> = (0..svd.singular_values.len())
        .filter(|i| svd.singular_values[*i] > 1e-10 * largest)
        .collect();
    svd.u
        .map_or_else(|| DMatrix::zeros(rows, 0), |u| u.select_columns(&kept))
}

/// Half the sum of the two neighbours, in the halves of real and imaginary parts.
fn neighbours(columns: &DMatrix<f64>) -> DMatrix<f64> {
    let half = columns.nrows() / 2;
    let at = |i: usize, j: usize, other: Option<usize>| {
        other
            .filter(|o| o / half == i / half)
            .map_or(0.0, |o| columns[(o, j)])
    };
    DMatrix::from_fn(columns.nrows(), columns.ncols(), |i, j| {
        let after = (i + 1 < columns.nrows()).then_some(i + 1);
        0.5 * (at(i, j, i.checked_sub(1)) + at(i, j, after))
    })
}
