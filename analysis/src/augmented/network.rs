//! The network between the open-circuit voltage and the terminals.

use crate::model::Erm;
use num_complex::Complex64;

/// How the resistor of a branch answers to its voltage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Law {
    /// i = v/R.
    Linear,
    /// i = sinh(βv/R)/β: Butler–Volmer with α = ½, β = 1/(2i₀), 1/A.
    Symmetric {
        /// β, 1/A, above zero.
        beta: f64,
    },
    /// i = (exp(2αβv/R) − exp(−2(1 − α)βv/R))/(2β): Butler–Volmer with any α and i₀ = 1/(2β); α = ½ is [`Law::Symmetric`].
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
    /// How its resistor answers.
    pub law: Law,
}

impl Branch {
    /// A linear branch.
    pub fn linear(r_ohm: f64, tau_s: f64) -> Self {
        Self { r_ohm, tau_s, law: Law::Linear }
    }
}

/// Series resistance and branches. The first branches are the base's, in its order, unless an effect has replaced one.
#[derive(Debug, Clone, PartialEq)]
pub struct Network {
    /// Series resistance, Ω.
    pub r_ohm: f64,
    /// Branches in series.
    pub branches: Vec<Branch>,
}

impl Network {
    /// The network of an extended Randles model.
    pub fn of(erm: &Erm) -> Self {
        let branches = erm.branches.iter().map(|b| Branch::linear(b.r_ohm, b.time_constant_s())).collect();
        Self { r_ohm: erm.r_ohm, branches }
    }

    /// Impedance for small signals, Ω.
    pub fn impedance(&self, freq_hz: f64) -> Complex64 {
        let omega = std::f64::consts::TAU * freq_hz;
        self.branches.iter().fold(Complex64::new(self.r_ohm, 0.0), |z, b| {
            let x = omega * b.tau_s;
            let scale = b.r_ohm / (1.0 + x * x);
            z + Complex64::new(scale, -scale * x)
        })
    }

    /// Resistance at zero frequency, Ω.
    pub fn dc_resistance_ohm(&self) -> f64 {
        self.r_ohm + self.branches.iter().map(|b| b.r_ohm).sum::<f64>()
    }
}
