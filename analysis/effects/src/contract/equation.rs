//! The law of an addition as numbers, for code that writes it in another language.

/// State equation of an effect of the cell, with its numbers. Currents are in A and positive for
/// discharge, z is the state of charge, U its open-circuit voltage, V the voltage at the terminals,
/// P the power that the resistances turn into heat, W. A factor acts on all resistances, and the
/// capacitances stay.
#[derive(Debug, Clone, PartialEq)]
pub enum Equation {
    /// A factor.
    Factor {
        /// Its value.
        factor: f64,
    },
    /// The factor max(1 + k(z − z_ref), least).
    FactorOfCharge {
        /// k.
        k: f64,
        /// z_ref.
        reference: f64,
        /// Least factor.
        least: f64,
    },
    /// A factor while the cell is charged.
    FactorOfCharging {
        /// Its value.
        factor: f64,
    },
    /// The factor exp(−g·h/(1 + b·h)), dh/dt = P − h/τ.
    FactorOfHeat {
        /// g, 1/J.
        per_j: f64,
        /// b, 1/J.
        bend_per_j: f64,
        /// τ, s.
        tau_s: f64,
    },
    /// V += s·r, C·dr/dt = P − i·(T + r)·s − C·r/τ.
    Entropic {
        /// s, V/K.
        v_per_k: f64,
        /// T, K.
        start_k: f64,
        /// C, J/K.
        heat_j_per_k: f64,
        /// τ, s.
        tau_s: f64,
    },
    /// V += M·h, dh/dt = −|γ·i|·(h + sgn i).
    Hysteresis {
        /// M, V.
        m_v: f64,
        /// γ, 1/C.
        per_coulomb: f64,
    },
    /// V += U(z + q(z − z₀)) − U(z); z₀ is z at the start.
    Slope {
        /// q.
        excess: f64,
    },
    /// V += c(z − z₀)²; z₀ is z at the start.
    Curvature {
        /// c, V.
        half_v: f64,
    },
    /// V += U(z − r·t) − U(z); t is the time since the start.
    Leak {
        /// r, 1/s.
        per_s: f64,
    },
    /// V += U(z − Σx) − U(z), τ·dx/dt = g·i − x for each element.
    Surface {
        /// The elements.
        elements: Vec<Relaxation>,
    },
    /// V += s·ln(max(1 − c, least)), τ·dc/dt = g·i − c.
    Depletion {
        /// g and τ.
        missing: Relaxation,
        /// s, V.
        scale_v: f64,
        /// Share of the salt that always stays.
        least: f64,
    },
}

/// τ·dx/dt = g·i − x.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Relaxation {
    /// g, 1/A.
    pub per_a: f64,
    /// τ, s.
    pub tau_s: f64,
}
