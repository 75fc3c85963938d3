//! The augmented model: an extended Randles model with effects of the catalogue added, in frequency
//! and in time.
//!
//! V(t) = U(z) − f₀·R·i − Σ vⱼ + Σ additions. The branches of the [`Network`] are stepped exactly
//! for a current that is held or changes linearly over a sample; effects with a state of their own
//! are advanced half a step before and half a step after them (Strang splitting, second order).
//! [`Player`] simulates records; [`impedance`] is the small-signal limit.

mod harmonics;
mod kept;
mod play;

pub use harmonics::{HarmonicPoint, harmonics};
pub use kept::{Augmented, Kept};
pub use play::{Between, Grid, Player};

use crate::contract::{Base, Effect, Network, Point, storage_ohm};
use num_complex::Complex64;

/// An effect with the values of its parameters.
#[derive(Clone, Copy)]
pub struct Added<'a> {
    /// The effect.
    pub effect: &'a dyn Effect,
    /// Values in the order of [`Effect::parameters`].
    pub p: &'a [f64],
}

/// Returns the network of a base with all additions.
pub fn network(base: &Base, added: &[Added<'_>]) -> Network {
    let mut network = Network::of(&base.erm);
    for a in added {
        a.effect.network(a.p, base, &mut network);
    }
    network
}

/// Returns the impedance of one point of a spectrum with all effects, Ω. Its base is the cell, or
/// `control_ohm` if a control is in the jig.
pub fn impedance(
    network: &Network,
    base: &Base,
    added: &[Added<'_>],
    at: &Point,
    control_ohm: Option<Complex64>,
) -> Complex64 {
    let z = control_ohm.unwrap_or_else(|| network.impedance(at.freq_hz) + storage_ohm(base, at));
    added
        .iter()
        .fold(z, |z, a| a.effect.impedance(a.p, base, at, z))
}
