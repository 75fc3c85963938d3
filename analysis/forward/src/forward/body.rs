//! A cell as one body that loses heat to its surroundings: C·du/dt = heat − G·u, where u is its
//! temperature over theirs.
//!
//! Heat is constant over a step. The flow to the surroundings follows the mean temperature ũ = u₀ +
//! θ·(u₁ − u₀) with θ(x) = 1/(1 − exp(−x)) − 1/x, x = h·G/C: this is the exact solution, and what the
//! body stores is what comes less what leaves.

/// Below it, θ is its series: the difference of the two fractions would lose digits.
const SMALL: f64 = 0.02;

/// One body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Body {
    /// Heat capacity, J/K.
    pub(super) capacity_j_per_k: f64,
    /// Conductance to the surroundings, W/K.
    pub(super) path_w_per_k: f64,
}

impl Body {
    /// Returns the temperature over the surroundings after a step with a heat, K.
    pub(super) fn end_k(self, start_k: f64, heat_w: f64, step_s: f64) -> f64 {
        let mean_k = self.mean_k(start_k, heat_w, step_s);
        start_k + step_s / self.capacity_j_per_k * (heat_w - self.path_w_per_k * mean_k)
    }

    /// Returns the mean temperature over the surroundings in a step with a heat, K.
    pub(super) fn mean_k(self, start_k: f64, heat_w: f64, step_s: f64) -> f64 {
        let x = step_s * self.path_w_per_k / self.capacity_j_per_k;
        let inert = self.capacity_j_per_k / (step_s * theta(x));
        (inert * start_k + heat_w) / (inert + self.path_w_per_k)
    }
}

/// Returns the weight of the end of a step in its mean, from the step over the time constant.
pub(super) fn theta(x: f64) -> f64 {
    if x < SMALL {
        0.5 + x / 12.0 - x * x * x / 720.0
    } else {
        -1.0 / (-x).exp_m1() - 1.0 / x
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_follows_the_exponential_for_any_step_and_without_a_path_keeps_all_heat() {
        for step_s in [1e-3, 1.0, 6.5, 7.5, 330.0, 1e5] {
            let body = Body {
                capacity_j_per_k: 66.0,
                path_w_per_k: 0.2,
            };
            // Settled at 15 K.
            let expected = 15.0 + (4.0 - 15.0) * f64::exp(-step_s * 0.2 / 66.0);
            let met = body.end_k(4.0, 3.0, step_s);
            assert!((met - expected).abs() < 1e-13 * 15.0, "{step_s}: {met}");
            let closed = Body {
                path_w_per_k: 0.0,
                ..body
            };
            let met = closed.end_k(4.0, 3.0, step_s);
            assert!((met / (4.0 + 3.0 * step_s / 66.0) - 1.0).abs() < 1e-14);
        }
    }
}
