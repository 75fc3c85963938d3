//! Points of equal frequency pooled, with their weights, and the three objectives as functions of
//! the model's impedance: one implementation for the extended Randles model and for circuits.
//!
//! A model is evaluated once per distinct frequency, however many sweeps are pooled. The two
//! quadratic objectives need only each frequency's mean and scatter; the sum of norms needs every
//! point.

use super::common::{Common, MeasuredPoint, Sym2};
use super::options::Objective;
use analysis_numeric::Covariance2;
use num_complex::Complex64;

/// One measured point with its weights.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DataPoint {
    pub(crate) z: Complex64,
    /// Weight of the squared complex residual; the identity if the objective has no weights.
    pub(crate) weight: Sym2,
    /// Weight of the squared residual of the magnitude.
    pub(crate) weight_abs: f64,
    /// Index of the spectrum it came from.
    pub(crate) spectrum: usize,
}

/// A point with its frequency, and as the common errors see it.
pub(super) struct TaggedPoint {
    pub(super) freq_hz: f64,
    pub(super) point: DataPoint,
    pub(super) seen: MeasuredPoint,
}

/// All points of one frequency.
#[derive(Debug, Clone)]
pub(crate) struct Group {
    pub(crate) freq_hz: f64,
    pub(crate) points: Vec<DataPoint>,
    /// Sum of the weights.
    pub(crate) weight: Sym2,
    /// Weighted mean.
    pub(crate) mean: Complex64,
    /// Weighted sum of squares about the mean: the part no model can remove.
    pub(crate) scatter: f64,
    weight_abs: f64,
    /// Weighted mean of |Z|, and the sum of squares about it.
    pub(crate) mean_abs: f64,
    pub(crate) scatter_abs: f64,
}

/// Value, gradient and Hessian of an objective's share over (Re, Im) of the model's impedance.
pub(super) struct Share {
    pub(super) value: f64,
    pub(super) gradient: [f64; 2],
    pub(super) hessian: Sym2,
}

/// Pooled data and the objective.
#[derive(Debug, Clone)]
pub(crate) struct Pooled {
    /// Rising frequency.
    pub(crate) groups: Vec<Group>,
    pub(crate) kind: Objective,
    pub(crate) points: usize,
    /// Errors that points share; for complex least squares only.
    pub(crate) common: Option<Common>,
}

impl Pooled {
    /// Pools points. `names` are those of their common errors; `absolute` states that the weights
    /// are inverse covariances.
    pub(super) fn new(
        kind: Objective,
        mut tagged: Vec<TaggedPoint>,
        names: &[&str],
        absolute: bool,
    ) -> Self {
        tagged.sort_by(|a, b| a.freq_hz.total_cmp(&b.freq_hz));
        let points = tagged.len();
        let mut groups: Vec<Group> = Vec::new();
        let mut seen: Vec<Vec<MeasuredPoint>> = Vec::new();
        for one in tagged {
            match (groups.last_mut(), seen.last_mut()) {
                // Files print frequencies with few significant digits. A difference in the tenth
                // digit is the same frequency.
                (Some(group), Some(all))
                    if (one.freq_hz - group.freq_hz).abs() <= 1e-10 * group.freq_hz =>
                {
                    group.points.push(one.point);
                    all.push(one.seen);
                }
                _ => {
                    groups.push(Group::open(one.freq_hz, one.point));
                    seen.push(vec![one.seen]);
                }
            }
        }
        groups.iter_mut().for_each(Group::close);
        Self {
            groups,
            kind,
            points,
            common: Common::new(names, seen, absolute),
        }
    }

    /// Value of one frequency's share; `corner` rounds the norm off, in units of the weighted
    /// residual.
    pub(super) fn share_value(&self, g: &Group, z: Complex64, corner: f64) -> f64 {
        match self.kind {
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
        match self.kind {
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
                Share {
                    value: quadratic(&g.weight, r) + g.scatter,
                    gradient: apply(&hessian, r),
                    hessian,
                }
            }
        }
    }

    /// Gradient of one point's share with respect to (Re z, Im z).
    pub(super) fn point_gradient(&self, p: &DataPoint, z: Complex64, corner: f64) -> [f64; 2] {
        let r = z - p.z;
        match self.kind {
            Objective::SumAbs => {
                let s = (quadratic(&p.weight, r) + corner * corner)
                    .sqrt()
                    .max(f64::MIN_POSITIVE);
                apply(&p.weight, r).map(|g| g / s)
            }
            Objective::Modulus => {
                let pull = 2.0 * p.weight_abs * (z.norm() - p.z.norm()) / z.norm();
                [pull * z.re, pull * z.im]
            }
            Objective::Complex => apply(&p.weight, r).map(|g| 2.0 * g),
        }
    }

    /// Value of the objective for the model's impedances, group by group.
    pub(super) fn value_of(&self, model: &[Complex64], corner: f64) -> f64 {
        let shares = self.groups.iter().zip(model);
        let apart: f64 = shares.map(|(g, z)| self.share_value(g, *z, corner)).sum();
        let common = self.common.as_ref();
        apart - common.map_or(0.0, |common| common.best(model).1)
    }

    /// Impedances of the model as each point of each group sees them, with the common errors at
    /// their best, Ω.
    pub(super) fn seen_of(&self, model: &[Complex64]) -> Vec<Vec<Complex64>> {
        let common = self.common.as_ref();
        let best = common.map(|common| (common, common.best(model).0));
        let off = |group: usize, point: usize| {
            best.as_ref().map_or(Complex64::ZERO, |(common, best)| {
                common.deviation(group, point, best)
            })
        };
        let of = |(group, g): (usize, &Group)| {
            (0..g.points.len())
                .map(|point| model[group] + off(group, point))
                .collect()
        };
        self.groups.iter().enumerate().map(of).collect()
    }

    /// Root mean square of the residuals of impedances as the points see them, Ω.
    pub(super) fn rms_ohm(&self, seen: &[Vec<Complex64>]) -> f64 {
        let square = |(g, seen): (&Group, &Vec<Complex64>)| {
            let points = g.points.iter().zip(seen);
            points.map(|(p, z)| (z - p.z).norm_sqr()).sum::<f64>()
        };
        let squares = self.groups.iter().zip(seen).map(square).sum::<f64>();
        (squares / self.points as f64).sqrt()
    }
}

/// An expansion of the objective over the variables of a model, summed up frequency by frequency.
pub(super) struct Expansion<'a> {
    value: f64,
    gradient: &'a mut [f64],
    /// Its lower half, row by row.
    pub(super) hessian: &'a mut [f64],
    /// The common errors at their best, and what they take from the objective.
    best: Option<(&'a Common, (Vec<f64>, f64))>,
    mixed: Vec<f64>,
}

impl<'a> Expansion<'a> {
    /// Begins at zero. `model` computes the impedances of the model, which only common errors need.
    pub(super) fn begin(
        pooled: &'a Pooled,
        model: impl FnOnce() -> Vec<Complex64>,
        gradient: &'a mut [f64],
        hessian: &'a mut [f64],
    ) -> Self {
        gradient.fill(0.0);
        hessian.fill(0.0);
        let best = pooled.common.as_ref();
        let best = best.map(|common| (common, common.best(&model())));
        let count = pooled.common.as_ref().map_or(0, Common::count);
        Self {
            value: 0.0,
            mixed: vec![0.0; count * gradient.len()],
            gradient,
            hessian,
            best,
        }
    }

    /// Adds the share of a frequency by its number and the slopes of the model there. Returns the
    /// gradient over (Re, Im) of the model's impedance.
    pub(super) fn add(&mut self, number: usize, share: &Share, slopes: &[Complex64]) -> [f64; 2] {
        let n = self.gradient.len();
        let [mut gx, mut gy] = share.gradient;
        let [xx, xy, yy] = share.hessian;
        self.value += share.value;
        if let Some((common, (best, _))) = &self.best {
            let [x, y] = common.gradient(number, best);
            (gx, gy) = (gx + x, gy + y);
            common.add_mixed(number, slopes, &mut self.mixed);
        }
        for (i, s) in slopes.iter().enumerate() {
            self.gradient[i] += gx * s.re + gy * s.im;
            let (hx, hy) = (xx * s.re + xy * s.im, xy * s.re + yy * s.im);
            for (j, t) in slopes[..=i].iter().enumerate() {
                self.hessian[i * n + j] += hx * t.re + hy * t.im;
            }
        }
        [gx, gy]
    }

    /// Completes the Hessian. Returns the value.
    pub(super) fn end(self) -> f64 {
        let (n, mut value) = (self.gradient.len(), self.value);
        if let Some((common, (_, taken))) = &self.best {
            value -= taken;
            self.hessian
                .iter_mut()
                .zip(common.taken_from_hessian(&self.mixed, n))
                .for_each(|(h, taken)| *h -= taken);
        }
        for i in 0..n {
            for j in 0..i {
                self.hessian[j * n + i] = self.hessian[i * n + j];
            }
        }
        value
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

impl Group {
    fn open(freq_hz: f64, first: DataPoint) -> Self {
        Self {
            freq_hz,
            points: vec![first],
            weight: [0.0; 3],
            mean: Complex64::ZERO,
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

/// rᵀWr.
pub(crate) fn quadratic(w: &Sym2, r: Complex64) -> f64 {
    w[0] * r.re * r.re + 2.0 * w[1] * r.re * r.im + w[2] * r.im * r.im
}

/// W·r.
pub(super) fn apply(w: &Sym2, r: Complex64) -> [f64; 2] {
    [w[0] * r.re + w[1] * r.im, w[1] * r.re + w[2] * r.im]
}

/// Inverse of a point's covariance, 1/Ω²; `None` if it is unknown or not positive definite.
pub(super) fn inverse_covariance(c: &Covariance2) -> Option<Sym2> {
    let det = c.re_re * c.im_im - c.re_im * c.re_im;
    let good = c.re_re > 0.0 && c.im_im > 0.0 && det > 0.0 && det.is_finite();
    good.then(|| [c.im_im / det, -c.re_im / det, c.re_re / det])
}

/// Rows and columns of the free variables of a square matrix of `n` rows, row by row.
pub(super) fn of_free(matrix: &[f64], n: usize, free: &[usize]) -> Vec<f64> {
    let rows = free.iter().map(|i| &matrix[i * n..][..n]);
    rows.flat_map(|row| free.iter().map(|j| row[*j])).collect()
}
