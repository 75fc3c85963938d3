//! The normal equations of one channel at one frequency, and their solution by Cholesky factorisation.
//!
//! Parameters in order: real and imaginary part of the phasor in the middle of the record, offset, drift per half record.

use num_complex::Complex64;

use super::moments::{Gram, Moments};

const MAX: usize = 4;

/// Least ratio of a pivot of the factorisation to its diagonal element: below, the equations are singular to working precision.
const SINGULAR: f64 = 1e-11;

/// Cholesky factor of the normal matrix.
#[derive(Debug, Clone, Copy)]
pub(super) struct Normal {
    lower: [[f64; MAX]; MAX],
    size: usize,
}

impl Normal {
    /// Factorises; `None` if the samples do not determine the parameters.
    pub(super) fn new(gram: &Gram, linear_drift: bool) -> Option<Self> {
        let matrix = matrix(gram);
        let size = if linear_drift { 4 } else { 3 };
        let mut lower = [[0.0; MAX]; MAX];
        for row in 0..size {
            for column in 0..=row {
                let known: f64 = lower[row].iter().zip(&lower[column]).take(column).map(|(a, b)| a * b).sum();
                let sum = matrix[row][column] - known;
                if row > column {
                    lower[row][column] = sum / lower[column][column];
                } else if sum > SINGULAR * matrix[row][row] {
                    lower[row][row] = sum.sqrt();
                } else {
                    return None;
                }
            }
        }
        Some(Self { lower, size })
    }

    /// Solution for a right-hand side.
    pub(super) fn solve(&self, rhs: &[f64; MAX]) -> [f64; MAX] {
        let mut x = [0.0; MAX];
        for row in 0..self.size {
            let sum: f64 = (0..row).map(|k| self.lower[row][k] * x[k]).sum();
            x[row] = (rhs[row] - sum) / self.lower[row][row];
        }
        for row in (0..self.size).rev() {
            let sum: f64 = (row + 1..self.size).map(|k| self.lower[k][row] * x[k]).sum();
            x[row] = (x[row] - sum) / self.lower[row][row];
        }
        x
    }

    /// Number of parameters.
    pub(super) fn size(&self) -> usize {
        self.size
    }

    /// Upper left corner of the inverse: (re re, re im, im im).
    pub(super) fn phasor_inverse(&self) -> (f64, f64, f64) {
        let first = self.solve(&[1.0, 0.0, 0.0, 0.0]);
        let second = self.solve(&[0.0, 1.0, 0.0, 0.0]);
        (first[0], 0.5 * (first[1] + second[0]), second[1])
    }
}

/// Normal matrix on the basis cos θ, −sin θ, 1, t.
fn matrix(gram: &Gram) -> [[f64; MAX]; MAX] {
    let Gram { u, w, v } = gram;
    let (cc, cs, ss) = quadratic(v[0], w[0]);
    [[cc, cs, u[0].re, u[1].re], [cs, ss, -u[0].im, -u[1].im], [u[0].re, -u[0].im, v[0], v[1]], [u[1].re, -u[1].im, v[1], v[2]]]
}

/// Sums of cos², −cos·sin and sin² from those of 1 and exp(2jθ), all with the same weight.
fn quadratic(v: f64, w: Complex64) -> (f64, f64, f64) {
    (0.5 * (v + w.re), -0.5 * w.im, 0.5 * (v - w.re))
}

/// Samples on the basis.
pub(super) fn right_side(moments: &Moments) -> [f64; MAX] {
    [moments.x[0].re, -moments.x[0].im, moments.y[0], moments.y[1]]
}

/// What one channel says of the phase that a change of the frequency adds at the ends of the record (rad): curvature and slope of the sum of
/// squares after the other parameters have been fitted.
pub(super) fn frequency_step(moments: &Moments, normal: &Normal, beta: &[f64; MAX]) -> (f64, f64) {
    let Gram { u, w, v } = &moments.gram;
    let [re, im, ..] = *beta;
    let (cc, cs, ss) = quadratic(v[1], w[1]);
    // The derivative column is t·(re·(−sin θ) − im·cos θ).
    let mut coupling = [re * cs - im * cc, re * ss - im * cs, -re * u[1].im - im * u[1].re, -re * u[2].im - im * u[2].re];
    coupling[normal.size()..].fill(0.0);
    let (cc, cs, ss) = quadratic(v[2], w[2]);
    let own = re * re * ss - 2.0 * re * im * cs + im * im * cc;
    let data = -re * moments.x[1].im - im * moments.x[1].re;
    let explained = normal.solve(&coupling);
    let curvature = own - dot(&explained, &coupling);
    (curvature, data - dot(beta, &coupling))
}

fn dot(a: &[f64; MAX], b: &[f64; MAX]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Part of the sum of squares that the fit explains.
pub(super) fn explained(moments: &Moments, beta: &[f64; MAX]) -> f64 {
    dot(&right_side(moments), beta)
}
