//! The elements of the model and the normal equations.

use crate::validity::Noise;
use analysis_signal::spectrum::Spectrum;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use std::f64::consts::TAU;
use std::ops::{Range, RangeInclusive};

/// Elements before the continuum: R∞, L, 1/C, A.
pub(super) const SERIES: usize = 4;
const PER_DECADE: f64 = 10.0;
/// Factor by which the grid may reach beyond the band.
pub(super) const REACH: f64 = 4.0;
const MOST_NODES: usize = 160;

/// The linear problem of a spectrum: normal equations in whitened data, and the penalty.
#[derive(Debug)]
pub(super) struct Design {
    pub(super) tau_s: Vec<f64>,
    /// Time constant of the inductive branch, s: the element behind the continuum.
    pub(super) loop_tau_s: Option<f64>,
    pub(super) omega: Vec<f64>,
    /// AᵀA.
    pub(super) normal: DMatrix<f64>,
    /// Aᵀb.
    pub(super) right: DVector<f64>,
    /// bᵀb.
    pub(super) square: f64,
    /// DᵀD of the second differences, zero for the series elements.
    pub(super) penalty: DMatrix<f64>,
    /// Spacing of ln τ.
    pub(super) step: f64,
}

impl Design {
    /// Builds the problem. The grid extends beyond the slow end of the band by the factor
    /// `slow_reach`. If `loop_tau_s` is given, it has an inductive branch with this time constant.
    pub(super) fn new(
        spectrum: &Spectrum,
        noise: &Noise,
        slow_reach: f64,
        loop_tau_s: Option<f64>,
    ) -> Self {
        let omega: Vec<f64> = spectrum.points.iter().map(|p| TAU * p.freq_hz).collect();
        let tau_s = grid(omega[0] / slow_reach..=omega[omega.len() - 1] * REACH);
        let n = SERIES + tau_s.len() + usize::from(loop_tau_s.is_some());
        let mut rows = DMatrix::zeros(2 * omega.len(), n);
        let mut data = DVector::zeros(2 * omega.len());
        for (k, (point, w)) in spectrum.points.iter().zip(noise.whitening()).enumerate() {
            data[2 * k] = w.a * point.z_ohm.re;
            data[2 * k + 1] = w.b * point.z_ohm.re + w.c * point.z_ohm.im;
            for j in 0..n {
                let z = element(j, omega[k], &tau_s, loop_tau_s);
                rows[(2 * k, j)] = w.a * z.re;
                rows[(2 * k + 1, j)] = w.b * z.re + w.c * z.im;
            }
        }
        let step = if tau_s.len() > 1 {
            (tau_s[1] / tau_s[0]).ln()
        } else {
            1.0
        };
        Self {
            normal: rows.transpose() * &rows,
            right: rows.transpose() * &data,
            square: data.dot(&data),
            penalty: penalty(tau_s.len(), n),
            omega,
            tau_s,
            loop_tau_s,
            step,
        }
    }

    /// Places of the continuum among the unknowns.
    pub(super) fn nodes(&self) -> Range<usize> {
        SERIES..SERIES + self.tau_s.len()
    }

    /// The model's impedance at the measured frequencies, Ω.
    pub(super) fn impedance(&self, x: &DVector<f64>) -> Vec<Complex64> {
        let at = |omega: &f64| {
            x.iter()
                .enumerate()
                .map(|(j, x)| *x * element(j, *omega, &self.tau_s, self.loop_tau_s))
                .sum()
        };
        self.omega.iter().map(at).collect()
    }
}

fn grid(omega: RangeInclusive<f64>) -> Vec<f64> {
    let (first, last) = (1.0 / omega.end(), 1.0 / omega.start());
    let nodes = ((PER_DECADE * (last / first).log10()).ceil() as usize + 1).min(MOST_NODES);
    (0..nodes)
        .map(|k| first * (last / first).powf(k as f64 / (nodes - 1) as f64))
        .collect()
}

/// Impedance of an element of unit size.
fn element(j: usize, omega: f64, tau_s: &[f64], loop_tau_s: Option<f64>) -> Complex64 {
    let relaxation = |tau_s: f64| Complex64::new(1.0, omega * tau_s).inv();
    match j {
        0 => Complex64::new(1.0, 0.0),
        1 => Complex64::new(0.0, omega),
        2 => Complex64::new(0.0, -1.0 / omega),
        3 => Complex64::new(1.0, -1.0) / (2.0 * omega).sqrt(),
        node => match tau_s.get(node - SERIES) {
            Some(tau_s) => relaxation(*tau_s),
            None => -loop_tau_s.map_or(Complex64::ZERO, relaxation),
        },
    }
}

/// Returns the second differences of the continuum, with zeros beyond both ends, as a matrix of
/// this number of unknowns.
fn penalty(nodes: usize, unknowns: usize) -> DMatrix<f64> {
    let mut differences = DMatrix::zeros(nodes + 2, unknowns);
    for row in 0..nodes + 2 {
        for (offset, value) in [(-2_i64, 1.0), (-1, -2.0), (0, 1.0)] {
            if let Some(node) = usize::try_from(row as i64 + offset)
                .ok()
                .filter(|node| *node < nodes)
            {
                differences[(row, SERIES + node)] = value;
            }
        }
    }
    differences.transpose() * differences
}
