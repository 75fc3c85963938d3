//! A branch of a network, and the effect of one step on it.
//!
//! Linear: v' = a·v + R(φ − a)·i₀ + R(1 − φ)·i₁ with a = exp(−h/τ), φ = (1 − a)τ/h; for a held
//! current v' = a·v + R(1 − a)·i₀. Symmetric Butler–Volmer under a held current: with u =
//! tanh(βv/2R) the equation C·dv/dt = i − sinh(βv/R)/β is a Riccati equation with constant
//! coefficients and has the closed solution of [`symmetric`]. Any transfer coefficient, and a
//! current that is linear in time: exponential Rosenbrock steps of [`rosenbrock`], whose lengths
//! follow from their error.

/// Greatest difference of the second and the third order in a sub-step, V.
const SUBSTEP_V: f64 = 1e-7;
/// Change of the exponent in the first sub-step that is tried, at most.
const FIRST_EXPONENT: f64 = 0.5;
/// Part of the sub-step that the error allows, so that few are tried in vain.
const CAUTION: f64 = 0.8;
/// Shrinkage and growth of a sub-step at most.
const RESIZED: (f64, f64) = (0.1, 5.0);
/// Sub-steps at most.
const MOST_SUBSTEPS: usize = 400;

/// Law of a branch's resistor: its current over its voltage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Law {
    /// i = v/R.
    Linear,
    /// i = sinh(βv/R)/β: Butler–Volmer with α = ½, β = 1/(2i₀), 1/A.
    Symmetric {
        /// β, 1/A, above zero.
        beta: f64,
    },
    /// i = (exp(2αβv/R) − exp(−2(1 − α)βv/R))/(2β): Butler–Volmer with any α and i₀ = 1/(2β); α = ½
    /// is [`Law::Symmetric`].
    Asymmetric {
        /// β = 1/(2i₀), 1/A, above zero.
        beta: f64,
        /// Transfer coefficient of the discharge direction, 0…1.
        alpha: f64,
    },
}

/// A parallel RC element in series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Branch {
    /// Resistance for small signals, Ω.
    pub r_ohm: f64,
    /// Time constant for small signals, s.
    pub tau_s: f64,
    /// Law of its resistor.
    pub law: Law,
}

impl Branch {
    /// Returns a linear branch.
    pub fn linear(r_ohm: f64, tau_s: f64) -> Self {
        Self {
            r_ohm,
            tau_s,
            law: Law::Linear,
        }
    }

    /// Returns true if the resistor's current is proportional to its voltage.
    pub fn is_linear(&self) -> bool {
        !matches!(self.law, Law::Symmetric { beta } | Law::Asymmetric { beta, .. } if beta > 0.0)
    }

    /// Returns the current through the resistor, A, at a voltage, its resistance times a factor.
    pub fn conducted_a(&self, v: f64, factor: f64) -> f64 {
        match self.law {
            Law::Symmetric { beta } if beta > 0.0 => {
                (beta * v / self.r_ohm).sinh() / (beta * factor)
            }
            Law::Asymmetric { beta, alpha } if beta > 0.0 => {
                let x = 2.0 * beta * v / self.r_ohm;
                ((alpha * x).exp() - (-(1.0 - alpha) * x).exp()) / (2.0 * beta * factor)
            }
            _ => v / (self.r_ohm * factor),
        }
    }
}

/// Effect of one length of step on a linear branch.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Gain {
    /// Factor that remains of the voltage.
    pub(crate) decay: f64,
    /// Ω, per ampere at the start.
    pub(crate) start: f64,
    /// Ω, per ampere at the end.
    pub(crate) end: f64,
}

impl Gain {
    /// Returns the gains of a branch with `factor` times the resistance and the same time constant.
    pub(crate) fn times(self, factor: f64) -> Self {
        Self {
            decay: self.decay,
            start: self.start * factor,
            end: self.end * factor,
        }
    }

    /// Creates the gains of a linear branch whose resistance has changed by a factor while its
    /// capacitance stayed.
    pub(crate) fn new(branch: &Branch, factor: f64, step_s: f64, linear: bool) -> Self {
        let r = branch.r_ohm * factor;
        let x = step_s / (branch.tau_s * factor);
        // One exponential serves both.
        let lost = -(-x).exp_m1();
        let decay = 1.0 - lost;
        if !linear {
            return Self {
                decay,
                start: lost * r,
                end: 0.0,
            };
        }
        let phi = if x > 1e-9 { lost / x } else { 1.0 - 0.5 * x };
        Self {
            decay,
            start: r * (phi - decay),
            end: r * (1.0 - phi),
        }
    }
}

/// A quantity that is linear over a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramp {
    /// At the start of the step.
    pub start: f64,
    /// At the end of the step.
    pub end: f64,
}

/// Returns a branch with a law that is not linear, over a step with a held current. The factor is
/// on the resistance; voltages of the law stay, as kT/e does.
pub(crate) fn step(branch: &Branch, factor: f64, v: f64, current_a: f64, step_s: f64) -> f64 {
    let held = Ramp {
        start: current_a,
        end: current_a,
    };
    ramp(branch, factor, v, held, step_s)
}

/// Returns the same over a step in which the current is linear from one value to another.
pub(crate) fn ramp(branch: &Branch, factor: f64, v: f64, current_a: Ramp, step_s: f64) -> f64 {
    let (r_ohm, tau_s) = (branch.r_ohm * factor, branch.tau_s * factor);
    let x = step_s / tau_s;
    match branch.law {
        Law::Symmetric { beta } if beta > 0.0 && current_a.start == current_a.end => {
            symmetric(beta * factor, r_ohm, v, current_a.start, x)
        }
        Law::Symmetric { beta } if beta > 0.0 => {
            let alpha = 0.5;
            let beta = beta * factor;
            rosenbrock(Kinetics { beta, alpha, r_ohm }, v, current_a, x)
        }
        Law::Asymmetric { beta, alpha } if beta > 0.0 => {
            let beta = beta * factor;
            rosenbrock(Kinetics { beta, alpha, r_ohm }, v, current_a, x)
        }
        _ => {
            let gain = Gain::new(branch, factor, step_s, true);
            gain.decay * v + gain.start * current_a.start + gain.end * current_a.end
        }
    }
}

/// C·dv/dt = i − sinh(βv/R)/β under a held current over a time of x time constants.
fn symmetric(beta: f64, r_ohm: f64, v: f64, current_a: f64, x: f64) -> f64 {
    let b = beta / r_ohm;
    let u = (0.5 * b * v).tanh();
    let a = beta * current_a;
    let s = (1.0 + a * a).sqrt();
    let rest = a / (1.0 + s);
    let k = (u - rest) / (a * u + 1.0 + s);
    let e = (-s * x).exp();
    let next = (rest + k * e * (1.0 + s)) / (1.0 - a * k * e);
    2.0 / b * next.clamp(-1.0 + 1e-15, 1.0 - 1e-15).atanh()
}

/// The law of a branch with its factor.
#[derive(Clone, Copy)]
struct Kinetics {
    /// β, 1/A.
    beta: f64,
    /// Transfer coefficient of the discharge direction, 0…1.
    alpha: f64,
    /// Resistance, Ω.
    r_ohm: f64,
}

/// Integrates Butler–Volmer over a time of x time constants: exponential Rosenbrock steps of third
/// order for time-dependent equations (exprb32 of Hochbruck, Ostermann and Schweitzer, SIAM J.
/// Numer. Anal. 47 (2009) 786). The difference to their second order determines the next length.
fn rosenbrock(law: Kinetics, v: f64, current_a: Ramp, x: f64) -> f64 {
    let Kinetics { beta, alpha, r_ohm } = law;
    let to_exponent = 2.0 * beta / r_ohm;
    let allowed = SUBSTEP_V * to_exponent;
    // dy/dx = 2βi − exp(αy) + exp(−(1 − α)y): no unit is left.
    let parts = |y: f64| ((alpha * y).exp(), (-(1.0 - alpha) * y).exp());
    let rise = 2.0 * beta * (current_a.end - current_a.start) / x;
    let (mut y, mut drive) = (to_exponent * v, 2.0 * beta * current_a.start);
    let (mut forth, mut back) = parts(y);
    let mut left = x;
    let mut h = left.min(FIRST_EXPONENT / (drive - forth + back).abs());
    for count in 1..=MOST_SUBSTEPS {
        h = if count == MOST_SUBSTEPS {
            left
        } else {
            h.min(left)
        };
        let (now, slope) = (drive - forth + back, alpha * forth + (1.0 - alpha) * back);
        let z = h * slope;
        let lost = -(-z).exp_m1();
        let there = y + (lost * now + rise * (z - lost) / slope) / slope;
        let (forth_there, back_there) = parts(there);
        let bent = back_there - forth_there + forth - back + slope * (there - y);
        let correction = 2.0 * h * phi_3(z, lost) * bent;
        let error = correction.abs();
        let fits = error <= allowed;
        if fits || count == MOST_SUBSTEPS {
            y = there + correction;
            drive += rise * h;
            left -= h;
            if left <= 0.0 {
                break;
            }
            (forth, back) = parts(y);
        }
        // The second order errs with h³.
        let (least, most) = RESIZED;
        let resized = CAUTION * (allowed / error).cbrt();
        h *= if resized.is_nan() {
            least
        } else {
            resized.clamp(least, most)
        };
    }
    y / to_exponent
}

/// (1 − z + z²/2 − exp(−z))/z³; `lost` is 1 − exp(−z).
fn phi_3(z: f64, lost: f64) -> f64 {
    if z > 0.05 {
        return (lost - z + 0.5 * z * z) / (z * z * z);
    }
    1.0 / 6.0 - z * (1.0 / 24.0 - z * (1.0 / 120.0 - z * (1.0 / 720.0 - z / 5040.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integrates the branch equation by classical Runge–Kutta with many steps.
    fn runge_kutta(branch: &Branch, v: f64, current_a: Ramp, step_s: f64) -> f64 {
        let rate = |v: f64, part: f64| {
            let driven_a = current_a.start + (current_a.end - current_a.start) * part;
            (driven_a - branch.conducted_a(v, 1.0)) * branch.r_ohm / branch.tau_s
        };
        let (count, mut v) = (40_000, v);
        let (h, part) = (step_s / f64::from(count), 1.0 / f64::from(count));
        for k in 0..count {
            let at = part * f64::from(k);
            let k1 = rate(v, at);
            let k2 = rate(v + 0.5 * h * k1, at + 0.5 * part);
            let k3 = rate(v + 0.5 * h * k2, at + 0.5 * part);
            let k4 = rate(v + h * k3, at + part);
            v += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
        }
        v
    }

    #[test]
    fn every_law_follows_its_equation() {
        let mut worst: f64 = 0.0;
        for law in [
            Law::Linear,
            Law::Symmetric { beta: 0.02 },
            Law::Asymmetric {
                beta: 0.02,
                alpha: 0.5,
            },
            Law::Asymmetric {
                beta: 0.02,
                alpha: 0.35,
            },
        ] {
            let branch = Branch {
                r_ohm: 2e-3,
                tau_s: 0.06,
                law,
            };
            for (v, start, end, step_s) in [
                (0.0, 100.0, 100.0, 0.01),
                (0.12, 0.0, 0.0, 0.05),
                (0.05, -40.0, -40.0, 0.2),
                (-0.03, 30.0, 30.0, 1.0),
                (0.0, 0.0, 100.0, 0.01),
                (0.08, 120.0, -20.0, 1.0),
                (-0.05, -100.0, 0.0, 0.1),
                (0.0, 0.0, 0.05, 1.0),
            ] {
                let current_a = Ramp { start, end };
                let met = ramp(&branch, 1.0, v, current_a, step_s);
                let expected = runge_kutta(&branch, v, current_a, step_s);
                worst = worst.max((met - expected).abs());
            }
        }
        assert!(worst < SUBSTEP_V, "{worst} V");
    }

    /// Compares single steps, whose smaller changes are made at once because the branch is nearly
    /// at rest, with the same change in 4000 parts, whose error is 4000² times smaller.
    #[test]
    fn a_small_way_is_gone_at_once() {
        let mut worst: f64 = 0.0;
        for (k, current_a) in [-80.0, -5.0, 0.0, 3.0, 60.0].into_iter().enumerate() {
            let (beta, alpha) = (0.02, 0.3 + 0.1 * k as f64);
            let branch = Branch {
                r_ohm: 2e-3,
                tau_s: 0.06,
                law: Law::Asymmetric { beta, alpha },
            };
            let rest_v = step(&branch, 1.0, 0.0, current_a, 60.0);
            for change_a in [-0.03, 0.03, 0.06] {
                for step_s in [0.002, 0.03, 0.1, 1.0] {
                    let current_a = current_a + change_a;
                    let once = step(&branch, 1.0, rest_v, current_a, step_s);
                    let fine = (0..4000).fold(rest_v, |v, _| {
                        step(&branch, 1.0, v, current_a, step_s / 4000.0)
                    });
                    worst = worst.max((once - fine).abs());
                }
            }
        }
        assert!(worst < 0.1 * SUBSTEP_V, "{worst} V");
    }

    #[test]
    fn two_halves_are_one_step_where_the_solution_is_closed() {
        let branch = Branch {
            r_ohm: 2e-3,
            tau_s: 0.06,
            law: Law::Symmetric { beta: 0.03 },
        };
        let once = step(&branch, 1.0, 0.01, 70.0, 0.04);
        let half = step(&branch, 1.0, 0.01, 70.0, 0.02);
        assert!((step(&branch, 1.0, half, 70.0, 0.02) - once).abs() < 1e-14);
    }
}
