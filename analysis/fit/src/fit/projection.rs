//! Variable projection (Golub and Pereyra, 1973): with the time constants held, the impedance is
//! linear in the resistances, so the global search ([`super::batch`], which does the same for many
//! at once) runs over the logarithms of the time constants alone and the best resistances come from
//! a small bounded quadratic.
//!
//! The sum of norms and the moduli are not quadratic. A few reweighted quadratics come close enough
//! to rank basins; the polish brings full precision later.

use super::common::Sym2;
use super::options::{Bounds, Objective};
use super::pooled::{Group, apply};
use super::problem::Problem;
use analysis_numeric::linalg::{BoxQuadratic, MAX_UNKNOWNS};
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Reweighted quadratics per evaluation.
pub(super) const REWEIGHTS: usize = 4;

/// The linear half of the problem for given time constants; holds the working memory between calls.
#[derive(Debug)]
pub(crate) struct Projection<'a> {
    problem: &'a Problem,
    bounds: &'a Bounds,
    /// Column k of frequency g at [g][k]: 1, then 1/(1 + jωτ).
    basis: Vec<[Complex64; MAX_UNKNOWNS]>,
    /// Model impedance of the last solution per frequency.
    model: Vec<Complex64>,
}

impl<'a> Projection<'a> {
    pub(crate) fn new(problem: &'a Problem, bounds: &'a Bounds) -> Self {
        let groups = problem.groups.len();
        Self {
            problem,
            bounds,
            basis: vec![[Complex64::ONE; MAX_UNKNOWNS]; groups],
            model: vec![Complex64::ZERO; groups],
        }
    }

    /// Logarithmic parameters ln R, ln R₁, ln C₁, … of the best resistances found.
    pub(crate) fn parameters(&mut self, log_tau: &[f64]) -> Vec<f64> {
        let (_, r) = self.solve(log_tau);
        let branches = log_tau
            .iter()
            .enumerate()
            .flat_map(|(k, t)| [r[k + 1].ln(), t - r[k + 1].ln()]);
        std::iter::once(r[0].ln()).chain(branches).collect()
    }

    fn solve(&mut self, log_tau: &[f64]) -> (f64, [f64; MAX_UNKNOWNS]) {
        let mut quadratic = BoxQuadratic::new(log_tau.len() + 1);
        (quadratic.lo[0], quadratic.hi[0]) = self.bounds.r_ohm;
        for (k, log_tau) in log_tau.iter().enumerate() {
            let tau = log_tau.exp();
            // R within its own bounds and C = τ/R within its own.
            quadratic.lo[k + 1] = self.bounds.r_ohm.0.max(tau / self.bounds.c_f.1);
            quadratic.hi[k + 1] = self.bounds.r_ohm.1.min(tau / self.bounds.c_f.0);
            for (g, basis) in self.problem.groups.iter().zip(&mut self.basis) {
                basis[k + 1] = Complex64::new(1.0, TAU * g.freq_hz * tau).inv();
            }
        }
        for (g, z) in self.problem.groups.iter().zip(&mut self.model) {
            *z = g.mean;
        }
        let rounds = if self.problem.kind == Objective::Complex {
            1
        } else {
            REWEIGHTS
        };
        let mut best = (f64::INFINITY, [0.0; MAX_UNKNOWNS]);
        for round in 0..rounds {
            self.assemble(&mut quadratic, round == 0);
            let r = quadratic.solve();
            let value = self.evaluate(&r, quadratic.n);
            if value < best.0 {
                best = (value, r);
            }
        }
        best
    }

    /// Normal equations of the quadratic that touches the objective at the last model.
    fn assemble(&self, quadratic: &mut BoxQuadratic, first: bool) {
        let n = quadratic.n;
        quadratic.c = [0.0; MAX_UNKNOWNS];
        quadratic.q = [[0.0; MAX_UNKNOWNS]; MAX_UNKNOWNS];
        for ((g, basis), z) in self.problem.groups.iter().zip(&self.basis).zip(&self.model) {
            let ([xx, xy, yy], b) = self.touching(g, *z, first);
            for i in 0..n {
                let s = basis[i];
                quadratic.c[i] += s.re * b.re + s.im * b.im;
                let (hx, hy) = (xx * s.re + xy * s.im, xy * s.re + yy * s.im);
                for (q, column) in quadratic.q[i].iter_mut().zip(&basis[..=i]) {
                    *q += hx * column.re + hy * column.im;
                }
            }
        }
        for i in 0..n {
            for j in 0..i {
                quadratic.q[j][i] = quadratic.q[i][j];
            }
        }
    }

    /// Matrix A and vector b of zᵀAz − 2bᵀz for one frequency.
    fn touching(&self, g: &Group, z: Complex64, first: bool) -> (Sym2, Complex64) {
        match self.problem.kind {
            Objective::SumAbs if !first => {
                let floor = 1e-8 * self.problem.scale_ohm * self.problem.scale_ohm;
                let (mut weight, mut b) = (0.0, Complex64::ZERO);
                for p in &g.points {
                    let w = 1.0 / ((z - p.z).norm_sqr() + floor).sqrt();
                    weight += w;
                    b += w * p.z;
                }
                ([weight, 0.0, weight], b)
            }
            Objective::Modulus => {
                let n = g.points.len() as f64;
                let u = z / z.norm().max(f64::MIN_POSITIVE);
                (
                    [n * u.re * u.re, n * u.re * u.im, n * u.im * u.im],
                    n * g.mean_abs * u,
                )
            }
            Objective::SumAbs | Objective::Complex => {
                let [x, y] = apply(&g.weight, g.mean);
                (g.weight, Complex64::new(x, y))
            }
        }
    }

    fn evaluate(&mut self, r: &[f64; MAX_UNKNOWNS], n: usize) -> f64 {
        let mut value = 0.0;
        for ((g, basis), z) in self
            .problem
            .groups
            .iter()
            .zip(&self.basis)
            .zip(&mut self.model)
        {
            *z = basis[..n].iter().zip(r).map(|(b, r)| b * r).sum();
            value += self.problem.share_value(g, *z, self.problem.smoothing_ohm);
        }
        value
    }
}
