//! Inductance of the cell and its leads.

use crate::contract::{Base, Card, Effect, Group, Parameter, Point, Range};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "inductance",
    title: "series inductance",
    group: Group::Bench,
    mechanism: "The loop of cell, holder and sense leads encloses a magnetic field; a different \
    fixture encloses a different one.",
    state_equation: "v = L·di/dt; L in H; not felt in records, whose samples are far apart beside \
    L/R",
    impedance: "Z → Z + jωL of the cell in the jig; a control has its own loop",
    source: "law of induction",
    signature: "imaginary part proportional to the frequency at the top of the band, the same at \
    any state of charge; never negative",
    confounders: &["time_skew", "inductance_lossy", "channel_bandwidth"],
    contains: &[],
    experiment: "sweeps of shunts of two values: a skew scales with the resistance, an inductance \
    does not",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct Inductance;

impl Effect for Inductance {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let Some(highest_hz) = base.facts.highest_hz else {
            return Vec::new();
        };
        // Beyond this the cell would be a coil at the top of the band.
        let upper = base.erm.dc_resistance_ohm() / (std::f64::consts::TAU * highest_hz);
        vec![Parameter::strength(
            "inductance_h",
            "H",
            Range { lower: 0.0, upper },
            0.01 * upper,
        )]
    }

    fn impedance(&self, p: &[f64], _base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        z_ohm + Complex64::new(0.0, std::f64::consts::TAU * at.freq_hz * p[0])
    }
}
