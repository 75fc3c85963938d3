//! Whittaker's smoother on any grid: a curve near the data with small second derivatives.
//! Generalised cross-validation chooses how small.
//!
//! The count of degrees of freedom is weighted by 1.4 (as penalised-spline practice has it), for
//! plain cross-validation of twenty points follows the noise now and then.

use nalgebra::{DMatrix, SymmetricEigen};

const PENALTY_ON_FREEDOM: f64 = 1.4;
const DECADES: i32 = 12;

/// The smoother of one grid.
#[derive(Debug)]
pub(super) struct Whittaker {
    vectors: DMatrix<f64>,
    roughness: Vec<f64>,
}

impl Whittaker {
    /// A smoother for rising places `x`, at least three.
    pub(super) fn new(x: &[f64]) -> Self {
        let n = x.len();
        let mut differences = DMatrix::zeros(n.saturating_sub(2), n);
        for k in 1..n.saturating_sub(1) {
            let (left, right) = (x[k] - x[k - 1], x[k + 1] - x[k]);
            let weight = 1.0 / (0.5 * (left + right)).sqrt();
            differences[(k - 1, k - 1)] = weight / left;
            differences[(k - 1, k)] = -weight * (1.0 / left + 1.0 / right);
            differences[(k - 1, k + 1)] = weight / right;
        }
        let eigen = SymmetricEigen::new(differences.transpose() * &differences);
        let roughness = eigen.eigenvalues.iter().map(|s| s.max(0.0)).collect();
        Self {
            vectors: eigen.eigenvectors,
            roughness,
        }
    }

    /// The matrix that smooths data like these, and its degrees of freedom.
    pub(super) fn matrix(&self, y: &[f64]) -> (DMatrix<f64>, f64) {
        let n = y.len();
        let spectrum: Vec<f64> = (0..n)
            .map(|k| {
                self.vectors
                    .column(k)
                    .iter()
                    .zip(y)
                    .map(|(v, y)| v * y)
                    .sum()
            })
            .collect();
        let greatest = self.roughness.iter().fold(0.0, |a: f64, b| a.max(*b));
        let score = |lambda: f64| {
            let (mut rss, mut freedom) = (0.0, 0.0);
            for (s, c) in self.roughness.iter().zip(&spectrum) {
                let kept = 1.0 / (1.0 + lambda * s);
                rss += ((1.0 - kept) * c).powi(2);
                freedom += kept;
            }
            let left = n as f64 - PENALTY_ON_FREEDOM * freedom;
            if left > 0.0 {
                rss / (left * left)
            } else {
                f64::INFINITY
            }
        };
        let candidates = (0..4 * DECADES).map(|k| 10f64.powf(f64::from(k) / 4.0) / greatest);
        let lambda = candidates
            .min_by(|a, b| score(*a).total_cmp(&score(*b)))
            .unwrap_or(0.0);
        let kept: Vec<f64> = self
            .roughness
            .iter()
            .map(|s| 1.0 / (1.0 + lambda * s))
            .collect();
        let scaled = DMatrix::from_fn(n, n, |i, k| self.vectors[(i, k)] * kept[k]);
        (scaled * self.vectors.transpose(), kept.iter().sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Rng;

    #[test]
    fn lines_stay_and_noise_goes() {
        let x: Vec<f64> = (0..40)
            .map(|k| f64::from(k) * 0.3 + 0.1 * f64::from(k % 3))
            .collect();
        let smoother = Whittaker::new(&x);
        let mut rng = Rng::new(5);
        let line: Vec<f64> = x.iter().map(|x| 3.0 - 0.5 * x).collect();
        let noisy: Vec<f64> = line
            .iter()
            .map(|y| y + 0.2 * (rng.uniform() - 0.5))
            .collect();
        let (matrix, freedom) = smoother.matrix(&noisy);
        let smooth = |y: &[f64]| -> Vec<f64> {
            (0..40)
                .map(|i| (0..40).map(|k| matrix[(i, k)] * y[k]).sum())
                .collect()
        };
        for (met, expected) in smooth(&line).iter().zip(&line) {
            assert!((met - expected).abs() < 1e-4, "{met} {expected}");
        }
        let rms = |y: &[f64]| {
            (y.iter()
                .zip(&line)
                .map(|(a, b)| (a - b).powi(2))
                .sum::<f64>()
                / 40.0)
                .sqrt()
        };
        assert!(
            rms(&smooth(&noisy)) < 0.5 * rms(&noisy),
            "{} of {}",
            rms(&smooth(&noisy)),
            rms(&noisy)
        );
        assert!((1.99..8.0).contains(&freedom), "{freedom}");
    }
}
