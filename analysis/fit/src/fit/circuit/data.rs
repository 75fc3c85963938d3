//! The data of a circuit's fit: points of equal frequency pooled, with weights, and the three
//! objectives as functions of the model's impedance.

use super::options::{CircuitFitError, CircuitOptions, Weight};
use crate::fit::{
    clusters::Clusters,
    common::{self, Common, MeasuredPoint},
    options::{Objective, check_spectra},
};
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use num_complex::Complex64;

/// A symmetric 2×2 matrix over (Re, Im): xx, xy, yy.
pub(super) type Sym2 = [f64; 3];

/// One measured point.
#[derive(Debug, Clone, Copy)]
pub(super) struct DataPoint {
    pub(super) z: Complex64,
    /// Weight of the squared complex residual.
    pub(super) weight: Sym2,
    /// Weight of the squared residual of the magnitude.
    weight_abs: f64,
    /// Index of the spectrum it came from.
    pub(super) spectrum: usize,
}

/// All points of one frequency; for the quadratic objectives their mean and scatter suffice.
#[derive(Debug, Clone)]
pub(super) struct Group {
    pub(super) freq_hz: f64,
    pub(super) points: Vec<DataPoint>,
    pub(super) weight: Sym2,
    pub(super) mean: Complex64,
    scatter: f64,
    weight_abs: f64,
    mean_abs: f64,
    scatter_abs: f64,
}

/// Data, objective and weight.
#[derive(Debug, Clone)]
pub(super) struct Data {
    pub(super) groups: Vec<Group>,
    pub(super) objective: Objective,
    pub(super) weight: Weight,
    pub(super) points: usize,
    /// Points with a usable covariance.
    pub(super) known: usize,
    pub(super) clusters: Clusters,
    /// Median of the weighted |Z|: the natural size of the objective's residuals.
    pub(super) scale: f64,
    /// Errors that points share; for complex least squares over measured covariances only.
    pub(super) common: Option<Common>,
}

/// Value, gradient and Hessian of an objective's share over (Re, Im) of the model's impedance.
pub(super) struct Share {
    pub(super) value: f64,
    pub(super) gradient: [f64; 2],
    pub(super) hessian: Sym2,
}

impl Data {
    pub(super) fn new(
        spectra: &[Spectrum],
        clusters: Clusters,
        options: &CircuitOptions,
    ) -> Result<Self, CircuitFitError> {
        check_spectra(spectra)?;
        let all = || {
            spectra
                .iter()
                .enumerate()
                .flat_map(|(i, s)| s.points.iter().map(move |p| (i, p)))
        };
        let (points, known) = (
            all().count(),
            all()
                .filter(|(_, p)| inverse_covariance(&p.covariance).is_some())
                .count(),
        );
        let default = match options.objective {
            Objective::Complex if known == points => Weight::Covariance,
            Objective::Complex => Weight::Modulus,
            Objective::SumAbs | Objective::Modulus => Weight::Unit,
        };
        let weight = options.weight.unwrap_or(default);
        if weight == Weight::Covariance && known < points {
            return Err(CircuitFitError::UnknownCovariance { known, points });
        }
        let carried = weight == Weight::Covariance && options.objective == Objective::Complex;
        let names = if carried {
            common::names(spectra)
        } else {
            Vec::new()
        };
        let one = |(i, s): (usize, &Spectrum), (k, p): (usize, &ImpedancePoint)| {
            let covariance = if names.is_empty() {
                p.covariance
            } else {
                s.own_covariance(k)
            };
            let point = DataPoint::new(&ImpedancePoint { covariance, ..*p }, weight, i);
            let seen = MeasuredPoint {
                z: p.z_ohm,
                weight: point.weight,
                directions: common::directions(s, k, &names),
            };
            (p.freq_hz, point, seen)
        };
        let mut tagged: Vec<(f64, DataPoint, MeasuredPoint)> = spectra
            .iter()
            .enumerate()
            .flat_map(|(i, s)| {
                s.points
                    .iter()
                    .enumerate()
                    .map(move |point| ((i, s), point))
            })
            .map(|(spectrum, point)| one(spectrum, point))
            .collect();
        tagged.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut norms: Vec<f64> = tagged
            .iter()
            .map(|(_, p, _)| quadratic(&p.weight, p.z).sqrt())
            .collect();
        norms.sort_by(f64::total_cmp);
        let scale = norms.get(norms.len() / 2).copied().unwrap_or(1.0);
        let mut groups: Vec<Group> = Vec::new();
        let mut seen: Vec<Vec<MeasuredPoint>> = Vec::new();
        for (freq_hz, point, as_seen) in tagged {
            match (groups.last_mut(), seen.last_mut()) {
                // Files print frequencies with few significant digits. A difference in the tenth
                // digit is the same frequency.
                (Some(group), Some(all))
                    if (freq_hz - group.freq_hz).abs() <= 1e-10 * group.freq_hz =>
                {
                    group.points.push(point);
                    all.push(as_seen);
                }
                _ => {
                    groups.push(Group::open(freq_hz, point));
                    seen.push(vec![as_seen]);
                }
            }
        }
        groups.iter_mut().for_each(Group::close);
        let common = Common::new(&names, seen, true);
        Ok(Self {
            groups,
            objective: options.objective,
            weight,
            points,
            known,
            clusters,
            scale,
            common,
        })
    }

    /// All points of a frequency are the same.
    pub(super) fn is_repeated(&self) -> bool {
        self.groups.iter().all(|g| {
            g.points
                .iter()
                .all(|p| g.points.first().is_some_and(|first| first.z == p.z))
        })
    }

    /// The objective is a χ²: squares in standard deviations.
    pub(super) fn is_chi2(&self) -> bool {
        self.weight == Weight::Covariance && self.objective != Objective::SumAbs
    }

    /// Independent numbers among the data.
    pub(super) fn numbers(&self) -> usize {
        if self.objective == Objective::Modulus {
            self.points
        } else {
            2 * self.points
        }
    }

    /// Value of one frequency's share; `corner` rounds the norm off, in units of the weighted
    /// residual.
    pub(super) fn value(&self, g: &Group, z: Complex64, corner: f64) -> f64 {
        match self.objective {
            Objective::SumAbs => g
                .points
                .iter()
                .map(|p| (quadratic(&p.weight, z - p.z) + corner * corner).sqrt())
                .sum(),
            Objective::Modulus => g.weight_abs * (z.norm() - g.mean_abs).powi(2) + g.scatter_abs,
            Objective::Complex => quadratic(&g.weight, z - g.mean) + g.scatter,
        }
    }

    /// Returns value and derivatives of one frequency's share. Without `exact` the Hessian of |Z|
    /// omits the terms that change sign with the residual (Gauss and Newton), so that it is never
    /// indefinite.
    pub(super) fn share(&self, g: &Group, z: Complex64, corner: f64, exact: bool) -> Share {
        match self.objective {
            Objective::SumAbs => norms_share(g, z, corner),
            Objective::Modulus => {
                let (m, excess) = (z.norm(), z.norm() - g.mean_abs);
                let (ux, uy) = (z.re / m, z.im / m);
                let along = 2.0 * g.weight_abs;
                let across = if exact { along * excess / m } else { 0.0 };
                Share {
                    value: g.weight_abs * excess * excess + g.scatter_abs,
                    gradient: [along * excess * ux, along * excess * uy],
                    hessian: [
                        along * ux * ux + across * uy * uy,
                        (along - across) * ux * uy,
                        along * uy * uy + across * ux * ux,
                    ],
                }
            }
            Objective::Complex => {
                let r = z - g.mean;
                let hessian = g.weight.map(|w| 2.0 * w);
                let gradient = apply(&hessian, r);
                Share {
                    value: quadratic(&g.weight, r) + g.scatter,
                    gradient,
                    hessian,
                }
            }
        }
    }

    /// Gradient of one point's share.
    pub(super) fn point_gradient(&self, p: &DataPoint, z: Complex64) -> [f64; 2] {
        let r = z - p.z;
        match self.objective {
            Objective::SumAbs => {
                let s = quadratic(&p.weight, r).sqrt().max(f64::MIN_POSITIVE);
                apply(&p.weight, r).map(|g| g / s)
            }
            Objective::Modulus => {
                let pull = 2.0 * p.weight_abs * (z.norm() - p.z.norm()) / z.norm();
                [pull * z.re, pull * z.im]
            }
            Objective::Complex => apply(&p.weight, r).map(|g| 2.0 * g),
        }
    }
}

impl DataPoint {
    fn new(p: &ImpedancePoint, weight: Weight, spectrum: usize) -> Self {
        let relative = p.z_ohm.norm_sqr().recip();
        let (weight, weight_abs) = match weight {
            Weight::Unit => ([1.0, 0.0, 1.0], 1.0),
            Weight::Modulus => ([relative, 0.0, relative], relative),
            // Checked before: there is a covariance.
            Weight::Covariance => (
                inverse_covariance(&p.covariance).unwrap_or([relative, 0.0, relative]),
                p.magnitude_sigma_ohm().powi(-2),
            ),
        };
        Self {
            z: p.z_ohm,
            weight,
            weight_abs,
            spectrum,
        }
    }
}

impl Group {
    fn open(freq_hz: f64, first: DataPoint) -> Self {
        let (zero, none) = (Complex64::ZERO, [0.0; 3]);
        Self {
            freq_hz,
            points: vec![first],
            weight: none,
            mean: zero,
            scatter: 0.0,
            weight_abs: 0.0,
            mean_abs: 0.0,
            scatter_abs: 0.0,
        }
    }

    /// Means first, then sums of squares about them: no significant digits are lost by
    /// cancellation.
    fn close(&mut self) {
        let (mut bx, mut by, mut sum_abs) = (0.0, 0.0, 0.0);
        for p in &self.points {
            self.weight = std::array::from_fn(|i| self.weight[i] + p.weight[i]);
            self.weight_abs += p.weight_abs;
            let [x, y] = apply(&p.weight, p.z);
            (bx, by, sum_abs) = (bx + x, by + y, sum_abs + p.weight_abs * p.z.norm());
        }
        let [xx, xy, yy] = self.weight;
        let det = xx * yy - xy * xy;
        self.mean = Complex64::new((yy * bx - xy * by) / det, (xx * by - xy * bx) / det);
        self.mean_abs = sum_abs / self.weight_abs;
        self.scatter = self
            .points
            .iter()
            .map(|p| quadratic(&p.weight, p.z - self.mean))
            .sum();
        self.scatter_abs = self
            .points
            .iter()
            .map(|p| p.weight_abs * (p.z.norm() - self.mean_abs).powi(2))
            .sum();
    }
}

fn norms_share(g: &Group, z: Complex64, corner: f64) -> Share {
    let mut share = Share {
        value: 0.0,
        gradient: [0.0; 2],
        hessian: [0.0; 3],
    };
    for p in &g.points {
        let r = z - p.z;
        let s = (quadratic(&p.weight, r) + corner * corner).sqrt();
        share.value += s;
        // At a point met exactly the norm has a corner: zero is a subgradient there.
        if s > 0.0 {
            let [x, y] = apply(&p.weight, r).map(|g| g / s);
            let [xx, xy, yy] = p.weight;
            share.gradient = [share.gradient[0] + x, share.gradient[1] + y];
            let add = [(xx - x * x) / s, (xy - x * y) / s, (yy - y * y) / s];
            share.hessian = std::array::from_fn(|i| share.hessian[i] + add[i]);
        }
    }
    share
}

/// rᵀWr.
pub(super) fn quadratic(w: &Sym2, r: Complex64) -> f64 {
    w[0] * r.re * r.re + 2.0 * w[1] * r.re * r.im + w[2] * r.im * r.im
}

/// W·r.
pub(super) fn apply(w: &Sym2, r: Complex64) -> [f64; 2] {
    [w[0] * r.re + w[1] * r.im, w[1] * r.re + w[2] * r.im]
}

/// Inverse of a covariance, 1/Ω²; none where it is unknown or not positive definite.
fn inverse_covariance(c: &Covariance2) -> Option<Sym2> {
    let det = c.re_re * c.im_im - c.re_im * c.re_im;
    let good = c.re_re > 0.0 && c.im_im > 0.0 && det > 0.0 && det.is_finite();
    good.then(|| [c.im_im / det, -c.re_im / det, c.re_re / det])
}
