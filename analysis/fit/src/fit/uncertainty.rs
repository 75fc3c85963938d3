//! Uncertainty of the parameters of the extended Randles model, from the information in
//! [`Evidence`]. A parameter held by a bound has no sigma.

use super::clusters::Clusters;
use super::evidence::{CELL_CORNER, Evidence, FrequencyShare, NORM_CORNER, Normal, PointShare};
use super::options::{FitOptions, Objective};
use super::pooled::{DataPoint, Group, of_free, quadratic};
use super::problem::{Problem, impedance};
use super::search::log_bounds;
use super::zero::is_r_zero;
use analysis_model::model::Erm;
use analysis_numeric::{
    Smooth,
    linalg::{invert, product},
};
use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// Standard uncertainty of a branch; `None` if the data do not determine it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RcSigma {
    /// Standard uncertainty of the resistance, Ω.
    pub r_ohm: Option<f64>,
    /// Standard uncertainty of the capacitance, F.
    pub c_f: Option<f64>,
    /// Standard uncertainty of the time constant, s.
    pub time_constant_s: Option<f64>,
}

/// Standard uncertainty of a model's parameters; `None` if the data do not determine them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErmSigma {
    /// Standard uncertainty of the series resistance, Ω.
    pub r_ohm: Option<f64>,
    /// Standard uncertainties of the branches, in their order.
    pub branches: Vec<RcSigma>,
    /// Standard uncertainty of the resistance at zero frequency, Ω.
    pub dc_resistance_ohm: Option<f64>,
}

pub(crate) struct Uncertainty {
    pub(crate) sigma: ErmSigma,
    pub(crate) log_covariance: Option<Vec<Vec<f64>>>,
    /// Degrees of freedom; zero if the data have no more numbers than parameters.
    pub(crate) freedom: f64,
}

impl Uncertainty {
    pub(crate) fn of(
        problem: &Problem,
        erm: &Erm,
        options: &FitOptions,
        clusters: &Clusters,
    ) -> Self {
        let x = erm.log_parameters();
        let n = x.len();
        let per_point = if problem.kind == Objective::Modulus {
            1
        } else {
            2
        };
        let freedom = (per_point * problem.points).saturating_sub(n) as f64;
        let bounds = log_bounds(options);
        let free: Vec<usize> = (0..n)
            .filter(|i| x[*i] > bounds[*i].0 + 1e-9 && x[*i] < bounds[*i].1 - 1e-9)
            .collect();
        let covariance = covariance(
            problem,
            &x,
            &free,
            freedom,
            clusters,
            taken(problem, &x, &free),
        );
        // A resistance of zero is as certain as the sum that it is a part of needs.
        let zero = is_r_zero(erm, &options.bounds, problem);
        let entry = |i: usize, j: usize| -> Option<f64> {
            if zero && (i == 0 || j == 0) {
                return covariance.as_ref().map(|_| 0.0);
            }
            let (row, column) = (
                free.iter().position(|f| *f == i)?,
                free.iter().position(|f| *f == j)?,
            );
            covariance.as_ref().map(|c| c[row * free.len() + column])
        };
        let mut sigma = sigma_of(erm, &entry);
        sigma.r_ohm = sigma.r_ohm.filter(|_| !zero);
        let log_covariance = (0..n)
            .map(|i| (0..n).map(|j| entry(i, j)).collect())
            .collect();
        Self {
            sigma,
            log_covariance,
            freedom,
        }
    }
}

/// Standard uncertainties from entries of the covariance of the logarithmic parameters.
pub(crate) fn sigma_of(erm: &Erm, entry: &impl Fn(usize, usize) -> Option<f64>) -> ErmSigma {
    let root = |variance: f64| Some(variance.max(0.0).sqrt()).filter(|s| s.is_finite());
    let relative = |i: usize| entry(i, i).and_then(root);
    let branch = |(k, b): (usize, &analysis_model::model::RcBranch)| {
        let (i, j) = (2 * k + 1, 2 * k + 2);
        let sum = || root(entry(i, i)? + entry(j, j)? + 2.0 * entry(i, j)?);
        RcSigma {
            r_ohm: relative(i).map(|s| s * b.r_ohm),
            c_f: relative(j).map(|s| s * b.c_f),
            time_constant_s: sum().map(|s| s * b.time_constant_s()),
        }
    };
    let resistances: Vec<(usize, f64)> = std::iter::once((0, erm.r_ohm))
        .chain(
            erm.branches
                .iter()
                .enumerate()
                .map(|(k, b)| (2 * k + 1, b.r_ohm)),
        )
        .collect();
    let pairs = resistances
        .iter()
        .flat_map(|a| resistances.iter().map(move |b| (a, b)));
    let dc: Option<f64> = pairs
        .map(|(a, b)| entry(a.0, b.0).map(|c| c * a.1 * b.1))
        .sum();
    ErmSigma {
        r_ohm: relative(0).map(|s| s * erm.r_ohm),
        branches: erm.branches.iter().enumerate().map(branch).collect(),
        dc_resistance_ohm: dc.and_then(root),
    }
}

/// Returns the covariance of the free logarithmic parameters, row-major; `None` if the data do not
/// determine them or leave no degrees of freedom.
///
/// `shared` is the information that common errors remove.
fn covariance(
    problem: &Problem,
    x: &[f64],
    free: &[usize],
    freedom: f64,
    clusters: &Clusters,
    shared: Option<Vec<f64>>,
) -> Option<Vec<f64>> {
    let (n, m) = (x.len(), free.len());
    let evidence = Evidence {
        kind: problem.kind,
        absolute_weights: problem.absolute_weights,
        value: problem.value(x),
        numbers: freedom + n as f64,
        freedom,
        clusters,
        frequencies: shares(problem, x, free)?,
        shared,
    };
    let hessian = |corner: f64| {
        let (mut gradient, mut hessian) = (vec![0.0; n], vec![0.0; n * n]);
        problem
            .smoothed(corner.max(1e-6 * problem.scale_ohm))
            .expand(x, &mut gradient, &mut hessian);
        of_free(&hessian, n, free)
    };
    let Normal {
        bread,
        meat,
        factor,
    } = evidence.normal(hessian);
    let (inverse, factor) = (invert(&bread, m)?, factor?);
    let covariance = match meat {
        Some(meat) => product(&product(&inverse, &meat, m), &inverse, m),
        None => inverse,
    };
    Some(covariance.iter().map(|v| v * factor).collect())
}

/// Covariance of all logarithmic parameters as if common errors were known, row by row.
pub(super) fn own_noise(
    problem: &Problem,
    x: &[f64],
    freedom: f64,
    clusters: &Clusters,
) -> Option<Vec<f64>> {
    covariance(
        problem,
        x,
        &(0..x.len()).collect::<Vec<usize>>(),
        freedom,
        clusters,
        None,
    )
}

/// Information on the free parameters that common errors remove, row by row; none without common
/// errors.
fn taken(problem: &Problem, x: &[f64], free: &[usize]) -> Option<Vec<f64>> {
    let (common, n) = (problem.common.as_ref()?, x.len());
    let all = common.taken_from_hessian(&problem.mixed(x), n);
    Some(of_free(&all, n, free))
}

/// Returns the shares of every frequency at the optimum; `None` for parameters that do not give a
/// model.
fn shares(problem: &Problem, x: &[f64], free: &[usize]) -> Option<Vec<FrequencyShare>> {
    let erm = Erm::from_log_parameters(x).ok()?;
    let seen = problem.seen(x);
    let of = |(group, g): (usize, &Group)| {
        let slopes = erm.log_gradient(g.freq_hz);
        let point = |(p, z): (&DataPoint, &Complex64)| PointShare {
            norm: quadratic(&p.weight, *z - p.z).sqrt(),
            size: z.norm(),
            weight: p.weight,
            gradient: problem.point_gradient(p, *z, problem.smoothing_ohm),
            spectrum: p.spectrum,
        };
        FrequencyShare {
            slopes: free.iter().map(|i| slopes[*i]).collect(),
            weight: g.weight,
            points: g.points.iter().zip(&seen[group]).map(point).collect(),
        }
    };
    Some(problem.groups.iter().enumerate().map(of).collect())
}

/// Returns the problem with the norm's corner rounded by the size of the residuals, as for the
/// sigmas.
pub(super) fn rounded(problem: &Problem, x: &[f64], by_cell: bool) -> Problem {
    problem.smoothed(
        if by_cell { CELL_CORNER } else { NORM_CORNER }
            * median_residual_ohm(problem, x).max(1e-6 * problem.scale_ohm),
    )
}

fn median_residual_ohm(problem: &Problem, x: &[f64]) -> f64 {
    let of = |g: &Group| {
        let z = impedance(x, g.freq_hz);
        g.points
            .iter()
            .map(move |p| (z - p.z).norm())
            .collect::<Vec<f64>>()
    };
    let mut residuals: Vec<f64> = problem.groups.iter().flat_map(of).collect();
    residuals.sort_by(f64::total_cmp);
    residuals.get(residuals.len() / 2).copied().unwrap_or(0.0)
}
