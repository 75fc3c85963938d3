//! One branch over one step.
//!
//! Linear: v' = a·v + R(φ − a)·i₀ + R(1 − φ)·i₁ with a = exp(−h/τ), φ = (1 − a)τ/h; for a held current v' = a·v + R(1 − a)·i₀.
//! Symmetric Butler–Volmer under a held current: with u = tanh(βv/2R) the equation C·dv/dt = i − sinh(βv/R)/β is a Riccati equation with constant
//! coefficients and has the closed solution of [`symmetric`]. Asymmetric: exponential Rosenbrock–Euler steps, exact at rest and in the steady state.

use super::network::{Branch, Law};

/// Change of the exponent per sub-step of the asymmetric law at most.
const EXPONENT_STEP: f64 = 0.04;
/// Sub-steps of the asymmetric law at most.
const MOST_SUBSTEPS: f64 = 400.0;

/// What one length of step does to a linear branch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gain {
    /// What is left of the voltage.
    pub(super) decay: f64,
    /// Ω, per ampere at the start.
    pub(super) start: f64,
    /// Ω, per ampere at the end.
    pub(super) end: f64,
}

impl Gain {
    /// Of a linear branch whose resistance has changed by a factor while its capacitance stayed.
    pub(super) fn new(branch: &Branch, factor: f64, step_s: f64, linear: bool) -> Self {
        let r = branch.r_ohm * factor;
        let x = step_s / (branch.tau_s * factor);
        let decay = (-x).exp();
        if !linear {
            return Self { decay, start: -(-x).exp_m1() * r, end: 0.0 };
        }
        let phi = if x > 1e-9 { -(-x).exp_m1() / x } else { 1.0 - 0.5 * x };
        Self { decay, start: r * (phi - decay), end: r * (1.0 - phi) }
    }
}

/// A branch with a law that is not linear, over a step with a held current. The factor is on the resistance; voltages of the law stay, as kT/e does.
pub(super) fn step(branch: &Branch, factor: f64, v: f64, current_a: f64, step_s: f64) -> f64 {
    let (r, tau) = (branch.r_ohm * factor, branch.tau_s * factor);
    match branch.law {
        Law::Symmetric { beta } if beta > 0.0 => symmetric(beta / branch.r_ohm, r, (v, current_a), step_s / tau),
        Law::Asymmetric { beta, alpha } if beta > 0.0 => asymmetric((beta * factor, alpha), r, (v, current_a), step_s / tau),
        _ => {
            let decay = (-step_s / tau).exp();
            decay * v + (1.0 - decay) * r * current_a
        }
    }
}

/// C·dv/dt = i − sinh(bR·v/R)/(bR) over a time of x time constants; b in 1/V.
fn symmetric(b: f64, r: f64, (v, current_a): (f64, f64), x: f64) -> f64 {
    let beta = b * r;
    let u = (0.5 * b * v).tanh();
    let a = beta * current_a;
    let s = (1.0 + a * a).sqrt();
    let rest = a / (1.0 + s);
    let k = (u - rest) / (a * u + 1.0 + s);
    let e = (-s * x).exp();
    let next = (rest + k * e * (1.0 + s)) / (1.0 - a * k * e);
    2.0 / b * next.clamp(-1.0 + 1e-15, 1.0 - 1e-15).atanh()
}

/// The asymmetric law over a time of x time constants.
fn asymmetric((beta, alpha): (f64, f64), r: f64, (v, current_a): (f64, f64), x: f64) -> f64 {
    let to_exponent = 2.0 * beta / r;
    let mut y = to_exponent * v;
    let drive = 2.0 * beta * current_a;
    // dy/dx = 2βi − exp(αy) + exp(−(1 − α)y): no unit is left.
    let target = drive.asinh().abs() / alpha.min(1.0 - alpha).max(0.05);
    let far = (y.abs() + target).min((drive - y).abs() * x.min(1.0) * 2.0 + 1e-3);
    let count = (far / EXPONENT_STEP).ceil().clamp(1.0, MOST_SUBSTEPS);
    let h = x / count;
    for _ in 0..count as usize {
        let (up, down) = ((alpha * y).exp(), (-(1.0 - alpha) * y).exp());
        let rate = drive - up + down;
        let slope = alpha * up + (1.0 - alpha) * down;
        y += -(-h * slope).exp_m1() / slope * rate;
    }
    y / to_exponent
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The branch equation by classical Runge–Kutta with many steps.
    fn runge_kutta(branch: &Branch, v: f64, current_a: f64, step_s: f64) -> f64 {
        let conducted = |v: f64| match branch.law {
            Law::Linear => v / branch.r_ohm,
            Law::Symmetric { beta } => (beta * v / branch.r_ohm).sinh() / beta,
            Law::Asymmetric { beta, alpha } => {
                ((2.0 * alpha * beta * v / branch.r_ohm).exp() - (-2.0 * (1.0 - alpha) * beta * v / branch.r_ohm).exp()) / (2.0 * beta)
            }
        };
        let rate = |v: f64| (current_a - conducted(v)) * branch.r_ohm / branch.tau_s;
        let (count, mut v) = (20_000, v);
        let h = step_s / f64::from(count);
        for _ in 0..count {
            let k1 = rate(v);
            let k2 = rate(v + 0.5 * h * k1);
            let k3 = rate(v + 0.5 * h * k2);
            let k4 = rate(v + h * k3);
            v += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
        }
        v
    }

    #[test]
    fn every_law_follows_its_equation() {
        for law in [
            Law::Linear,
            Law::Symmetric { beta: 0.02 },
            Law::Asymmetric { beta: 0.02, alpha: 0.5 },
            Law::Asymmetric { beta: 0.02, alpha: 0.35 },
        ] {
            let branch = Branch { r_ohm: 2e-3, tau_s: 0.06, law };
            for (v, current_a, step_s) in [(0.0, 100.0, 0.01), (0.12, 0.0, 0.05), (0.05, -40.0, 0.2), (-0.03, 30.0, 1.0)] {
                let (met, expected) = (step(&branch, 1.0, v, current_a, step_s), runge_kutta(&branch, v, current_a, step_s));
                assert!((met - expected).abs() < 2e-5, "{law:?} from {v} V at {current_a} A over {step_s} s: {met} against {expected}");
            }
        }
    }

    #[test]
    fn two_halves_are_one_step_where_the_solution_is_closed() {
        let branch = Branch { r_ohm: 2e-3, tau_s: 0.06, law: Law::Symmetric { beta: 0.03 } };
        let once = step(&branch, 1.0, 0.01, 70.0, 0.04);
        let half = step(&branch, 1.0, 0.01, 70.0, 0.02);
        assert!((step(&branch, 1.0, half, 70.0, 0.02) - once).abs() < 1e-14);
    }
}
