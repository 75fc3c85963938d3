//! Information of the data on the parameters at an optimum, for any model: one implementation for
//! the extended Randles model and for circuits.
//!
//! With weights that are inverse covariances: (JᵀWJ)⁻¹, widened by the reduced χ² where that
//! exceeds one (Birge's ratio). Without them, if neither cells nor enough sweeps determine the
//! noise: noise proportional to |Z|, its size from the residuals. Otherwise the sandwich H⁻¹BH⁻¹ of
//! an M-estimator (Huber, 1967), H the Hessian of the objective and B the scatter of its gradient
//! over whole cells, or over whole sweeps where cells are not known (Liang and Zeger, 1986), times
//! G/(G − 1) for G of them: the points of one sweep share its cell and its contacts. (Over the
//! points of one sweep of 20 the sandwich was measured to state two thirds of the scatter of
//! repeats, and over 25 sweeps of five cells half of the scatter of the cells.)

use super::clusters::Clusters;
use super::common::Sym2;
use super::options::Objective;
use num_complex::Complex64;
use std::f64::consts::FRAC_PI_2;

/// Corner of the norm, in median residuals, for the Hessian of a sum of norms over many spectra.
/// The fit runs right through some points, whose curvature 1/|r| says nothing of the noise. For
/// normal noise this corner makes the sigmas 3 % large; rounding the gradients too, 0.5 with both
/// once made them 6 % small.
pub(super) const NORM_CORNER: f64 = 0.25;

/// The same over few cells. Their sweeps lie in lumps, and the fit in one of them or between two:
/// the curvature of a sharp norm there says nothing (it once stated 2.4 times the scatter of
/// simulated pools of six cells). Gradients are rounded with it, so that both are of one smooth
/// norm.
pub(super) const CELL_CORNER: f64 = 1.0;

/// One point at the optimum.
pub(super) struct PointShare {
    /// Norm of the weighted residual, as the objective's weight has it.
    pub(super) norm: f64,
    /// Size to which the noise of that norm is proportional: |Z| for residuals in Ω, one for
    /// residuals relative to it.
    pub(super) size: f64,
    /// The weight of the squared residual.
    pub(super) weight: Sym2,
    /// Gradient of the point's share of the objective over (Re, Im) of the model.
    pub(super) gradient: [f64; 2],
    /// Index of the spectrum it came from.
    pub(super) spectrum: usize,
}

/// One frequency at the optimum.
pub(super) struct FrequencyShare {
    /// Slopes of the model over the free variables.
    pub(super) slopes: Vec<Complex64>,
    /// Weight of squares: half the Hessian over (Re, Im) of the objective's share, the residuals'
    /// own curvature left out.
    pub(super) weight: Sym2,
    pub(super) points: Vec<PointShare>,
}

/// The optimum.
pub(super) struct Evidence<'a> {
    pub(super) kind: Objective,
    /// True if the weights are inverse covariances and the objective is a χ².
    pub(super) absolute_weights: bool,
    /// Value of the objective.
    pub(super) value: f64,
    /// Independent numbers, and these minus the fitted parameters.
    pub(super) numbers: f64,
    pub(super) freedom: f64,
    pub(super) clusters: &'a Clusters,
    /// Rising frequency.
    pub(super) frequencies: Vec<FrequencyShare>,
    /// Information that errors shared by points remove, row by row.
    pub(super) shared: Option<Vec<f64>>,
}

/// The covariance `factor`·A⁻¹, or `factor`·A⁻¹BA⁻¹; the caller inverts. `factor` is absent if
/// nothing determines the noise.
pub(super) struct Normal {
    /// A, row by row.
    pub(super) bread: Vec<f64>,
    /// B, row by row.
    pub(super) meat: Option<Vec<f64>>,
    pub(super) factor: Option<f64>,
}

impl Evidence<'_> {
    /// `hessian` is the objective's over the free variables, exact, for a corner of the norm.
    pub(super) fn normal(&self, hessian: impl Fn(f64) -> Vec<f64>) -> Normal {
        let squares = |factor: Option<f64>| Normal {
            bread: self.left_information(),
            meat: None,
            factor,
        };
        if self.absolute_weights {
            let widening = if self.freedom > 0.0 {
                (self.value / self.freedom).max(1.0)
            } else {
                1.0
            };
            return squares(Some(2.0 * widening));
        }
        if self.freedom <= 0.0 {
            return squares(None);
        }
        let clustered = self.clusters.tell_noise(self.variables());
        let few = self.numbers / self.freedom;
        match self.kind {
            Objective::Complex if !clustered => squares(Some(2.0 * self.value / self.freedom)),
            Objective::SumAbs if !clustered => self.norms_under_noise(few),
            _ => {
                let count = self.clusters.count as f64;
                let factor = if clustered {
                    count / (count - 1.0) * few
                } else {
                    few
                };
                let (corner, rounding) = match self.kind {
                    Objective::SumAbs if self.clusters.cells().is_some() => (
                        CELL_CORNER * self.median_norm(),
                        CELL_CORNER * self.median_norm(),
                    ),
                    Objective::SumAbs => (NORM_CORNER * self.median_norm(), 0.0),
                    _ => (0.0, 0.0),
                };
                Normal {
                    bread: hessian(corner),
                    meat: Some(self.gradient_scatter(clustered, rounding)),
                    factor: Some(factor),
                }
            }
        }
    }

    /// Returns 2JᵀWJ less the part that common errors remove.
    fn left_information(&self) -> Vec<f64> {
        let mut left = self.information(|f| f.weight);
        if let Some(taken) = &self.shared {
            left.iter_mut()
                .zip(taken)
                .for_each(|(left, taken)| *left -= taken);
        }
        left
    }

    fn variables(&self) -> usize {
        self.frequencies.first().map_or(0, |f| f.slopes.len())
    }

    /// Median norm of the weighted residuals.
    fn median_norm(&self) -> f64 {
        let mut norms: Vec<f64> = self
            .frequencies
            .iter()
            .flat_map(|f| &f.points)
            .map(|p| p.norm)
            .collect();
        norms.sort_by(f64::total_cmp);
        norms.get(norms.len() / 2).copied().unwrap_or(0.0)
    }

    /// Hessian and gradient scatter of a sum of norms under normal noise of a known shape, equal in
    /// both weighted parts: with σ per part the mean of 1/|r| is √(π/2)/σ, and |r| itself has the
    /// mean σ√(π/2), from which σ is read. `excess` is numbers over degrees of freedom.
    fn norms_under_noise(&self, excess: f64) -> Normal {
        let points = || self.frequencies.iter().flat_map(|f| &f.points);
        let mean = points().map(|p| p.norm / p.size).sum::<f64>() / points().count().max(1) as f64;
        let sigma = mean * excess.sqrt() / FRAC_PI_2.sqrt();
        // [`Self::information`] doubles what it is given.
        let sum = |f: &FrequencyShare, by: &dyn Fn(&PointShare) -> f64| {
            f.points.iter().fold([0.0; 3], |sum: Sym2, p| {
                std::array::from_fn(|i| sum[i] + 0.25 * by(p) * p.weight[i])
            })
        };
        let curvature = |p: &PointShare| FRAC_PI_2.sqrt() / (sigma * p.size).max(1e-150);
        let bread = self.information(|f| sum(f, &curvature));
        Normal {
            bread,
            meat: Some(self.information(|f| sum(f, &|_| 1.0))),
            factor: Some(1.0),
        }
    }

    /// 2JᵀWJ, W by frequency.
    fn information(&self, weight: impl Fn(&FrequencyShare) -> Sym2) -> Vec<f64> {
        let m = self.variables();
        let mut sum = vec![0.0; m * m];
        for f in &self.frequencies {
            let [xx, xy, yy] = weight(f);
            for (i, a) in f.slopes.iter().enumerate() {
                for (j, b) in f.slopes.iter().enumerate() {
                    sum[i * m + j] += 2.0
                        * (xx * a.re * b.re + xy * (a.re * b.im + a.im * b.re) + yy * a.im * b.im);
                }
            }
        }
        sum
    }

    /// Σ gᵢgᵢᵀ over the gradients of the objective's shares: of whole clusters, or of single
    /// points. `rounding` is the corner of a norm; the optimum is not that of the rounded one, so
    /// that the clusters' mean is taken off.
    fn gradient_scatter(&self, clustered: bool, rounding: f64) -> Vec<f64> {
        let m = self.variables();
        let mut shares = vec![vec![0.0; m]; if clustered { self.clusters.count } else { 0 }];
        for f in &self.frequencies {
            for p in &f.points {
                let blunt = if rounding > 0.0 {
                    p.norm / p.norm.hypot(rounding)
                } else {
                    1.0
                };
                let [gx, gy] = p.gradient.map(|g| g * blunt);
                let share: Vec<f64> = f.slopes.iter().map(|s| gx * s.re + gy * s.im).collect();
                if clustered {
                    let cluster = &mut shares[self.clusters.of(p.spectrum)];
                    cluster
                        .iter_mut()
                        .zip(&share)
                        .for_each(|(sum, s)| *sum += s);
                } else {
                    shares.push(share);
                }
            }
        }
        if rounding > 0.0 {
            let mean: Vec<f64> = (0..m)
                .map(|i| shares.iter().map(|g| g[i]).sum::<f64>() / shares.len() as f64)
                .collect();
            shares
                .iter_mut()
                .for_each(|g| g.iter_mut().zip(&mean).for_each(|(g, mean)| *g -= mean));
        }
        let mut sum = vec![0.0; m * m];
        for g in &shares {
            (0..m * m).for_each(|ij| sum[ij] += g[ij / m] * g[ij % m]);
        }
        sum
    }
}
