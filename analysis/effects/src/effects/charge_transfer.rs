//! Impedance that a sweep measures at a branch whose resistor follows Butler–Volmer: the describing
//! function at an amplitude, about a direct current.
//!
//! With y = 2βv/R the resistor conducts 2βi = exp(αy) − exp(−(1 − α)y). For y = Y + X·cos ωt the
//! mean is exp(αY)I₀(αX) − exp(−(1 − α)Y)I₀((1 − α)X) and the part at ω that of a conductance g/R
//! with g = α·exp(αY)B(αX) + (1 − α)exp(−(1 − α)Y)B((1 − α)X), B(x) = 2I₁(x)/x. Harmonics above the
//! first are left to the capacitance, as in every describing function. Not here: the steps in time
//! ([`crate::augmented`]).

use crate::contract::{Base, Point};
use num_complex::Complex64;
use std::f64::consts::TAU;

/// Rounds of search for the amplitude over the branch.
const ROUNDS: usize = 12;
/// Newton steps for the mean voltage.
const NEWTON: usize = 40;

/// Thermal voltage kT/e, V.
pub(super) fn thermal_v(temperature_degc: f64) -> f64 {
    8.617_333_262e-5 * (temperature_degc + 273.15)
}

/// Highest β of any branch that still counts as kinetics: three times R/(2kT/e), 1/A.
pub(super) fn greatest_beta(base: &Base) -> f64 {
    let most_ohm = base
        .erm
        .branches
        .iter()
        .map(|b| b.r_ohm)
        .fold(0.0, f64::max);
    1.5 * most_ohm / thermal_v(base.facts.temperature_degc)
}

/// The law of a branch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kinetics {
    /// 1/(2i₀), 1/A.
    pub(super) beta: f64,
    /// Transfer coefficient of the discharge direction.
    pub(super) alpha: f64,
}

impl Kinetics {
    /// Returns the change of the base's impedance by the law of a branch, Ω.
    pub(super) fn change_ohm(self, base: &Base, branch: usize, at: &Point) -> Complex64 {
        let Some(branch) = base.erm.branches.get(branch).filter(|_| self.beta > 0.0) else {
            return Complex64::ZERO;
        };
        let x = TAU * at.freq_hz * branch.time_constant_s();
        let drive = 2.0 * self.beta * at.amplitude_a.unwrap_or(0.0);
        let bias = 2.0 * self.beta * at.bias_a;
        let mut swing = drive / 1.0_f64.hypot(x);
        let mut g = self.conductance(bias, swing);
        for _ in 0..if drive > 0.0 { ROUNDS } else { 0 } {
            swing = (swing * drive / g.hypot(x)).sqrt();
            g = self.conductance(bias, swing);
        }
        branch.r_ohm * (Complex64::new(g, x).inv() - Complex64::new(1.0, x).inv())
    }

    /// Conductance at ω times R, for a mean of 2βi and an amplitude of y.
    fn conductance(self, bias: f64, swing: f64) -> f64 {
        let (a, b) = (self.alpha, 1.0 - self.alpha);
        let (mean_a, mean_b) = (bessel_0(a * swing), bessel_0(b * swing));
        let mut y = 0.0_f64;
        for _ in 0..NEWTON {
            let (up, down) = (mean_a * (a * y).exp(), mean_b * (-b * y).exp());
            let step = ((bias - up + down) / (a * up + b * down)).clamp(-2.0, 2.0);
            y += step;
            if step.abs() < 1e-14 {
                break;
            }
        }
        a * (a * y).exp() * bessel_1(a * swing) + b * (-b * y).exp() * bessel_1(b * swing)
    }
}

/// I₀(x).
fn bessel_0(x: f64) -> f64 {
    series(x, |k| k * k)
}

/// 2I₁(x)/x.
fn bessel_1(x: f64) -> f64 {
    series(x, |k| k * (k + 1.0))
}

/// 1 + Σ Π (x/2)²/divisor(k).
fn series(x: f64, divisor: impl Fn(f64) -> f64) -> f64 {
    let quarter = 0.25 * x * x;
    let (mut sum, mut term) = (1.0, 1.0);
    for k in 1..60 {
        term *= quarter / divisor(f64::from(k));
        sum += term;
        if term < 1e-17 * sum {
            break;
        }
    }
    sum
}
