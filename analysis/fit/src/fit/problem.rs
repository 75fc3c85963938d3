//! The objective of a fit of the extended Randles model, with its exact derivatives.

use super::common::{self, MeasuredPoint};
use super::options::Objective;
use super::pooled::{DataPoint, Expansion, Pooled, TaggedPoint, inverse_covariance};
use crate::sizes::weight_sizes_ohm;
use analysis_model::model::{Erm, RcBranch};
use analysis_numeric::Smooth;
use analysis_signal::spectrum::Spectrum;
use num_complex::Complex64;
use std::{
    f64::consts::TAU,
    ops::{Deref, DerefMut},
};

/// Function to minimise: data, objective, smoothing.
#[derive(Debug, Clone)]
pub(crate) struct Problem {
    data: Pooled,
    /// True when the weights are inverse covariances, so that the objective is a χ².
    pub(crate) absolute_weights: bool,
    /// Corner of the smoothed norm √(|r|² + ε²), Ω; zero for the objective itself.
    pub(crate) smoothing_ohm: f64,
    /// Median of |Z|, Ω: the natural size of residuals and steps.
    pub(crate) scale_ohm: f64,
}

impl Deref for Problem {
    type Target = Pooled;

    fn deref(&self) -> &Pooled {
        &self.data
    }
}

impl DerefMut for Problem {
    fn deref_mut(&mut self) -> &mut Pooled {
        &mut self.data
    }
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
        let names = if kind == Objective::Complex {
            names
        } else {
            &[]
        };
        let tags: Vec<(usize, usize)> = spectra
            .iter()
            .enumerate()
            .flat_map(|(i, s)| (0..s.points.len()).map(move |k| (i, k)))
            .collect();
        let at = |(spectrum, index): &(usize, usize)| &spectra[*spectrum].points[*index];
        let covariance = |tag: &(usize, usize)| {
            if names.is_empty() {
                at(tag).covariance
            } else {
                spectra[tag.0].own_covariance(tag.1)
            }
        };
        let absolute_weights = kind == Objective::Complex
            && tags
                .iter()
                .all(|tag| inverse_covariance(&covariance(tag)).is_some());
        let sizes: Vec<Vec<f64>> = spectra
            .iter()
            .map(|s| weight_sizes_ohm(&s.points))
            .collect();
        let tagged = |tag: &(usize, usize)| {
            let z = at(tag).z_ohm;
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
            TaggedPoint {
                freq_hz: at(tag).freq_hz,
                point: DataPoint {
                    z,
                    weight,
                    weight_abs: 1.0,
                    spectrum: tag.0,
                },
                seen: MeasuredPoint {
                    z,
                    weight,
                    directions: common::directions(&spectra[tag.0], tag.1, names),
                },
            }
        };
        let points = tags.iter().map(tagged).collect();
        let mut magnitudes: Vec<f64> = tags.iter().map(|tag| at(tag).z_ohm.norm()).collect();
        magnitudes.sort_by(f64::total_cmp);
        Self {
            data: Pooled::new(kind, points, names, absolute_weights),
            absolute_weights,
            smoothing_ohm: 0.0,
            scale_ohm: magnitudes.get(magnitudes.len() / 2).copied().unwrap_or(1.0),
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
        self.seen_of(&self.model(x))
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
}

/// Variables are the logarithms of the parameters: ln R, ln R₁, ln C₁, …
impl Smooth for Problem {
    fn value(&self, x: &[f64]) -> f64 {
        self.value_of(&self.model(x), self.smoothing_ohm)
    }

    fn expand(&self, x: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let n = x.len();
        let mut slopes = vec![Complex64::ZERO; n];
        let mut curvatures = vec![[Complex64::ZERO; 3]; n / 2];
        let (r_ohm, branches) = components(x);
        let mut sums = Expansion::begin(self, || self.model(x), gradient, hessian);
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
            let share = self.share(g, z, self.smoothing_ohm, true);
            let [gx, gy] = sums.add(number, &share, &slopes);
            sums.hessian[0] += gx * r_ohm;
            for (k, [rr, rc, cc]) in curvatures.iter().enumerate() {
                let (i, j) = (2 * k + 1, 2 * k + 2);
                sums.hessian[i * n + i] += gx * rr.re + gy * rr.im;
                sums.hessian[j * n + i] += gx * rc.re + gy * rc.im;
                sums.hessian[j * n + j] += gx * cc.re + gy * cc.im;
            }
        }
        sums.end()
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
