//! Relative changes of resistances from differences of impedances, by weighted least squares.

use analysis_numeric::linalg::invert;
use num_complex::Complex64;

/// Standard deviation of a relative change that is expected before anything is measured. It holds a
/// branch that the points do not determine, and moves the others by less than their noise.
const EXPECTED: f64 = 0.5;

/// One frequency.
pub(super) struct Data {
    /// Measured difference, Ω.
    pub(super) difference: Complex64,
    /// Standard deviation of its real and imaginary part, Ω.
    pub(super) noise: [f64; 2],
    /// Slope over the logarithm of each resistance, Ω.
    pub(super) slopes: Vec<Complex64>,
}

/// The changes that explain the differences best.
pub(super) struct Solution {
    /// Relative change of each resistance.
    pub(super) shares: Vec<f64>,
    /// Their covariance for the stated noise, row by row.
    covariance: Vec<f64>,
    /// χ² per degree of freedom.
    pub(super) chi2: f64,
}

impl Solution {
    /// Solves for `count` changes; `None` if the numbers do not determine them.
    pub(super) fn of(data: &[Data], count: usize) -> Option<Self> {
        let mut normal = vec![0.0; count * count];
        let mut right = vec![0.0; count];
        for point in data {
            for (part, noise) in point.noise.iter().enumerate() {
                let weight = noise.powi(-2);
                let row = |k: usize| part_of(point.slopes[k], part);
                for i in 0..count {
                    right[i] += weight * row(i) * part_of(point.difference, part);
                    (0..count).for_each(|j| normal[i * count + j] += weight * row(i) * row(j));
                }
            }
        }
        (0..count).for_each(|i| normal[i * count + i] += EXPECTED.powi(-2));
        let covariance = invert(&normal, count)?;
        let shares: Vec<f64> = (0..count)
            .map(|i| {
                (0..count)
                    .map(|j| covariance[i * count + j] * right[j])
                    .sum()
            })
            .collect();
        let mut solution = Self {
            shares,
            covariance,
            chi2: f64::NAN,
        };
        let freedom = (2 * data.len()).checked_sub(count).filter(|n| *n > 0)?;
        let squares = data
            .iter()
            .flat_map(|point| solution.miss(point))
            .map(|m| m * m);
        solution.chi2 = squares.sum::<f64>() / freedom as f64;
        Some(solution)
    }

    /// Returns what the changes leave of a difference, real and imaginary, in standard deviations of
    /// the stated noise.
    fn miss(&self, point: &Data) -> [f64; 2] {
        let explained: Complex64 = point
            .slopes
            .iter()
            .zip(&self.shares)
            .map(|(s, x)| s * x)
            .sum();
        let left = point.difference - explained;
        [left.re / point.noise[0], left.im / point.noise[1]]
    }

    /// Returns the factor of the stated variances: at least 1, more if the differences scatter more.
    fn factor(&self) -> f64 {
        self.chi2.max(1.0)
    }

    /// Returns the standard uncertainty of a change by the noise of this sweep alone.
    pub(super) fn sigma(&self, index: usize) -> f64 {
        let count = self.shares.len();
        (self.covariance[index * count + index] * self.factor()).sqrt()
    }

    /// Returns by how many standard uncertainties a point that was not used misses the prediction, real
    /// and imaginary.
    pub(super) fn prediction_error(&self, point: &Data) -> [f64; 2] {
        let count = self.shares.len();
        let miss = self.miss(point);
        let error = |part: usize| {
            let slope = |k: usize| part_of(point.slopes[k], part) / point.noise[part];
            let predicted: f64 = (0..count)
                .flat_map(|i| (0..count).map(move |j| (i, j)))
                .map(|(i, j)| slope(i) * self.covariance[i * count + j] * slope(j))
                .sum();
            miss[part] / ((1.0 + predicted) * self.factor()).sqrt()
        };
        [error(0), error(1)]
    }
}

fn part_of(z: Complex64, part: usize) -> f64 {
    if part == 0 { z.re } else { z.im }
}
