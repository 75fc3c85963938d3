//! Inductance of conductors in which eddy currents flow.

use crate::contract::{Base, Card, Effect, Group, Parameter, Point, Range};
use num_complex::Complex64;
use std::f64::consts::TAU;

/// The frequency that the strength refers to, Hz.
const REFERENCE_HZ: f64 = 1000.0;

static CARD: Card = Card {
    name: "inductance_lossy",
    title: "inductance with skin effect",
    group: Group::Bench,
    mechanism: "Eddy currents in can, tabs and leads push the current to the surface: the loop \
    loses energy and its inductance falls with the frequency.",
    state_equation: "none in closed form; not felt in records, whose samples are far apart",
    impedance: "Z → Z + ω₀L·(jω/ω₀)ⁿ, ω₀ = 2π·1 kHz, L in H at ω₀, 0.5 ≤ n < 1, of the cell in the \
    jig",
    source: "skin effect: n = ½ for a thick conductor, 1 for a loop without losses; the \
    generalised inductor of impedance spectroscopy",
    signature: "real and imaginary part both rise at the top of the band",
    confounders: &["inductance", "time_skew", "channel_bandwidth", "cpe"],
    contains: &["inductance"],
    experiment: "sweep up to 10 kHz; a sweep of a shunt of the cell's size in the same fixture",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct InductanceLossy;

impl Effect for InductanceLossy {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let Some(highest_hz) = base.facts.highest_hz else {
            return Vec::new();
        };
        let upper = base.erm.dc_resistance_ohm() / (TAU * highest_hz);
        vec![
            Parameter::strength(
                "inductance_h",
                "H",
                Range { lower: 0.0, upper },
                0.01 * upper,
            ),
            Parameter::shape(
                "exponent",
                "",
                Range {
                    lower: 0.5,
                    upper: 0.95,
                },
                vec![0.8, 0.6],
            ),
        ]
    }

    fn impedance(&self, p: &[f64], _base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        let size_ohm = TAU * REFERENCE_HZ * p[0] * (at.freq_hz / REFERENCE_HZ).powf(p[1]);
        z_ohm + Complex64::from_polar(size_ohm, std::f64::consts::FRAC_PI_2 * p[1])
    }
}
