//! How well the data fix the parameters of a circuit.
//!
//! For least squares (JᵀWJ)⁻¹, times the reduced χ² where weights say only the shape of the noise, and where they are covariances only if it
//! exceeds one (Birge's ratio). For the sum of norms, and over whole spectra when there are more of them than parameters and no covariance is stated (the points of one
//! sweep share its cell and its contacts), the sandwich H⁻¹BH⁻¹ of an M-estimator (Huber, 1967). A parameter held by a bound has no sigma. The inverse
//! goes through eigenvectors: where the data fix only combinations, the parameters in them get no sigma, and the others keep theirs.

use super::data::Group;
use super::options::Weight;
use super::problem::Problem;
use crate::fit::local::Smooth;
use crate::fit::options::Objective;
use nalgebra::DMatrix;

/// Corner of the norm, in median residuals, for the Hessian of a sum of norms: points that the fit meets exactly say nothing of the noise.
const NORM_CORNER: f64 = 0.5;
/// Eigenvalues of the scaled information below this fraction of the largest are rounding.
const NULL: f64 = 1e-13;
/// Share of a parameter in a direction that the data do not fix, from which on it has no sigma.
const INVOLVED: f64 = 1e-3;

/// Covariance of the free variables that no bound holds.
pub(super) struct Uncertainty {
    /// Row-major over `variables`; none for a variable that the data do not fix.
    covariance: Vec<Option<f64>>,
    /// Places among the free variables.
    variables: Vec<usize>,
    /// Greatest over least eigenvalue of the information, scaled to a unit diagonal; none where the least is zero.
    pub(super) condition: Option<f64>,
    /// Numbers minus parameters that no bound holds.
    pub(super) freedom: usize,
}

impl Uncertainty {
    /// At the optimum x of the free variables, of which `held` are held by bounds.
    pub(super) fn of(problem: &Problem, x: &[f64], held: &[bool]) -> Self {
        let variables: Vec<usize> = (0..x.len()).filter(|k| !held[*k]).collect();
        let m = variables.len();
        let freedom = problem.data.numbers().saturating_sub(m);
        let norms = problem.data.objective == Objective::SumAbs;
        let parameters = problem.parameters(x);
        let median = problem.data.median_residual(|freq_hz| problem.circuit.impedance(&parameters, freq_hz));
        let corner = if norms { NORM_CORNER * median.max(1e-6 * problem.data.scale) } else { 0.0 };
        let at = Problem { exact: norms, corner, ..problem.clone() };
        let (mut gradient, mut hessian) = (vec![0.0; x.len()], vec![0.0; x.len() * x.len()]);
        at.expand(x, &mut gradient, &mut hessian);
        let kept = DMatrix::from_fn(m, m, |i, j| hessian[variables[i] * x.len() + variables[j]]);
        let (bread, fixed, condition) = invert(&kept);
        let clustered = problem.data.spectra > m && problem.data.weight != Weight::Covariance;
        let covariance = if freedom == 0 && problem.data.weight != Weight::Covariance {
            None
        } else if norms || clustered {
            sandwich(&at, (x, &variables), (&bread, clustered))
        } else {
            let ratio = problem.value(x) / freedom.max(1) as f64;
            let factor = if problem.data.weight == Weight::Covariance { ratio.max(1.0) } else { ratio };
            // The Hessian of a sum of squares is twice the information.
            Some(&bread * (2.0 * factor))
        };
        let entry = |ij: usize| {
            let (i, j) = (ij / m, ij % m);
            covariance.as_ref().map(|c| c[(i, j)]).filter(|c| fixed[i] && fixed[j] && c.is_finite())
        };
        Self { covariance: (0..m * m).map(entry).collect(), variables, condition, freedom }
    }

    /// Covariance of two free variables; none where the data do not fix them or a bound holds one.
    pub(super) fn covariance(&self, i: usize, j: usize) -> Option<f64> {
        let place = |k: usize| self.variables.iter().position(|v| *v == k);
        self.covariance.get(place(i)? * self.variables.len() + place(j)?).copied().flatten()
    }
}

/// Inverse in the directions that are fixed, which variables have no share in the others, and the condition number.
fn invert(a: &DMatrix<f64>) -> (DMatrix<f64>, Vec<bool>, Option<f64>) {
    let m = a.nrows();
    if m == 0 {
        return (a.clone(), Vec::new(), None);
    }
    // A variable without any influence gets a scale of one and a row of zeros.
    let scale: Vec<f64> = (0..m).map(|i| a[(i, i)].max(0.0).sqrt()).map(|s| if s > 0.0 && s.is_finite() { s } else { 1.0 }).collect();
    let scaled = DMatrix::from_fn(m, m, |i, j| Some(a[(i, j)] / (scale[i] * scale[j])).filter(|v| v.is_finite()).unwrap_or(0.0));
    let eigen = scaled.symmetric_eigen();
    let largest = eigen.eigenvalues.iter().fold(0.0f64, |m, v| m.max(*v));
    let least = eigen.eigenvalues.iter().fold(f64::INFINITY, |m, v| m.min(*v));
    let mut fixed = vec![true; m];
    let mut inverse = DMatrix::zeros(m, m);
    for (k, value) in eigen.eigenvalues.iter().enumerate() {
        let v = eigen.eigenvectors.column(k);
        if *value > NULL * largest {
            inverse += v * v.transpose() / *value;
        } else {
            fixed.iter_mut().zip(v.iter()).for_each(|(fixed, share)| *fixed &= share.abs() < INVOLVED);
        }
    }
    let inverse = DMatrix::from_fn(m, m, |i, j| inverse[(i, j)] / (scale[i] * scale[j]));
    (inverse, fixed, Some(largest / least).filter(|c| least > 0.0 && c.is_finite()))
}

/// H⁻¹BH⁻¹ with the scatter B of the gradients over spectra (`clustered`) or over points.
fn sandwich(problem: &Problem, (x, variables): (&[f64], &[usize]), (bread, clustered): (&DMatrix<f64>, bool)) -> Option<DMatrix<f64>> {
    let (m, spectra, numbers) = (variables.len(), problem.data.spectra, problem.data.numbers() as f64);
    let mut shares: Vec<Vec<f64>> = vec![vec![0.0; m]; if clustered { spectra } else { 0 }];
    problem.sweep(x, |k, z, slopes| {
        let group: &Group = &problem.data.groups[k];
        for point in &group.points {
            let [gx, gy] = problem.data.point_gradient(point, z, problem.corner);
            let share: Vec<f64> = variables.iter().map(|i| gx * slopes[*i].re + gy * slopes[*i].im).collect();
            match shares.get_mut(point.spectrum) {
                Some(sum) if clustered => sum.iter_mut().zip(&share).for_each(|(sum, s)| *sum += s),
                _ => shares.push(share),
            }
        }
    });
    let mut meat = DMatrix::zeros(m, m);
    for share in &shares {
        meat += DMatrix::from_fn(m, m, |i, j| share[i] * share[j]);
    }
    let freedom = numbers - m as f64;
    let clusters = spectra as f64;
    let small_sample = if clustered { clusters / (clusters - 1.0) * numbers / freedom } else { numbers / freedom };
    (freedom > 0.0).then(|| bread * meat * bread * small_sample)
}
