//! The voltage channel is read later than the current channel.

use super::{Base, Card, Effect, Group, Parameter, Point, Range};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "time_skew",
    title: "time skew between voltage and current",
    group: Group::Bench,
    mechanism: "Voltage and current are not sampled at the same instant: different delays of probes, amplifiers or channels.",
    state_equation: "u(t) → u(t − Δt); Δt in s, positive where the voltage comes late",
    impedance: "Z → (Z + R)·exp(−jωΔt) − R; R in Ω lies between the cell and the ground of the channels: where one of two channels against ground is late, it is \
        so with what lies below the cell too",
    source: "delay theorem of the Fourier transform",
    signature: "phase proportional to the frequency at the top of the band, on every impedance alike",
    confounders: &["inductance", "channel_bandwidth"],
    contains: &[],
    experiment: "sweeps of shunts of two values: the imaginary part scales with the resistance",
};

/// What lies below the cell, as a part of its resistance: as good as nothing, and what wires, shunt and further cells make at most.
const NOTHING: f64 = 1e-3;
const MOST: f64 = 30.0;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct TimeSkew;

impl Effect for TimeSkew {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let Some(highest_hz) = base.facts.highest_hz else { return Vec::new() };
        let most_s = 0.1 / highest_hz;
        let (little_ohm, much_ohm) = (NOTHING * base.erm.dc_resistance_ohm(), MOST * base.erm.dc_resistance_ohm());
        vec![
            Parameter::strength("delay_s", "s", Range { lower: -most_s, upper: most_s }, 1e-2 * most_s),
            Parameter::shape("below_ohm", "Ω", Range { lower: little_ohm, upper: much_ohm }, vec![little_ohm, 0.1 * much_ohm]),
        ]
    }

    fn impedance(&self, p: &[f64], _base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        (z_ohm + p[1]) * Complex64::cis(-std::f64::consts::TAU * at.freq_hz * p[0]) - p[1]
    }
}
