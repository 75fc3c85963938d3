//! Diffusion into a depth that the data do not reach.

use crate::contract::{Base, Branch, Card, Effect, Facts, Group, Network, Parameter, Range};
use std::f64::consts::PI;

static CARD: Card = Card {
    name: "warburg",
    title: "semi-infinite diffusion",
    group: Group::Cell,
    mechanism: "Ions diffuse into a layer so deep that its far side is not felt within the longest \
    record or the lowest frequency.",
    state_equation: "v(t) = 2A√(t/π)·i after a step; A in Ω/√s; branches R = A·h·√τ/π on a \
    logarithmic grid of τ with spacing h = ln 10/2, ends lumped",
    impedance: "Z = A/√(jω)",
    source: "Barsoukov and Macdonald, Impedance Spectroscopy, chapter 2; 1/√s = (1/π)∫x^(−1/2)/(s \
    + x)dx by the trapezoidal rule in ln x",
    signature: "a slope of 45° at the bottom of the band, √t after an edge without an end",
    confounders: &["diffusion", "rc_slow", "cpe", "ocv_slope", "surface_soc"],
    contains: &[],
    experiment: "a pulse of a minute with half an hour of rest; a sweep down to 1 mHz",
};

/// Distance of two branches in ln τ: two in a decade, which leaves 4·exp(−π²/h) < 0.1 %.
const SPACING: f64 = 0.5 * std::f64::consts::LN_10;
/// Factor by which the branches reach beyond the data's slowest and fastest time.
const BEYOND: f64 = 10.0;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct Warburg;

impl Effect for Warburg {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let most = 3.0 * base.erm.dc_resistance_ohm() / base.facts.slowest_s().sqrt();
        vec![Parameter::strength(
            "a_ohm_per_sqrt_s",
            "Ω/√s",
            Range {
                lower: 0.0,
                upper: most,
            },
            0.01 * most,
        )]
    }

    fn network(&self, p: &[f64], base: &Base, network: &mut Network) {
        branches(&base.facts, |r, tau_s| {
            network.branches.push(Branch::linear(p[0] * r, tau_s));
        });
    }
}

/// Resistance (Ω per Ω/√s) and time constant (s) of each branch.
fn branches(facts: &Facts, mut push: impl FnMut(f64, f64)) {
    let slowest_s = BEYOND * facts.slowest_s();
    let count = ((slowest_s * BEYOND / facts.fastest_s()).ln() / SPACING)
        .ceil()
        .max(1.0) as i32;
    let scale = SPACING / PI;
    let tau_s = |k: i32| slowest_s * (-SPACING * f64::from(k)).exp();
    (0..=count).for_each(|k| push(scale * tau_s(k).sqrt(), tau_s(k)));
    let geometric = |power: f64| 1.0 / (power * SPACING).exp_m1();
    // Faster ones: the sum of their resistances, and their mean time constant.
    let fast_s = tau_s(count);
    push(
        scale * fast_s.sqrt() * geometric(0.5),
        fast_s * geometric(1.5) / geometric(0.5),
    );
    // Slower ones: the sum of their 1/C, and the mean of their rates weighted by it.
    let (elastance, rate) = (
        scale / slowest_s.sqrt() * geometric(0.5),
        geometric(1.5) / geometric(0.5) / slowest_s,
    );
    push(elastance / rate, 1.0 / rate);
}
