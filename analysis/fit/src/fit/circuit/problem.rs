//! The objective of a circuit's fit as a function of its free variables: logarithms of the
//! parameters, but exponents as they are.

use super::data::Data;
use crate::fit::pooled::Expansion;
use analysis_model::model::{Circuit, Role};
use analysis_numeric::Smooth;
use num_complex::Complex64;

/// Step of a variable for the curvature of the model, of which only first derivatives are exact.
const STEP: f64 = 1e-5;

/// A circuit, data, and which parameters are free.
#[derive(Debug, Clone)]
pub(super) struct Problem<'a> {
    pub(super) circuit: &'a Circuit,
    pub(super) data: &'a Data,
    /// All parameters; the entries of the free ones do not matter.
    pub(super) base: Vec<f64>,
    /// Indices of the free parameters.
    pub(super) free: Vec<usize>,
    /// Adds the model's own curvature to the Hessian: quadratic convergence at the end, also where
    /// residuals are large.
    pub(super) exact: bool,
    /// Corner of the smoothed norm; zero for the objective itself.
    pub(super) corner: f64,
}

impl Problem<'_> {
    fn is_log(&self, index: usize) -> bool {
        is_log(self.circuit, index)
    }

    /// All parameters for the free variables.
    pub(super) fn parameters(&self, x: &[f64]) -> Vec<f64> {
        let mut p = self.base.clone();
        for (i, x) in self.free.iter().zip(x) {
            p[*i] = if self.is_log(*i) { x.exp() } else { *x };
        }
        p
    }

    /// The free variables of all parameters.
    pub(super) fn variables(&self, p: &[f64]) -> Vec<f64> {
        self.free
            .iter()
            .map(|i| if self.is_log(*i) { p[*i].ln() } else { p[*i] })
            .collect()
    }

    /// ∂parameter/∂variable of the free parameters.
    pub(super) fn stretch(&self, p: &[f64]) -> Vec<f64> {
        self.free
            .iter()
            .map(|i| if self.is_log(*i) { p[*i] } else { 1.0 })
            .collect()
    }

    /// Impedances of the circuit at all frequencies, Ω.
    fn model(&self, p: &[f64]) -> Vec<Complex64> {
        self.data
            .groups
            .iter()
            .map(|g| self.circuit.impedance(p, g.freq_hz))
            .collect()
    }

    /// Impedances of the circuit as each point of each frequency sees them, with the common errors
    /// at their best, Ω. `p` are all parameters.
    pub(super) fn seen(&self, p: &[f64]) -> Vec<Vec<Complex64>> {
        self.data.seen_of(&self.model(p))
    }

    /// Returns the part of the Hessian over the free variables that common errors remove, row by
    /// row; `None` without common errors.
    pub(super) fn taken(&self, x: &[f64]) -> Option<Vec<f64>> {
        let common = self.data.common.as_ref()?;
        let mut mixed = vec![0.0; common.count() * x.len()];
        self.sweep(x, |k, _, slopes| common.add_mixed(k, slopes, &mut mixed));
        Some(common.taken_from_hessian(&mixed, x.len()))
    }

    /// Calls `f` with the number of each frequency, the model's impedance there and its derivatives
    /// with respect to the free variables.
    pub(super) fn sweep(&self, x: &[f64], mut f: impl FnMut(usize, Complex64, &[Complex64])) {
        let p = self.parameters(x);
        let stretch = self.stretch(&p);
        let mut all = vec![Complex64::ZERO; p.len()];
        let mut slopes = vec![Complex64::ZERO; x.len()];
        for (k, group) in self.data.groups.iter().enumerate() {
            let z = self.circuit.jacobian(&p, group.freq_hz, &mut all);
            for ((slope, i), stretch) in slopes.iter_mut().zip(&self.free).zip(&stretch) {
                *slope = all[*i] * stretch;
            }
            f(k, z, &slopes);
        }
    }

    /// Adds Σ gₖ·∂²zₖ, by central differences of the exact first derivatives with the gradients
    /// over z held.
    fn add_model_curvature(&self, x: &[f64], pulls: &[[f64; 2]], hessian: &mut [f64]) {
        let n = x.len();
        let contracted = |x: &[f64]| {
            let mut sum = vec![0.0; n];
            self.sweep(x, |k, _, slopes| {
                let [gx, gy] = pulls[k];
                sum.iter_mut()
                    .zip(slopes)
                    .for_each(|(sum, s)| *sum += gx * s.re + gy * s.im);
            });
            sum
        };
        let mut moved = x.to_vec();
        for i in 0..n {
            moved[i] = x[i] + STEP;
            let up = contracted(&moved);
            moved[i] = x[i] - STEP;
            let down = contracted(&moved);
            moved[i] = x[i];
            for j in 0..n {
                let half = 0.5 * (up[j] - down[j]) / (2.0 * STEP);
                hessian[i * n + j] += half;
                hessian[j * n + i] += half;
            }
        }
    }
}

/// Returns whether the variable of a parameter is its logarithm.
pub(super) fn is_log(circuit: &Circuit, index: usize) -> bool {
    circuit.parameter_kinds()[index].role != Role::Exponent
}

impl Smooth for Problem<'_> {
    fn value(&self, x: &[f64]) -> f64 {
        let model = self.model(&self.parameters(x));
        self.data.value_of(&model, self.corner)
    }

    fn expand(&self, x: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64 {
        let data = self.data;
        let mut pulls = vec![[0.0; 2]; data.groups.len()];
        let model = || self.model(&self.parameters(x));
        let mut sums = Expansion::begin(data, model, gradient, hessian);
        self.sweep(x, |k, z, slopes| {
            let share = data.share(&data.groups[k], z, self.corner, self.exact);
            pulls[k] = sums.add(k, &share, slopes);
        });
        let value = sums.end();
        if self.exact {
            self.add_model_curvature(x, &pulls, hessian);
        }
        value
    }
}
