//! Step of a branch with a fixed time constant.

/// Voltage that a branch keeps over a step, and what it takes of the voltage that drives it, R·i, if
/// that is linear over the step: exact for the step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BranchStep {
    /// Factor on the voltage of the branch at the start.
    pub decay: f64,
    /// Factor on the driving voltage at the start.
    pub start: f64,
    /// Factor on the driving voltage at the end.
    pub end: f64,
}

impl BranchStep {
    /// Returns the factors of a step of a branch with a time constant, s.
    pub fn new(step_s: f64, tau_s: f64) -> Self {
        let x = step_s / tau_s;
        let decay = (-x).exp();
        let phi = if x > 1e-9 {
            -(-x).exp_m1() / x
        } else {
            1.0 - 0.5 * x
        };
        Self {
            decay,
            start: phi - decay,
            end: 1.0 - phi,
        }
    }

    /// Returns the voltage of the branch at the end of the step, V.
    #[inline]
    pub fn end_v(self, v: f64, driven_start_v: f64, driven_end_v: f64) -> f64 {
        self.decay * v + self.start * driven_start_v + self.end * driven_end_v
    }
}
