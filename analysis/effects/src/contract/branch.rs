//! A branch of a network, and what one step does to it.
//!
//! Linear: v' = a·v + R(φ − a)·i₀ + R(1 − φ)·i₁ with a = exp(−h/τ), φ = (1 − a)τ/h; for a held
//! current v' = a·v + R(1 − a)·i₀. Symmetric Butler–Volmer under a held current: with u =
//! tanh(βv/2R) the equation C·dv/dt = i − sinh(βv/R)/β is a Riccati equation with constant
//! coefficients and has the closed solution of [`symmetric`]. Asymmetric: exponential Rosenbrock
//! steps, exact at rest and in the steady state. A ramp is cut into parts, each with the held
//! current that would move a linear branch as the ramp does.

/// Change of the exponent per sub-step of the asymmetric law at most.
const EXPONENT_STEP: f64 = 0.1;
/// First sub-step of the asymmetric law, in its time constants.
const FIRST_STEP: f64 = 0.2;
/// Error that is allowed where a branch with the asymmetric law is taken to be at rest, V.
const REST_V: f64 = 1e-9;
/// Sub-steps of the asymmetric law at most.
const MOST_SUBSTEPS: usize = 400;
/// Parts of a ramp for a change of the current by 1/β.
const RAMPS: f64 = 32.0;
/// Parts of a ramp at most.
const MOST_RAMPS: f64 = 100.0;

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
    /// A linear branch.
    pub fn linear(r_ohm: f64, tau_s: f64) -> Self {
        Self {
            r_ohm,
            tau_s,
            law: Law::Linear,
        }
    }

    /// True where the resistor's current is proportional to its voltage.
    pub fn is_linear(&self) -> bool {
        !matches!(self.law, Law::Symmetric { beta } | Law::Asymmetric { beta, .. } if beta > 0.0)
    }

    /// Current through the resistor, A, at a voltage, its resistance times a factor.
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
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gain {
    /// Factor that remains of the voltage.
    pub(crate) decay: f64,
    /// Ω, per ampere at the start.
    pub(crate) start: f64,
    /// Ω, per ampere at the end.
    pub(crate) end: f64,
}

impl Gain {
    /// Of a linear branch whose resistance has changed by a factor while its capacitance stayed.
    pub(crate) fn new(branch: &Branch, factor: f64, step_s: f64, linear: bool) -> Self {
        let r = branch.r_ohm * factor;
        let x = step_s / (branch.tau_s * factor);
        // One exponential serves both: this is where records spend their time.
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

/// A quantity that goes straight over a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ramp {
    /// At the start of the step.
    pub start: f64,
    /// At the end of the step.
    pub end: f64,
}

/// A branch with a law that is not linear, over a step with a held current. The factor is on the
/// resistance; voltages of the law stay, as kT/e does.
pub(crate) fn step(branch: &Branch, factor: f64, v: f64, current_a: f64, step_s: f64) -> f64 {
    let (r, tau) = (branch.r_ohm * factor, branch.tau_s * factor);
    let held = Held {
        voltage_v: v,
        current_a,
        time_constants: step_s / tau,
    };
    match branch.law {
        Law::Symmetric { beta } if beta > 0.0 => symmetric(beta / branch.r_ohm, r, held),
        Law::Asymmetric { beta, alpha } if beta > 0.0 => {
            let law = Asymmetric {
                beta_per_a: beta * factor,
                alpha,
                r_ohm: r,
            };
            asymmetric(law, held)
        }
        _ => {
            let decay = (-step_s / tau).exp();
            decay * v + (1.0 - decay) * r * current_a
        }
    }
}

/// The same over a step in which the current goes from one value to another along a straight line.
pub(crate) fn ramp(branch: &Branch, factor: f64, v: f64, current_a: Ramp, step_s: f64) -> f64 {
    let (from, to) = (current_a.start, current_a.end);
    if from == to {
        return step(branch, factor, v, from, step_s);
    }
    let beta = match branch.law {
        Law::Linear => 0.0,
        Law::Symmetric { beta } | Law::Asymmetric { beta, .. } => beta,
    };
    let count = (RAMPS * beta * (to - from).abs())
        .ceil()
        .clamp(1.0, MOST_RAMPS);
    let part_s = step_s / count;
    let along = |k: f64| from + (to - from) * k / count;
    (0..count as usize).fold(v, |v, k| {
        let (from, to) = (along(k as f64), along(k as f64 + 1.0));
        // The small-signal time constant is that of the voltage in the middle of the part, as far
        // as it is known.
        let with_slope_at = |v_middle: f64| {
            let linear = Branch {
                tau_s: branch.tau_s / slope(branch, v_middle),
                ..*branch
            };
            let gain = Gain::new(&linear, factor, part_s, true);
            step(
                branch,
                factor,
                v,
                (gain.start * from + gain.end * to) / (gain.start + gain.end),
                part_s,
            )
        };
        let end = with_slope_at(v);
        if count > 1.0 {
            with_slope_at(0.5 * (v + end))
        } else {
            end
        }
    })
}

/// Conductance at a voltage over that at zero.
fn slope(branch: &Branch, v: f64) -> f64 {
    match branch.law {
        Law::Linear => 1.0,
        Law::Symmetric { beta } => (beta * v / branch.r_ohm).cosh(),
        Law::Asymmetric { beta, alpha } => {
            let y = 2.0 * beta * v / branch.r_ohm;
            alpha * (alpha * y).exp() + (1.0 - alpha) * (-(1.0 - alpha) * y).exp()
        }
    }
}

/// A branch over a step with a held current.
#[derive(Clone, Copy)]
struct Held {
    /// Its voltage at the start, V.
    voltage_v: f64,
    /// The current, A.
    current_a: f64,
    /// Length of the step in time constants.
    time_constants: f64,
}

/// C·dv/dt = i − sinh(bR·v/R)/(bR) over a time of x time constants; b in 1/V.
fn symmetric(b: f64, r: f64, held: Held) -> f64 {
    let (v, current_a, x) = (held.voltage_v, held.current_a, held.time_constants);
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

/// The asymmetric law of a branch.
#[derive(Clone, Copy)]
struct Asymmetric {
    /// β, 1/A.
    beta_per_a: f64,
    /// Transfer coefficient of the discharge direction, 0…1.
    alpha: f64,
    /// Resistance, Ω.
    r_ohm: f64,
}

/// The asymmetric law over a time of x time constants: exponential Rosenbrock steps of third order
/// (exprb32 of Hochbruck, Ostermann and Schweitzer, SIAM J. Numer. Anal. 47 (2009) 786), short
/// after an edge and longer as the branch settles.
fn asymmetric(law: Asymmetric, held: Held) -> f64 {
    let (beta, alpha, r) = (law.beta_per_a, law.alpha, law.r_ohm);
    let (v, current_a, x) = (held.voltage_v, held.current_a, held.time_constants);
    let to_exponent = 2.0 * beta / r;
    let mut y = to_exponent * v;
    let drive = 2.0 * beta * current_a;
    // dy/dx = 2βi − exp(αy) + exp(−(1 − α)y): no unit is left.
    let parts = |y: f64| ((alpha * y).exp(), (-(1.0 - alpha) * y).exp());
    let (mut left, mut grown) = (x, 1.0_f64);
    for count in 1..=MOST_SUBSTEPS {
        let (forth, back) = parts(y);
        let (now, slope) = (drive - forth + back, alpha * forth + (1.0 - alpha) * back);
        // The error of a single step to the end is of the third order in the way to go, now/slope.
        let way = now.abs() / slope;
        let rests = way * way * way <= REST_V * to_exponent;
        let short = (FIRST_STEP * grown / slope)
            .min(EXPONENT_STEP / now.abs())
            .min(left);
        let h = if rests || count == MOST_SUBSTEPS {
            left
        } else {
            short
        };
        let z = h * slope;
        let lost = -(-z).exp_m1();
        let there = y + lost / slope * now;
        let (forth, back) = parts(there);
        let bent = drive - forth + back - now + slope * (there - y);
        y = there + 2.0 * h * phi_3(z, lost) * bent;
        left -= h;
        if left <= 0.0 {
            break;
        }
        grown *= (z / 3.0).exp();
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

    /// The branch equation by classical Runge–Kutta with many steps.
    fn runge_kutta(branch: &Branch, v: f64, current_a: f64, step_s: f64) -> f64 {
        let conducted = |v: f64| match branch.law {
            Law::Linear => v / branch.r_ohm,
            Law::Symmetric { beta } => (beta * v / branch.r_ohm).sinh() / beta,
            Law::Asymmetric { beta, alpha } => {
                ((2.0 * alpha * beta * v / branch.r_ohm).exp()
                    - (-2.0 * (1.0 - alpha) * beta * v / branch.r_ohm).exp())
                    / (2.0 * beta)
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
            for (v, current_a, step_s) in [
                (0.0, 100.0, 0.01),
                (0.12, 0.0, 0.05),
                (0.05, -40.0, 0.2),
                (-0.03, 30.0, 1.0),
            ] {
                let (met, expected) = (
                    step(&branch, 1.0, v, current_a, step_s),
                    runge_kutta(&branch, v, current_a, step_s),
                );
                assert!(
                    (met - expected).abs() < 2e-5,
                    "{law:?} from {v} V at {current_a} A over {step_s} s: {met} against {expected}"
                );
            }
        }
    }

    /// Steps of which the smaller changes are taken at once, because the branch nearly rests, against
    /// the same in 4000 parts, whose error is 4000² times smaller.
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
        assert!(worst < 5.0 * REST_V, "{worst} V");
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
