//! Errors that points have in common, in complex least squares: each is one unknown of variance 1
//! along a known direction, and the objective is the one with all of them at their best (they enter
//! it linearly). That equals χ² under the full covariance of all points (Woodbury's identity).
//!
//! With W the weights of the points' own noise, D the directions and r the residuals: χ² = rᵀWr −
//! bᵀG⁻¹b, b = DᵀWr, G = λ1 + DᵀWD. λ is 1 where W is an inverse covariance, and the scale of the
//! noise where weights are relative.

use std::f64::consts::SQRT_2;

use num_complex::Complex64;

use analysis_numeric::linalg::{cholesky, cholesky_substitute};
use analysis_signal::spectrum::Spectrum;

/// Scale of the noise of relative weights before anything is fitted: a standard deviation of 0.3 %
/// of |Z|, as the thesis' repeats have.
const FIRST_NOISE: f64 = 1.0e-5;

/// A symmetric 2×2 matrix over (Re, Im): xx, xy, yy.
pub(crate) type Sym2 = [f64; 3];

/// The names of all errors that spectra share.
pub(super) fn names(spectra: &[Spectrum]) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for error in spectra.iter().flat_map(|spectrum| &spectrum.shared) {
        if !names.contains(&error.name.as_str()) {
            names.push(&error.name);
        }
    }
    names
}

/// Directions of a point, one per name.
pub(super) fn directions(spectrum: &Spectrum, index: usize, names: &[&str]) -> Vec<Complex64> {
    let of = |name: &&str| {
        spectrum
            .shared
            .iter()
            .find(|error| error.name == **name)?
            .at_ohm
            .get(index)
            .copied()
    };
    names
        .iter()
        .map(|name| of(name).unwrap_or(Complex64::ZERO))
        .collect()
}

/// Gives all points of one frequency the mean direction of each error that they have. A direction
/// that follows each point's own noise, or its own cell, would let the error shrink the data until
/// they agree (Peelle's puzzle; D'Agostini, Nucl. Instrum. Meth. A 346, 1994).
fn level(group: &mut [MeasuredPoint], count: usize) {
    for error in 0..count {
        let has = |seen: &&mut MeasuredPoint| seen.directions[error] != Complex64::ZERO;
        let (sum, number) = group
            .iter_mut()
            .filter(has)
            .fold((Complex64::ZERO, 0.0), |(sum, n), seen| {
                (sum + seen.directions[error], n + 1.0)
            });
        group
            .iter_mut()
            .filter(has)
            .for_each(|seen| seen.directions[error] = sum / number);
    }
}

/// The common errors of a problem.
#[derive(Debug, Clone, Default)]
pub(crate) struct Common {
    pub(super) names: Vec<String>,
    /// Direction of each error at each point, by group and point.
    directions: Vec<Vec<Vec<Complex64>>>,
    /// WD by group and error.
    pull: Vec<Vec<[f64; 2]>>,
    /// DᵀWz of the data.
    constant: Vec<f64>,
    /// DᵀWD, row by row.
    information: Vec<f64>,
    /// Cholesky factor of G.
    factor: Vec<f64>,
    /// λ.
    noise: f64,
}

/// A measured point as the common errors see it.
pub(super) struct MeasuredPoint {
    pub(super) z: Complex64,
    pub(super) weight: Sym2,
    pub(super) directions: Vec<Complex64>,
}

impl Common {
    /// Collects the common errors of the points of all groups; `None` without shared errors.
    pub(super) fn new(
        names: &[&str],
        groups: Vec<Vec<MeasuredPoint>>,
        absolute: bool,
    ) -> Option<Self> {
        let count = names.len();
        if count == 0 {
            return None;
        }
        let mut common = Self {
            names: names.iter().map(|name| (*name).to_owned()).collect(),
            constant: vec![0.0; count],
            information: vec![0.0; count * count],
            ..Self::default()
        };
        for mut group in groups {
            level(&mut group, count);
            let mut pull = vec![[0.0; 2]; count];
            for seen in &group {
                for (i, d) in seen.directions.iter().enumerate() {
                    let w = weighted(&seen.weight, *d);
                    pull[i] = [pull[i][0] + w[0], pull[i][1] + w[1]];
                    common.constant[i] += along(w, seen.z);
                    for (j, e) in seen.directions.iter().enumerate() {
                        common.information[i * count + j] += along(w, *e);
                    }
                }
            }
            common.pull.push(pull);
            common
                .directions
                .push(group.into_iter().map(|seen| seen.directions).collect());
        }
        common.set_noise(if absolute { 1.0 } else { FIRST_NOISE })?;
        Some(common)
    }

    /// Sets λ; `None` for numbers that do not give a valid matrix.
    pub(super) fn set_noise(&mut self, noise: f64) -> Option<()> {
        let n = self.count();
        let mut factor = self.information.clone();
        (0..n).for_each(|i| factor[i * n + i] += noise);
        self.noise = noise;
        cholesky(&mut factor, n).then(|| self.factor = factor)
    }

    pub(super) fn count(&self) -> usize {
        self.names.len()
    }

    /// Returns the best values of the errors for the model's impedances, group by group, and the
    /// amount by which they reduce the objective.
    pub(super) fn best(&self, model: &[Complex64]) -> (Vec<f64>, f64) {
        let mut b = self.constant.clone();
        for (pull, z) in self.pull.iter().zip(model) {
            b.iter_mut()
                .zip(pull)
                .for_each(|(b, pull)| *b -= along(*pull, *z));
        }
        let mut best = b.clone();
        cholesky_substitute(&self.factor, self.count(), &mut best);
        let taken = b.iter().zip(&best).map(|(b, a)| a * b).sum();
        (best, taken)
    }

    /// Returns the share of the objective that the common errors contribute. It is not a misfit of
    /// the data.
    pub(super) fn own_share(&self, best: &[f64]) -> f64 {
        self.noise * best.iter().map(|a| a * a).sum::<f64>()
    }

    /// Returns the gradient of this reduction over (Re, Im) of a group's impedance.
    pub(super) fn gradient(&self, group: usize, best: &[f64]) -> [f64; 2] {
        self.pull[group]
            .iter()
            .zip(best)
            .fold([0.0; 2], |[x, y], (pull, a)| {
                [x + 2.0 * a * pull[0], y + 2.0 * a * pull[1]]
            })
    }

    /// Adds a group's share of DᵀWJ, row by row: errors times parameters.
    pub(super) fn add_mixed(&self, group: usize, slopes: &[Complex64], mixed: &mut [f64]) {
        for (pull, row) in self.pull[group]
            .iter()
            .zip(mixed.chunks_exact_mut(slopes.len()))
        {
            row.iter_mut()
                .zip(slopes)
                .for_each(|(cell, slope)| *cell += along(*pull, *slope));
        }
    }

    /// Part of the Hessian of χ² that the errors remove: 2(DᵀWJ)ᵀG⁻¹(DᵀWJ), row by row.
    pub(super) fn taken_from_hessian(&self, mixed: &[f64], parameters: usize) -> Vec<f64> {
        let n = self.count();
        // Forward substitution by columns: L·Y = DᵀWJ.
        let mut y: Vec<f64> = mixed.iter().map(|v| SQRT_2 * v).collect();
        for i in 0..n {
            for k in 0..i {
                let l = self.factor[i * n + k];
                (0..parameters).for_each(|p| y[i * parameters + p] -= l * y[k * parameters + p]);
            }
            (0..parameters).for_each(|p| y[i * parameters + p] /= self.factor[i * n + i]);
        }
        let mut taken = vec![0.0; parameters * parameters];
        for row in y.chunks_exact(parameters) {
            for (p, a) in row.iter().enumerate() {
                row.iter()
                    .enumerate()
                    .for_each(|(q, b)| taken[p * parameters + q] += a * b);
            }
        }
        taken
    }

    /// Deviation of a point by the errors, Ω.
    pub(super) fn deviation(&self, group: usize, point: usize, best: &[f64]) -> Complex64 {
        self.directions[group][point]
            .iter()
            .zip(best)
            .map(|(d, a)| d * a)
            .sum()
    }

    /// Returns the variance of an error with all parameters free, in units of its own: the corner
    /// of the inverse of the whole normal matrix. `covariance` is that of the parameters, row by
    /// row, and `mixed` DᵀWJ over them.
    pub(super) fn variance(
        &self,
        error: usize,
        mixed: &[f64],
        covariance: &[f64],
        noise: f64,
    ) -> f64 {
        let n = self.count();
        let mut unit = vec![0.0; n];
        unit[error] = 1.0;
        cholesky_substitute(&self.factor, n, &mut unit);
        let parameters = mixed.len() / n.max(1);
        // G⁻¹ + (G⁻¹·DᵀWJ)·C·(G⁻¹·DᵀWJ)ᵀ.
        let row: Vec<f64> = (0..parameters)
            .map(|p| (0..n).map(|i| unit[i] * mixed[i * parameters + p]).sum())
            .collect();
        let by_parameters: f64 = (0..parameters)
            .map(|p| {
                (0..parameters)
                    .map(|q| row[p] * covariance[p * parameters + q] * row[q])
                    .sum::<f64>()
            })
            .sum();
        noise * unit[error] + by_parameters
    }
}

fn weighted(w: &Sym2, d: Complex64) -> [f64; 2] {
    [w[0] * d.re + w[1] * d.im, w[1] * d.re + w[2] * d.im]
}

fn along(w: [f64; 2], z: Complex64) -> f64 {
    w[0] * z.re + w[1] * z.im
}
