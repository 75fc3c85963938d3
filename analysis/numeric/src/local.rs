//! Bounded local minimisation: Newton steps with Levenberg–Marquardt damping (Marquardt, 1963) on
//! the variables that no bound holds.
//!
//! The Hessian is the exact one, not only JᵀJ, so that convergence is quadratic for least squares
//! and for sums of norms alike; damping makes it positive definite if it is not. It finds the
//! bottom of the basin it starts in, nothing more.

use super::linalg::{cholesky, cholesky_substitute};

/// A twice differentiable function.
pub trait Smooth {
    /// Returns the value at x.
    fn value(&self, x: &[f64]) -> f64;
    /// Value at x; writes the gradient and the full row-major Hessian.
    fn expand(&self, x: &[f64], gradient: &mut [f64], hessian: &mut [f64]) -> f64;
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalOptions {
    /// Most evaluations of the Hessian.
    pub iterations: usize,
    /// Ends when the decrease that the quadratic model still promises is below this fraction of the
    /// value.
    pub tolerance: f64,
    /// Longest move of any variable in one step.
    pub longest_step: f64,
}

impl Default for LocalOptions {
    fn default() -> Self {
        Self {
            iterations: 300,
            tolerance: 1e-15,
            longest_step: 1.0,
        }
    }
}

/// Result of a minimisation.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// The point, inside the bounds.
    pub x: Vec<f64>,
    /// The value there.
    pub value: f64,
    /// Evaluations of the Hessian.
    pub iterations: usize,
    /// False when the iterations ran out.
    pub converged: bool,
}

/// Minimises within bounds (lower, upper), from `start` moved into them.
pub fn minimise(
    f: &impl Smooth,
    start: &[f64],
    bounds: &[(f64, f64)],
    options: &LocalOptions,
) -> Minimum {
    let mut state = State::new(f, start, bounds);
    for iteration in 1..=options.iterations {
        state.value = f.expand(&state.x, &mut state.gradient, &mut state.hessian);
        state.free = (0..state.x.len())
            .filter(|i| !state.held(*i, bounds))
            .collect();
        if !state.descend(f, bounds, options) {
            return Minimum {
                x: state.x,
                value: state.value,
                iterations: iteration,
                converged: true,
            };
        }
    }
    Minimum {
        x: state.x,
        value: state.value,
        iterations: options.iterations,
        converged: false,
    }
}

struct State {
    x: Vec<f64>,
    value: f64,
    gradient: Vec<f64>,
    hessian: Vec<f64>,
    free: Vec<usize>,
    damping: f64,
}

impl State {
    fn new(f: &impl Smooth, start: &[f64], bounds: &[(f64, f64)]) -> Self {
        let n = start.len();
        let x: Vec<f64> = start
            .iter()
            .zip(bounds)
            .map(|(x, (lo, hi))| x.max(*lo).min(*hi))
            .collect();
        let value = f.value(&x);
        Self {
            x,
            value,
            gradient: vec![0.0; n],
            hessian: vec![0.0; n * n],
            free: Vec::new(),
            damping: 1e-3,
        }
    }

    /// Returns whether it is at a bound and pushed against it.
    fn held(&self, i: usize, bounds: &[(f64, f64)]) -> bool {
        let (lo, hi) = bounds[i];
        (self.x[i] <= lo && self.gradient[i] >= 0.0) || (self.x[i] >= hi && self.gradient[i] <= 0.0)
    }

    /// Makes one accepted step; returns false if no step improves the value.
    fn descend(&mut self, f: &impl Smooth, bounds: &[(f64, f64)], options: &LocalOptions) -> bool {
        while self.damping < 1e15 {
            let Some(step) = self.newton_step() else {
                self.damping = (self.damping * 4.0).max(1e-6);
                continue;
            };
            let promised: f64 = self
                .free
                .iter()
                .zip(&step)
                .map(|(i, s)| -0.5 * self.gradient[*i] * s)
                .sum();
            if self.free.is_empty() || promised <= options.tolerance * self.value.abs() {
                return false;
            }
            let longest = step.iter().fold(0.0f64, |m, s| m.max(s.abs()));
            let shrink = (options.longest_step / longest).min(1.0);
            let mut trial = self.x.clone();
            for (i, s) in self.free.iter().zip(&step) {
                trial[*i] = (trial[*i] + shrink * s).max(bounds[*i].0).min(bounds[*i].1);
            }
            let value = f.value(&trial);
            if value < self.value {
                let good = self.value - value > 0.25 * promised;
                self.damping = if good {
                    (self.damping * 0.1).max(1e-15)
                } else {
                    self.damping * 2.0
                };
                self.x = trial;
                self.value = value;
                return true;
            }
            self.damping = (self.damping * 4.0).max(1e-9);
        }
        false
    }

    /// Returns the damped Newton step of the free variables, or `None` if the damped Hessian is not
    /// positive definite.
    fn newton_step(&self) -> Option<Vec<f64>> {
        let (n, m) = (self.x.len(), self.free.len());
        let largest = self
            .free
            .iter()
            .fold(0.0f64, |s, i| s.max(self.hessian[i * n + i].abs()));
        let mut a = vec![0.0; m * m];
        for (row, i) in self.free.iter().enumerate() {
            for (column, j) in self.free.iter().enumerate() {
                a[row * m + column] = self.hessian[i * n + j];
            }
            a[row * m + row] += self.damping * self.hessian[i * n + i].abs().max(1e-9 * largest);
        }
        let mut step: Vec<f64> = self.free.iter().map(|i| -self.gradient[*i]).collect();
        if !cholesky(&mut a, m) {
            return None;
        }
        cholesky_substitute(&a, m, &mut step);
        step.iter().all(|s| s.is_finite()).then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// (1 − x)² + 100 (y − x²)², its Hessian indefinite in places.
    struct Rosenbrock;
    impl Smooth for Rosenbrock {
        fn value(&self, v: &[f64]) -> f64 {
            (1.0 - v[0]).powi(2) + 100.0 * (v[1] - v[0] * v[0]).powi(2)
        }
        fn expand(&self, v: &[f64], g: &mut [f64], h: &mut [f64]) -> f64 {
            let (x, y) = (v[0], v[1]);
            g.copy_from_slice(&[
                -2.0 * (1.0 - x) - 400.0 * x * (y - x * x),
                200.0 * (y - x * x),
            ]);
            h.copy_from_slice(&[
                2.0 - 400.0 * (y - 3.0 * x * x),
                -400.0 * x,
                -400.0 * x,
                200.0,
            ]);
            self.value(v)
        }
    }

    #[test]
    fn reaches_the_last_digits() {
        for start in [[-1.2, 1.0], [0.0, 3.0], [3.0, -2.0]] {
            let m = minimise(
                &Rosenbrock,
                &start,
                &[(-10.0, 10.0); 2],
                &LocalOptions::default(),
            );
            assert!(
                m.converged && (m.x[0] - 1.0).abs() < 1e-9 && (m.x[1] - 1.0).abs() < 1e-9,
                "{start:?}: {m:?}"
            );
        }
    }

    #[test]
    fn stops_at_a_bound() {
        let m = minimise(
            &Rosenbrock,
            &[-1.2, 1.0],
            &[(-10.0, 0.5), (-10.0, 10.0)],
            &LocalOptions::default(),
        );
        assert!(
            m.converged && m.x[0] == 0.5 && (m.x[1] - 0.25).abs() < 1e-9,
            "{m:?}"
        );
        let m = minimise(
            &Rosenbrock,
            &[9.0, 9.0],
            &[(-10.0, 0.5), (-10.0, 0.1)],
            &LocalOptions::default(),
        );
        assert!(m.converged && m.x[1] == 0.1, "{m:?}");
    }

    #[test]
    fn tells_when_the_iterations_ran_out() {
        let options = LocalOptions {
            iterations: 2,
            ..LocalOptions::default()
        };
        assert!(!minimise(&Rosenbrock, &[-1.2, 1.0], &[(-10.0, 10.0); 2], &options).converged);
    }
}
