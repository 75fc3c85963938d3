//! An arc of the base becomes a depressed one.

use crate::contract::{Base, Branch, Card, Effect, Group, Network, Parameter, Range};
use std::f64::consts::PI;

static CARD: Card = Card {
    name: "cpe",
    title: "depressed arc (constant-phase element)",
    group: Group::Cell,
    mechanism: "An interface is not the same everywhere: its time constants are spread about that \
    of the base's branch.",
    state_equation: "31 branches about τ, 0.7 apart in ln τ, whose parts of R sample the Cole–Cole \
    distribution; dv_k/dt = (R_k·i − v_k)/τ_k",
    impedance: "Z = R/(1 + (jωτ)^α); strength 1 − α",
    source: "Cole and Cole, J. Chem. Phys. 9 (1941) 341; trapezoidal rule with the pole's \
    remainder put onto the five middle branches",
    signature: "an arc flattened symmetrically in log f, a power law at its onset",
    confounders: &["diffusion", "warburg", "rc_slow"],
    contains: &[],
    experiment: "a wider band; bursts",
};

/// Distance of two branches in ln τ.
const SPACING: f64 = 0.7;
/// Branches on each side.
const SIDE: usize = 15;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct Cpe;

impl Effect for Cpe {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.erm.branches.is_empty() {
            return Vec::new();
        }
        vec![
            Parameter::strength(
                "one_minus_alpha",
                "",
                Range {
                    lower: 0.0,
                    upper: 0.6,
                },
                0.02,
            ),
            Parameter::choice("branch", base.erm.branches.len()),
        ]
    }

    fn network(&self, p: &[f64], _base: &Base, network: &mut Network) {
        let k = p[1] as usize;
        if p[0] == 0.0 || k >= network.branches.len() {
            return;
        }
        let whole = network.branches[k];
        let parts = parts(p[0]);
        network.branches[k].r_ohm = parts[0] * whole.r_ohm;
        for (j, part) in parts.iter().enumerate().skip(1) {
            let spread = (SPACING * j as f64).exp();
            let at = |tau_s: f64| Branch {
                r_ohm: part * whole.r_ohm,
                tau_s,
                ..whole
            };
            network
                .branches
                .extend([at(whole.tau_s / spread), at(whole.tau_s * spread)]);
        }
    }
}

/// Part of the resistance of the branch in the middle, then of each branch on one side of it.
///
/// The distribution G(y) = sin(πs)/(2π(cosh αy − cos πs)), α = 1 − s, has poles at ±jδ, δ = πs/α,
/// so near to the real axis for small s that the trapezoidal rule hΣG(jh)φ(jh) exceeds the integral
/// by (φ(jδ) + φ(−jδ))/(α(exp(2πδ/h) − 1)). Its even derivatives of φ are approximated by
/// differences over the middle branches; the part proportional to φ(0) follows from the sum of all
/// parts, which is 1.
fn parts(s: f64) -> [f64; SIDE + 1] {
    let alpha = 1.0 - s;
    let (sin, cos) = (PI * s).sin_cos();
    let mut parts = [0.0; SIDE + 1];
    for (j, part) in parts.iter_mut().enumerate().skip(1) {
        *part = SPACING * sin / (2.0 * PI * ((alpha * SPACING * j as f64).cosh() - cos));
    }
    parts[SIDE] /= -(-alpha * SPACING).exp_m1();
    let d = PI * s / (alpha * SPACING);
    let x = 2.0 * PI * d;
    let second = d / (2.0 * PI * alpha) * if x > 1e-12 { x / x.exp_m1() } else { 1.0 };
    let fourth = -second * (1.0 + d * d) / 12.0;
    parts[1] += second - 4.0 * fourth;
    parts[2] += fourth;
    parts[0] = 1.0 - 2.0 * parts[1..].iter().sum::<f64>();
    parts
}
