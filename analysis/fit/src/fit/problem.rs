//! The data of a fit, points of equal frequency pooled, and the three objectives with their exact
//! derivatives.
//!
//! The model is evaluated once per distinct frequency, however many sweeps are pooled. The two
//! quadratic objectives need only each frequency's mean and scatter; the sum of norms needs every
//! point.

use super::common::{self, Common, MeasuredPoint, Sym2};
use super::options::Objective;
use crate::sizes::weight_sizes_ohm;
use analysis_model::model::{Erm, RcBranch};
use analysis_numeric::{Covariance2, Smooth};
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// One measured point with its weight.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DataPoint {
    pub(crate) z: Complex64,
    /// Weight of the squared residual; the identity if the objective has no weights.
    pub(crate) weight: Sym2,
    /// Index of the spectrum it came from.
    pub(crate) spectrum: usize,
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
    /// Mean of |Z|, and the sum of squares about it.
    pub(crate) mean_abs: f64,
    pub(crate) scatter_abs: f64,
}

/// Function to minimise: data, objective, smoothing.
#[derive(Debug, Clone)]
pub(crate) struct Problem {
    pub(crate) groups: Vec<Group>,
    pub(crate) kind: Objective,
    /// True when the weights are inverse covariances, so that the objective is a χ².
    pub(crate) absolute_weights: bool,
    /// Corner of the smoothed norm √(|r|² + ε²), Ω; zero for the objective itself.
    pub(crate) smoothing_ohm: f64,
    pub(crate) points: usize,
    /// Median of |Z|, Ω: the natural size of residuals and steps.
    pub(crate) scale_ohm: f64,
    /// Errors that points share; for complex least squares only.
    pub(crate) common: Option<Common>,
}

impl Problem {
    /// Pools the spectra; the points must have been checked.
    pub(crate) fn new(spectra: &[Spectrum], kind: Objective) -> Self {
        Self::pool(spectra, kind, &common::names(spectra))
    }

    /// The same with the shares of common errors as noise of each point: accurate enough to find
    /// basins, and fast.
    pub(super) fn coarse(spectra: &[Spectrum], kind: Objective) -> Self {
        Self::pool(spectra, kind, &[])
    }

    fn pool(spectra: &[Spectrum], kind: Objective, names: &[&str]) -> Self {
        let mut tagged: Vec<(usize, usize)> = spectra
            .iter()
            .enumerate()
            .flat_map(|(i, s)| (0..s.points.len()).map(move |k| (i, k)))
            .collect();
        let at = |(spectrum, index): &(usize, usize)| &spectra[*spectrum].points[*index];
        tagged.sort_by(|a, b| at(a).freq_hz.total_cmp(&at(b).freq_hz));
        let covariance = |tag: &(usize, usize)| {
            if names.is_empty() {
                at(tag).covariance
            } else {
                spectra[tag.0].own_covariance(tag.1)
            }
        };
        let absolute_weights = kind == Objective::Complex
            && tagged
                .iter()
                .all(|tag| inverse_covariance(&covariance(tag)).is_some());
        let sizes: Vec<Vec<f64>> = spectra
            .iter()
            .map(|s| weight_sizes_ohm(&s.points))
            .collect();
        let mut groups: Vec<Group> = Vec::new();
        let mut seen: Vec<Vec<MeasuredPoint>> = Vec::new();
        for tag in &tagged {
            let (p, freq_hz) = (at(tag), at(tag).freq_hz);
            let weight = match kind {
                Objective::Complex if absolute_weights => {
                    inverse_covariance(&covariance(tag)).unwrap_or([1.0, 0.0, 1.0])
                }
                Objective::Complex => {
                    let relative = sizes[tag.0][tag.1].powi(-2);
                    [relative, 0.0, relative]
                }
                Objective::SumAbs | Objective::Modulus => [1.0, 0.0, 1.0],
            };
            let point = DataPoint {
                z: p.z_ohm,
                weight,
                spectrum: tag.0,
            };
            let shared = MeasuredPoint {
                z: p.z_ohm,
                weight,
                directions: common::directions(&spectra[tag.0], tag.1, names),
            };
            match (groups.last_mut(), seen.last_mut()) {
                // Files print frequencies with few significant digits. A difference in the tenth
                // digit is the same frequency.
                (Some(g), Some(all)) if (freq_hz - g.freq_hz).abs() <= 1e-10 * g.freq_hz => {
                    g.points.push(point);
                    all.push(shared);
                }
                _ => {
                    groups.push(Group::open(freq_hz, point));
                    seen.push(vec![shared]);
                }
            }
        }
        groups.iter_mut().for_each(Group::close);
        let mut magnitudes: Vec<f64> = tagged.iter().map(|tag| at(tag).z_ohm.norm()).collect();
        magnitudes.sort_by(f64::total_cmp);
        let scale_ohm = magnitudes.get(magnitudes.len() / 2).copied().unwrap_or(1.0);
        let common = if kind == Objective::Complex {
            Common::new(names, seen, absolute_weights)
        } else {
            None
        };
        Self {
            groups,
            kind,
            absolute_weights,
            smoothing_ohm: 0.0,
            points: tagged.len(),
            scale_ohm,
            common,
        }
    }

    /// Impedances of the model at all frequencies, Ω.
    pub(super) fn model(&self, x: &[f64]) -> Vec<Complex64> {
        let (r_ohm, branches) = components(x);
        self.groups
            .iter()
            .map(|g| impedance_of(r_ohm, &branches, g.freq_hz))
            .collect()
    }

    /// Impedances of the model as each point of each group sees them, with the common errors at
    /// their best, Ω.
    pub(super) fn seen(&self, x: &[f64]) -> Vec<Vec<Complex64>> {
        let model = self.model(x);
        let best = self
            .common
            .as_ref()
            .map(|common| (common, common.best(&model).0));
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

    /// DᵀWJ of the common errors over the parameters, row by row; empty without them.
    pub(super) fn mixed(&self, x: &[f64]) -> Vec<f64> {
        let Some(common) = &self.common else {
            return Vec::new();
        };
        let mut mixed = vec![0.0; common.count() * x.len()];
        let mut slopes = vec![Complex64::ZERO; x.len()];
        let (r_ohm, branches) = components(x);
        for (k, g) in self.groups.iter().enumerate() {
            write_slopes(r_ohm, &branches, g.freq_hz, &mut slopes);
            common.add_mixed(k, &slopes, &mut mixed);
        }
        mixed
    }

    /// The same problem with another corner of the smoothed norm, Ω.
    pub(crate) fn smoothed(&self, smoothing_ohm: f64) -> Self {
        Self {
            smoothing_ohm,
            ..self.clone()
        }
    }

    /// Value of the objective's share of one frequency for the model impedance z.
    pub(crate) fn group_value(&self, g: &Group, z: Complex64) -> f64 {
        match self.kind {
            Objective::SumAbs => {
                let e2 = self.smoothing_ohm * self.smoothing_ohm;
                g.points
                    .iter()
                    .map(|p| ((z - p.z).norm_sqr() + e2).sqrt())
                    .sum()
            }
            Objective::Modulus => {
                g.points.len() as f64 * (z.norm() - g.mean_abs).powi(2) + g.scatter_abs
            }
            Objective::Complex => quadratic(&g.weight, z - g.mean) + g.scatter,
        }
    }

    /// Value, gradient and Hessian of one frequency's share with respect to (Re z, Im z).
    fn group_expand(&self, g: &Group, z: Complex64) -> (f64, [f64; 2], Sym2) {
        match self.kind {
            Objective::SumAbs => self.norms_expand(g, z),
            Objective::Modulus => {
                let n = g.points.len() as f64;
                let (m, excess) = (z.norm(), z.norm() - g.mean_abs);
                let (ux, uy) = (z.re / m, z.im / m);
                let (along, across) = (2.0 * n, 2.0 * n * excess / m);
                let hessian = [
                    along * ux * ux + across * uy * uy,
                    (along - across) * ux * uy,
                    along * uy * uy + across * ux * ux,
                ];
                (
                    n * excess * excess + g.scatter_abs,
                    [2.0 * n * excess * ux, 2.0 * n * excess * uy],
                    hessian,
                )
            }
            Objective::Complex => {
                let r = z - g.mean;
                let [xx, xy, yy] = g.weight.map(|w| 2.0 * w);
                (
                    quadratic(&g.weight, r) + g.scatter,
                    [xx * r.re + xy * r.im, xy * r.re + yy * r.im],
                    [xx, xy, yy],
                )
            }
        }
    }

    fn norms_expand(&self, g: &Group, z: Complex64) -> (f64, [f64; 2], Sym2) {
        let e2 = self.smoothing_ohm * self.smoothing_ohm;
        let (mut value, mut gradient, mut hessian) = (0.0, [0.0; 2], [0.0; 3]);
        for p in &g.points {
            let r = z - p.z;
            let s = (r.norm_sqr() + e2).sqrt();
            value += s;
            // At a point met exactly the norm has a corner: zero is a subgradient there.
            if s > 0.0 {
                let (x, y) = (r.re / s, r.im / s);
                gradient[0] += x;
                gradient[1] += y;
                hessian[0] += (1.0 - x * x) / s;
                hessian[1] -= x * y / s;
                hessian[2] += (1.0 - y * y) / s;
            }
        }
        (value, gradient, hessian)
    }

    /// Gradient of one point's share with respect to (Re z, Im z).
    pub(crate) fn point_gradient(&self, p: &DataPoint, z: Complex64) -> [f64; 2] {
        let r = z - p.z;
        match self.kind {
            Objective::SumAbs => {
                let s = (r.norm_sqr() + self.smoothing_ohm.powi(2))
                    .sqrt()
                    .max(f64::MIN_POSITIVE);
                [r.re / s, r.im / s]
            }
            Objective::Modulus => {
                let pull = 2.0 * (z.norm() - p.z.norm()) / z.norm();
                [pull * z.re, pull * z.im]
            }
            Objective::Complex => {
                let [xx, xy, yy] = p.weight.map(|w| 2.0 * w);
                [xx * r.re + xy * r.im, xy * r.re + yy * r.im]
            }
        }
    }
}

/// Variables are the logarithms of the parameters: ln R, ln R₁, ln C₁, …
impl Smooth for Problem {
    fn value(&self, x: &[f64]) -> f64 {
        let Some(common) = &self.common else {
            let (r_ohm, branches) = components(x);
            return self
                .groups
                .iter()
                .map(|g| self.group_value(g, impedance_of(r_ohm, &branches, g.freq_hz)))
                .sum();
        };
        let model = self.model(x);
        let apart: f64 = self
            .groups
            .iter()
            .zip(&model)
            .map(|(g, z)| self.group_value(g, *z))
            .sum();
        apart - common.best(&model).1
    }

    fn expand(&self, x: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let n = x.len();
        gradient.fill(0.0);
        hessian.fill(0.0);
        let mut value = 0.0;
        let mut slopes = vec![Complex64::ZERO; n];
        let mut curvatures = vec![[Complex64::ZERO; 3]; n / 2];
        let (r_ohm, branches) = components(x);
        let best = self
            .common
            .as_ref()
            .map(|common| (common, common.best(&self.model(x))));
        let mut mixed = vec![0.0; self.common.as_ref().map_or(0, Common::count) * n];
        for (number, g) in self.groups.iter().enumerate() {
            let mut z = Complex64::new(r_ohm, 0.0);
            slopes[0] = z;
            for (k, (r, tau)) in branches.iter().enumerate() {
                let u = relaxation(*tau, g.freq_hz);
                curvatures[k] = branch_curvature(*r, u);
                z += r * u;
                slopes[2 * k + 1] = r * u * u;
                slopes[2 * k + 2] = r * (u * u - u);
            }
            let (v, [mut gx, mut gy], [xx, xy, yy]) = self.group_expand(g, z);
            value += v;
            if let Some((common, (best, _))) = &best {
                let [x, y] = common.gradient(number, best);
                (gx, gy) = (gx + x, gy + y);
                common.add_mixed(number, &slopes, &mut mixed);
            }
            for i in 0..n {
                let s = slopes[i];
                gradient[i] += gx * s.re + gy * s.im;
                let (hx, hy) = (xx * s.re + xy * s.im, xy * s.re + yy * s.im);
                for j in 0..=i {
                    hessian[i * n + j] += hx * slopes[j].re + hy * slopes[j].im;
                }
            }
            hessian[0] += gx * r_ohm;
            for (k, [rr, rc, cc]) in curvatures.iter().enumerate() {
                let (i, j) = (2 * k + 1, 2 * k + 2);
                hessian[i * n + i] += gx * rr.re + gy * rr.im;
                hessian[j * n + i] += gx * rc.re + gy * rc.im;
                hessian[j * n + j] += gx * cc.re + gy * cc.im;
            }
        }
        if let Some((common, (_, taken))) = &best {
            value -= taken;
            hessian
                .iter_mut()
                .zip(common.taken_from_hessian(&mixed, n))
                .for_each(|(h, taken)| *h -= taken);
        }
        for i in 0..n {
            for j in 0..i {
                hessian[j * n + i] = hessian[i * n + j];
            }
        }
        value
    }
}

/// Derivatives of the impedance towards ln R, ln R₁, ln C₁, … at a frequency, Ω.
fn write_slopes(r_ohm: f64, branches: &[(f64, f64)], freq_hz: f64, slopes: &mut [Complex64]) {
    slopes[0] = Complex64::new(r_ohm, 0.0);
    for (k, (r, tau)) in branches.iter().enumerate() {
        let u = relaxation(*tau, freq_hz);
        slopes[2 * k + 1] = r * u * u;
        slopes[2 * k + 2] = r * (u * u - u);
    }
}

/// Impedance of logarithmic parameters, Ω.
pub(crate) fn impedance(x: &[f64], freq_hz: f64) -> Complex64 {
    let (r_ohm, branches) = components(x);
    impedance_of(r_ohm, &branches, freq_hz)
}

fn impedance_of(r_ohm: f64, branches: &[(f64, f64)], freq_hz: f64) -> Complex64 {
    branches
        .iter()
        .fold(Complex64::new(r_ohm, 0.0), |z, (r, tau)| {
            z + r * relaxation(*tau, freq_hz)
        })
}

/// Returns R, and (R, RC) of the branches, so that the exponentials are computed once and not at
/// every frequency.
fn components(x: &[f64]) -> (f64, Vec<(f64, f64)>) {
    (
        x[0].exp(),
        x[1..]
            .chunks_exact(2)
            .map(|p| (p[0].exp(), (p[0] + p[1]).exp()))
            .collect(),
    )
}

/// 1/(1 + jωτ).
fn relaxation(tau: f64, freq_hz: f64) -> Complex64 {
    let x = TAU * freq_hz * tau;
    let d = 1.0 / (1.0 + x * x);
    Complex64::new(d, -x * d)
}

/// Second derivatives of a branch's impedance: (ln R, ln R), (ln R, ln C), (ln C, ln C).
fn branch_curvature(r: f64, u: Complex64) -> [Complex64; 3] {
    let (u2, u3) = (u * u, u * u * u);
    [
        r * (2.0 * u3 - u2),
        r * (2.0 * u3 - 2.0 * u2),
        r * (2.0 * u3 - 3.0 * u2 + u),
    ]
}

impl Group {
    fn open(freq_hz: f64, first: DataPoint) -> Self {
        let none = [0.0; 3];
        Self {
            freq_hz,
            points: vec![first],
            weight: none,
            mean: Complex64::ZERO,
            scatter: 0.0,
            mean_abs: 0.0,
            scatter_abs: 0.0,
        }
    }

    /// Means first, then sums of squares about them: no significant digits are lost by
    /// cancellation.
    fn close(&mut self) {
        let (mut bx, mut by) = (0.0, 0.0);
        for p in &self.points {
            let [xx, xy, yy] = p.weight;
            self.weight = std::array::from_fn(|i| self.weight[i] + p.weight[i]);
            bx += xx * p.z.re + xy * p.z.im;
            by += xy * p.z.re + yy * p.z.im;
        }
        let [xx, xy, yy] = self.weight;
        let det = xx * yy - xy * xy;
        self.mean = Complex64::new((yy * bx - xy * by) / det, (xx * by - xy * bx) / det);
        self.scatter = self
            .points
            .iter()
            .map(|p| quadratic(&p.weight, p.z - self.mean))
            .sum();
        self.mean_abs =
            self.points.iter().map(|p| p.z.norm()).sum::<f64>() / self.points.len() as f64;
        self.scatter_abs = self
            .points
            .iter()
            .map(|p| (p.z.norm() - self.mean_abs).powi(2))
            .sum();
    }
}

/// The model of logarithmic parameters.
pub(super) fn to_erm(x: &[f64]) -> Erm {
    let branches = x[1..]
        .chunks_exact(2)
        .map(|p| RcBranch {
            r_ohm: p[0].exp(),
            c_f: p[1].exp(),
        })
        .collect();
    Erm {
        r_ohm: x[0].exp(),
        branches,
    }
}

/// rᵀWr.
pub(crate) fn quadratic(w: &Sym2, r: Complex64) -> f64 {
    w[0] * r.re * r.re + 2.0 * w[1] * r.re * r.im + w[2] * r.im * r.im
}

/// Inverse of a point's covariance, 1/Ω²; none where it is unknown or not positive definite.
fn inverse_covariance(c: &Covariance2) -> Option<Sym2> {
    let det = c.re_re * c.im_im - c.re_im * c.re_im;
    let good = c.re_re > 0.0 && c.im_im > 0.0 && det > 0.0 && det.is_finite();
    good.then(|| [c.im_im / det, -c.re_im / det, c.re_re / det])
}
