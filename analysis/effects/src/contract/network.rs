//! The network between the open-circuit voltage and the terminals.

use super::branch::{self, Branch, Gain, Ramp};
use analysis_model::model::{Erm, RcBranch};
use num_complex::Complex64;

/// Series resistance and branches. The first branches are the base's, in its order, unless an
/// effect has replaced one.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// Series resistance, Ω.
    pub r_ohm: f64,
    /// Branches in series.
    pub branches: Vec<Branch>,
}

impl Network {
    /// Creates the network of an extended Randles model.
    pub fn of(erm: &Erm) -> Self {
        let branches = erm
            .branches
            .iter()
            .map(|b| Branch::linear(b.r_ohm, b.time_constant_s()))
            .collect();
        Self {
            r_ohm: erm.r_ohm,
            branches,
        }
    }

    /// Returns the same for small signals as an extended Randles model. Branches without resistance
    /// are left out.
    pub fn linearised(&self) -> Erm {
        let branches = self.branches.iter().filter(|b| b.r_ohm != 0.0);
        Erm {
            r_ohm: self.r_ohm,
            branches: branches
                .map(|b| RcBranch {
                    r_ohm: b.r_ohm,
                    c_f: b.tau_s / b.r_ohm,
                })
                .collect(),
        }
    }

    /// Moves the voltages (V) of the branches over a step in which the current (A) and a factor on
    /// the resistances go straight from one value to another. In a branch that is far faster than
    /// the step the end alone counts; one that is not linear sees the mean that a linear one would.
    pub fn advance(&self, states_v: &mut [f64], factors: Ramp, currents_a: Ramp, step_s: f64) {
        let mean = 0.5 * (factors.start + factors.end);
        let (from_a, to_a) = (
            currents_a.start * factors.start / mean,
            currents_a.end * factors.end / mean,
        );
        for (v, b) in states_v.iter_mut().zip(&self.branches) {
            let gain = Gain::new(b, mean, step_s, true);
            let pushed_v = gain.start * from_a + gain.end * to_a;
            *v = if b.is_linear() {
                gain.decay * *v + pushed_v
            } else {
                branch::step(b, mean, *v, pushed_v / (gain.start + gain.end), step_s)
            };
        }
    }

    /// Returns the power into the capacitances, W, at voltages (V) of the branches, a current (A)
    /// and a factor on their resistances.
    pub fn stored_w(&self, states_v: &[f64], current_a: f64, factor: f64) -> f64 {
        states_v
            .iter()
            .zip(&self.branches)
            .filter(|(_, b)| b.r_ohm != 0.0)
            .map(|(v, b)| v * (current_a - b.conducted_a(*v, factor)))
            .sum()
    }

    /// Returns the impedance for small signals, Ω.
    pub fn impedance(&self, freq_hz: f64) -> Complex64 {
        let omega = std::f64::consts::TAU * freq_hz;
        self.branches
            .iter()
            .fold(Complex64::new(self.r_ohm, 0.0), |z, b| {
                let x = omega * b.tau_s;
                let scale = b.r_ohm / (1.0 + x * x);
                z + Complex64::new(scale, -scale * x)
            })
    }

    /// Returns the resistance at zero frequency, Ω.
    pub fn dc_resistance_ohm(&self) -> f64 {
        self.r_ohm + self.branches.iter().map(|b| b.r_ohm).sum::<f64>()
    }
}
