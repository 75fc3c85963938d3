//! Uncertainty of the parameters of a circuit, from the information in [`Evidence`], as for the
//! extended Randles model. A parameter held by a bound has no sigma. The inverse is taken through
//! eigenvectors. Where the data fix only combinations, the parameters in them get no sigma, and the
//! others keep theirs.

use super::options::Weight;
use super::problem::Problem;
use crate::fit::evidence::{Evidence, FrequencyShare, Normal, PointShare};
use crate::fit::pooled::{of_free, quadratic};
use analysis_numeric::Smooth;
use nalgebra::DMatrix;

/// Eigenvalues of the scaled information below this fraction of the largest are rounding.
const NULL: f64 = 1e-13;
/// Share of a parameter in an undetermined direction, from which on it has no sigma.
const INVOLVED: f64 = 1e-3;

/// Covariance of the free variables that no bound holds.
pub(super) struct Uncertainty {
    /// Row-major over `variables`; `None` for a variable that the data do not determine.
    covariance: Vec<Option<f64>>,
    /// Places among the free variables.
    variables: Vec<usize>,
    /// Greatest over least eigenvalue of the information, scaled to a unit diagonal; `None` if the
    /// least is zero.
    pub(super) condition: Option<f64>,
    /// Numbers minus parameters that no bound holds.
    pub(super) freedom: usize,
}

impl Uncertainty {
    /// Computes the uncertainty at the optimum x of the free variables; bounds hold those in
    /// `held`.
    pub(super) fn of(problem: &Problem, x: &[f64], held: &[bool]) -> Self {
        let variables: Vec<usize> = (0..x.len()).filter(|k| !held[*k]).collect();
        let m = variables.len();
        let freedom = problem.data.numbers().saturating_sub(m);
        let evidence = Evidence {
            kind: problem.data.kind,
            absolute_weights: problem.data.is_chi2(),
            value: problem.value(x),
            numbers: problem.data.numbers() as f64,
            freedom: freedom as f64,
            clusters: &problem.data.clusters,
            frequencies: shares(problem, x, &variables),
            shared: taken(problem, x, &variables),
        };
        let Normal {
            bread,
            meat,
            factor,
        } = evidence.normal(|corner| hessian(problem, x, &variables, corner));
        let (bread, fixed, condition) = invert(&DMatrix::from_row_slice(m, m, &bread));
        let covariance = factor.map(|factor| match &meat {
            Some(meat) => &bread * DMatrix::from_row_slice(m, m, meat) * &bread * factor,
            None => &bread * factor,
        });
        let entry = |ij: usize| {
            let (i, j) = (ij / m, ij % m);
            covariance
                .as_ref()
                .map(|c| c[(i, j)])
                .filter(|c| fixed[i] && fixed[j] && c.is_finite())
        };
        Self {
            covariance: (0..m * m).map(entry).collect(),
            variables,
            condition,
            freedom,
        }
    }

    /// Returns the covariance of two free variables; `None` if the data do not determine them or a
    /// bound holds one.
    pub(super) fn covariance(&self, i: usize, j: usize) -> Option<f64> {
        let place = |k: usize| self.variables.iter().position(|v| *v == k);
        self.covariance
            .get(place(i)? * self.variables.len() + place(j)?)
            .copied()
            .flatten()
    }
}

/// Inverse in the directions that are fixed, which variables have no share in the others, and the
/// condition number.
fn invert(a: &DMatrix<f64>) -> (DMatrix<f64>, Vec<bool>, Option<f64>) {
    let m = a.nrows();
    if m == 0 {
        return (a.clone(), Vec::new(), None);
    }
    // A variable without any influence gets a scale of one and a row of zeros.
    let scale: Vec<f64> = (0..m)
        .map(|i| a[(i, i)].max(0.0).sqrt())
        .map(|s| if s > 0.0 && s.is_finite() { s } else { 1.0 })
        .collect();
    let scaled = DMatrix::from_fn(m, m, |i, j| {
        Some(a[(i, j)] / (scale[i] * scale[j]))
            .filter(|v| v.is_finite())
            .unwrap_or(0.0)
    });
    let eigen = scaled.symmetric_eigen();
    let largest = eigen.eigenvalues.iter().fold(0.0f64, |m, v| m.max(*v));
    let least = eigen
        .eigenvalues
        .iter()
        .fold(f64::INFINITY, |m, v| m.min(*v));
    let mut fixed = vec![true; m];
    let mut inverse = DMatrix::zeros(m, m);
    for (k, value) in eigen.eigenvalues.iter().enumerate() {
        let v = eigen.eigenvectors.column(k);
        if *value > NULL * largest {
            inverse += v * v.transpose() / *value;
        } else {
            fixed
                .iter_mut()
                .zip(v.iter())
                .for_each(|(fixed, share)| *fixed &= share.abs() < INVOLVED);
        }
    }
    let inverse = DMatrix::from_fn(m, m, |i, j| inverse[(i, j)] / (scale[i] * scale[j]));
    (
        inverse,
        fixed,
        Some(largest / least).filter(|c| least > 0.0 && c.is_finite()),
    )
}

/// Hessian over `variables` with a corner of the norm.
fn hessian(problem: &Problem, x: &[f64], variables: &[usize], corner: f64) -> Vec<f64> {
    let n = x.len();
    let corner = corner.max(1e-6 * problem.data.scale);
    let (mut gradient, mut hessian) = (vec![0.0; n], vec![0.0; n * n]);
    Problem {
        exact: true,
        corner,
        ..problem.clone()
    }
    .expand(x, &mut gradient, &mut hessian);
    of_free(&hessian, n, variables)
}

/// Information on the variables that common errors remove, row by row; none without common errors.
fn taken(problem: &Problem, x: &[f64], variables: &[usize]) -> Option<Vec<f64>> {
    Some(of_free(&problem.taken(x)?, x.len(), variables))
}

/// Every frequency at the optimum.
fn shares(problem: &Problem, x: &[f64], variables: &[usize]) -> Vec<FrequencyShare> {
    let data = problem.data;
    let seen = problem.seen(&problem.parameters(x));
    let mut all = Vec::new();
    problem.sweep(x, |k, z, slopes| {
        let group = &data.groups[k];
        let size = if data.weight == Weight::Unit {
            z.norm()
        } else {
            1.0
        };
        let points = group.points.iter().zip(&seen[k]).map(|(p, z)| PointShare {
            norm: quadratic(&p.weight, z - p.z).sqrt(),
            size,
            weight: p.weight,
            gradient: data.point_gradient(p, *z, 0.0),
            spectrum: p.spectrum,
        });
        let slopes = variables.iter().map(|i| slopes[*i]).collect();
        all.push(FrequencyShare {
            slopes,
            weight: data.share(group, z, 0.0, false).hessian.map(|h| 0.5 * h),
            points: points.collect(),
        });
    });
    all
}
