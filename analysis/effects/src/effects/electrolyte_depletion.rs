//! The current uses up the salt of the electrolyte.

use super::charge_transfer::thermal_v;
use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Parameter, Point, Range, Record,
    Relaxation,
};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "electrolyte_depletion",
    title: "depletion of the electrolyte",
    group: Group::Cell,
    mechanism: "The current takes up salt faster than diffusion brings it; the concentration \
    overpotential grows without limit where none is left.",
    state_equation: "τ·dc/dt = −c + g·i, V += (2kT/e)(1 − t₊)·ln(1 − c); c the part of the salt \
    that is missing, g in 1/A, τ in s, t₊ = 0.38 fixed",
    impedance: "Z += (2kT/e)(1 − t₊)·g/((1 − g·i_bias)(1 + jωτ))",
    source: "Newman and Thomas-Alyea, Electrochemical Systems, concentration cells; t₊: Valøen and \
    Reimers, J. Electrochem. Soc. 152 (2005) A882",
    signature: "resistance grows within a pulse of high discharge current, more than in proportion",
    confounders: &["rc_slow", "diffusion", "surface_soc", "soc_resistance"],
    contains: &[],
    experiment: "pulses of 5 s and more from 30 to 100 A",
};

/// Transference number of the cation.
const TRANSFERENCE: f64 = 0.38;
/// Part of the salt that always stays.
const LEAST: f64 = 1e-3;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct ElectrolyteDepletion;

impl Effect for ElectrolyteDepletion {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let greatest_a = base.facts.greatest_a;
        if greatest_a <= 0.0 {
            return Vec::new();
        }
        // Pulses shorter than τ reach a part of g·i only, so that g·i may exceed 1.
        let upper = 4.0 / greatest_a;
        let range = Range {
            lower: 0.2,
            upper: 500.0,
        };
        vec![
            Parameter::strength("g_per_a", "1/A", Range { lower: 0.0, upper }, 0.02 * upper),
            Parameter::shape("tau_s", "s", range, vec![3.0, 30.0]),
        ]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        let left = (1.0 - p[0] * at.bias_a).max(LEAST);
        let r_ohm = scale_v(base.facts.temperature_degc) * p[0] / left;
        z_ohm + r_ohm / Complex64::new(1.0, std::f64::consts::TAU * at.freq_hz * p[1])
    }

    fn dynamics(&self, p: &[f64], base: &Base, _record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Salt {
            g_per_a: p[0],
            tau_s: p[1],
            scale_v: scale_v(base.facts.temperature_degc),
            missing: 0.0,
        }))
    }

    fn equation(&self, p: &[f64], base: &Base) -> Option<Equation> {
        Some(Equation::Depletion {
            missing: Relaxation {
                per_a: p[0],
                tau_s: p[1],
            },
            scale_v: scale_v(base.facts.temperature_degc),
            least: LEAST,
        })
    }
}

/// (2kT/e)(1 − t₊), V.
fn scale_v(temperature_degc: f64) -> f64 {
    2.0 * thermal_v(temperature_degc) * (1.0 - TRANSFERENCE)
}

struct Salt {
    g_per_a: f64,
    tau_s: f64,
    scale_v: f64,
    missing: f64,
}

impl Dynamics for Salt {
    fn voltage_v(&self, _at: &Instant) -> f64 {
        self.scale_v * (1.0 - self.missing).max(LEAST).ln()
    }

    fn advance(&mut self, at: &Instant, step_s: f64) {
        self.missing +=
            -(-step_s / self.tau_s).exp_m1() * (self.g_per_a * at.current_a - self.missing);
    }
}
