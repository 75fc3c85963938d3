//! How well the data fix the parameters.
//!
//! With weights that are inverse covariances: (JᵀWJ)⁻¹, widened by the reduced χ² where that exceeds one (Birge's ratio). Without them, over
//! fewer spectra than parameters: noise proportional to |Z|, its size from the residuals. Otherwise the sandwich H⁻¹BH⁻¹ of an M-estimator
//! (Huber, 1967), H the Hessian of the objective and B the scatter of its gradient over whole spectra, because the points of one sweep share
//! its cell and its contacts. (Over the points of one sweep of 20 the sandwich was measured to state two thirds of the scatter of repeats.) A
//! parameter held by a bound has no sigma.

use super::linalg::invert;
use super::local::Smooth;
use super::options::{FitOptions, Objective};
use super::problem::{Group, Problem, Sym2, impedance};
use super::search::log_bounds;
use crate::model::Erm;
use serde::{Deserialize, Serialize};

/// Corner of the norm, in median residuals, for the Hessian of a sum of norms over many spectra. The fit runs right through some points, whose
/// curvature 1/|r| says nothing of the noise. For normal noise this corner makes the sigmas 3 % large; rounding the gradients too, 0.5 with both
/// once made them 6 % small.
const NORM_CORNER: f64 = 0.25;

/// Standard uncertainty of a branch; none where the data do not fix it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RcSigma {
    /// Of the resistance, Ω.
    pub r_ohm: Option<f64>,
    /// Of the capacitance, F.
    pub c_f: Option<f64>,
    /// Of the time constant, s.
    pub time_constant_s: Option<f64>,
}

/// Standard uncertainty of a model's parameters; none where the data do not fix them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ErmSigma {
    /// Of the series resistance, Ω.
    pub r_ohm: Option<f64>,
    /// Of the branches, in their order.
    pub branches: Vec<RcSigma>,
    /// Of the resistance at zero frequency, Ω.
    pub dc_resistance_ohm: Option<f64>,
}

pub(crate) struct Uncertainty {
    pub(crate) sigma: ErmSigma,
    pub(crate) log_covariance: Option<Vec<Vec<f64>>>,
    /// Degrees of freedom; zero when there are no more numbers than parameters.
    pub(crate) freedom: f64,
}

impl Uncertainty {
    pub(crate) fn of(problem: &Problem, erm: &Erm, options: &FitOptions, spectra: usize) -> Self {
        let x = erm.log_parameters();
        let n = x.len();
        let per_point = if problem.kind == Objective::Modulus { 1 } else { 2 };
        let freedom = (per_point * problem.points).saturating_sub(n) as f64;
        let bounds = log_bounds(options);
        let free: Vec<usize> = (0..n).filter(|i| x[*i] > bounds[*i].0 + 1e-9 && x[*i] < bounds[*i].1 - 1e-9).collect();
        let covariance = covariance(problem, &x, &free, (freedom, spectra));
        let entry = |i: usize, j: usize| -> Option<f64> {
            let (row, column) = (free.iter().position(|f| *f == i)?, free.iter().position(|f| *f == j)?);
            covariance.as_ref().map(|c| c[row * free.len() + column])
        };
        let sigma = sigma_of(erm, &entry);
        let log_covariance = (0..n).map(|i| (0..n).map(|j| entry(i, j)).collect()).collect();
        Self { sigma, log_covariance, freedom }
    }
}

/// Standard uncertainties from entries of the covariance of the logarithmic parameters.
pub(crate) fn sigma_of(erm: &Erm, entry: &impl Fn(usize, usize) -> Option<f64>) -> ErmSigma {
    let root = |variance: f64| Some(variance.max(0.0).sqrt()).filter(|s| s.is_finite());
    let relative = |i: usize| entry(i, i).and_then(root);
    let branch = |(k, b): (usize, &crate::model::RcBranch)| {
        let (i, j) = (2 * k + 1, 2 * k + 2);
        let sum = || root(entry(i, i)? + entry(j, j)? + 2.0 * entry(i, j)?);
        RcSigma {
            r_ohm: relative(i).map(|s| s * b.r_ohm),
            c_f: relative(j).map(|s| s * b.c_f),
            time_constant_s: sum().map(|s| s * b.time_constant_s()),
        }
    };
    let resistances: Vec<(usize, f64)> =
        std::iter::once((0, erm.r_ohm)).chain(erm.branches.iter().enumerate().map(|(k, b)| (2 * k + 1, b.r_ohm))).collect();
    let pairs = resistances.iter().flat_map(|a| resistances.iter().map(move |b| (a, b)));
    let dc: Option<f64> = pairs.map(|(a, b)| entry(a.0, b.0).map(|c| c * a.1 * b.1)).sum();
    ErmSigma {
        r_ohm: relative(0).map(|s| s * erm.r_ohm),
        branches: erm.branches.iter().enumerate().map(branch).collect(),
        dc_resistance_ohm: dc.and_then(root),
    }
}

/// Covariance of the free logarithmic parameters, row-major; none when the data do not fix them or leave no freedom to tell.
fn covariance(problem: &Problem, x: &[f64], free: &[usize], (freedom, spectra): (f64, usize)) -> Option<Vec<f64>> {
    let (n, m) = (x.len(), free.len());
    let of_free = |h: &[f64]| free.iter().flat_map(|i| free.iter().map(|j| h[i * n + j]).collect::<Vec<_>>()).collect::<Vec<f64>>();
    let scaled = |matrix: Vec<f64>, by: f64| Some(matrix.iter().map(|v| v * by).collect::<Vec<f64>>());
    if problem.absolute_weights {
        let widening = if freedom > 0.0 { (problem.value(x) / freedom).max(1.0) } else { 1.0 };
        return scaled(invert(&of_free(&information(problem, x, |g| g.weight)), m)?, 2.0 * widening);
    }
    if freedom <= 0.0 {
        return None;
    }
    let numbers = freedom + n as f64;
    let by_spectrum = scatters_by_spectrum(problem, spectra, n);
    if problem.kind == Objective::Complex && !by_spectrum {
        return scaled(invert(&of_free(&information(problem, x, |g| g.weight)), m)?, 2.0 * problem.value(x) / freedom);
    }
    if problem.kind == Objective::SumAbs && !by_spectrum {
        let (bread, meat) = norms_under_noise(problem, x, numbers / freedom);
        return sandwich(&invert(&of_free(&bread), m)?, &of_free(&meat), m, 1.0);
    }
    let (mut gradient, mut hessian) = (vec![0.0; n], vec![0.0; n * n]);
    rounded(problem, x).expand(x, &mut gradient, &mut hessian);
    let bread = invert(&of_free(&hessian), m)?;
    let meat = gradient_scatter(problem, x, free, by_spectrum.then_some(spectra));
    let small_sample = if by_spectrum { spectra as f64 / (spectra as f64 - 1.0) * numbers / freedom } else { numbers / freedom };
    sandwich(&bread, &meat, m, small_sample)
}

fn sandwich(bread: &[f64], meat: &[f64], m: usize, by: f64) -> Option<Vec<f64>> {
    let half = multiply(bread, meat, m);
    Some(multiply(&half, bread, m).iter().map(|v| v * by).collect())
}

/// Hessian and gradient scatter of a sum of norms under normal noise proportional to |Z|, equal in both parts: with σ per part the mean of 1/|r|
/// is √(π/2)/σ, and |r| itself has the mean σ√(π/2), from which σ is read. `excess` is numbers over degrees of freedom.
fn norms_under_noise(problem: &Problem, x: &[f64], excess: f64) -> (Vec<f64>, Vec<f64>) {
    let relative = |g: &Group| {
        let z = impedance(x, g.freq_hz);
        g.points.iter().map(|p| (z - p.z).norm() / z.norm()).sum::<f64>()
    };
    let mean = problem.groups.iter().map(relative).sum::<f64>() / problem.points as f64;
    let sigma = mean * excess.sqrt() / std::f64::consts::FRAC_PI_2.sqrt();
    // [`information`] doubles what it is given.
    let quarter = |g: &Group| 0.25 * g.points.len() as f64;
    let bread = |g: &Group| {
        let w = quarter(g) * std::f64::consts::FRAC_PI_2.sqrt() / (sigma * impedance(x, g.freq_hz).norm()).max(f64::MIN_POSITIVE);
        [w, 0.0, w]
    };
    (information(problem, x, bread), information(problem, x, |g| [quarter(g), 0.0, quarter(g)]))
}

/// The problem with the norm's corner as round as the residuals are large.
pub(super) fn rounded(problem: &Problem, x: &[f64]) -> Problem {
    problem.smoothed(NORM_CORNER * median_residual_ohm(problem, x).max(1e-6 * problem.scale_ohm))
}

/// Enough spectra to take their own scatter instead of that of points.
pub(super) fn scatters_by_spectrum(problem: &Problem, spectra: usize, parameters: usize) -> bool {
    !problem.absolute_weights && spectra > parameters
}

fn median_residual_ohm(problem: &Problem, x: &[f64]) -> f64 {
    let of = |g: &Group| {
        let z = impedance(x, g.freq_hz);
        g.points.iter().map(move |p| (z - p.z).norm()).collect::<Vec<f64>>()
    };
    let mut residuals: Vec<f64> = problem.groups.iter().flat_map(of).collect();
    residuals.sort_by(f64::total_cmp);
    residuals.get(residuals.len() / 2).copied().unwrap_or(0.0)
}

/// 2JᵀWJ with respect to the logarithmic parameters, W by frequency.
fn information(problem: &Problem, x: &[f64], weight: impl Fn(&Group) -> Sym2) -> Vec<f64> {
    let n = x.len();
    let mut sum = vec![0.0; n * n];
    let Ok(erm) = Erm::from_log_parameters(x) else { return sum };
    for g in &problem.groups {
        let slopes = erm.log_gradient(g.freq_hz);
        let [xx, xy, yy] = weight(g);
        for (i, a) in slopes.iter().enumerate() {
            for (j, b) in slopes.iter().enumerate() {
                sum[i * n + j] += 2.0 * (xx * a.re * b.re + xy * (a.re * b.im + a.im * b.re) + yy * a.im * b.im);
            }
        }
    }
    sum
}

/// Σ gᵢgᵢᵀ over the gradients of the objective's shares: of whole spectra, or of single points.
fn gradient_scatter(problem: &Problem, x: &[f64], free: &[usize], spectra: Option<usize>) -> Vec<f64> {
    let m = free.len();
    let mut sum = vec![0.0; m * m];
    let mut add = |g: &[f64]| {
        for i in 0..m {
            for j in 0..m {
                sum[i * m + j] += g[i] * g[j];
            }
        }
    };
    let Ok(erm) = Erm::from_log_parameters(x) else { return sum };
    let mut clusters = vec![vec![0.0; m]; spectra.unwrap_or(0)];
    for g in &problem.groups {
        let (z, slopes) = (erm.impedance(g.freq_hz), erm.log_gradient(g.freq_hz));
        for p in &g.points {
            let [gx, gy] = problem.point_gradient(p, z);
            let share: Vec<f64> = free.iter().map(|i| gx * slopes[*i].re + gy * slopes[*i].im).collect();
            match clusters.get_mut(p.spectrum) {
                Some(cluster) => cluster.iter_mut().zip(&share).for_each(|(c, s)| *c += s),
                None => add(&share),
            }
        }
    }
    clusters.iter().for_each(|c| add(c));
    sum
}

fn multiply(a: &[f64], b: &[f64], n: usize) -> Vec<f64> {
    (0..n * n).map(|ij| (0..n).map(|k| a[ij / n * n + k] * b[k * n + ij % n]).sum()).collect()
}
