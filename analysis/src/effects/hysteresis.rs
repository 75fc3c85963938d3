//! The open-circuit voltage depends on where the charge came from.

use super::quantity::log_grid;
use super::{Base, Card, Dynamics, Effect, Group, Instant, Parameter, Point, Range, Record};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "hysteresis",
    title: "hysteresis of one state",
    group: Group::Cell,
    mechanism: "Particles fill and empty along different paths, so that the voltage at rest stays lower after a discharge than after a charge.",
    state_equation: "dh/dt = −|γi/3600Q|·(h + sgn i), V += M·h, h = 0 at the start of a record; M in V",
    impedance: "Z += M·γ/(jω·3600Q), from h = 0",
    source: "Plett, Battery Management Systems I, chapter 2: one-state hysteresis",
    signature: "depends on the charge since the last reversal, not on time; rest does not remove it",
    confounders: &["ocv_slope", "rc_slow", "diffusion", "current_asymmetry"],
    contains: &[],
    experiment: "minor loops: charge and discharge of growing size with rests",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct Hysteresis;

impl Effect for Hysteresis {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let widest = base.facts.widest_soc;
        if widest <= 0.0 {
            return Vec::new();
        }
        // Below 1/γ = 3 × the widest reach the state is a slope of the open-circuit voltage.
        let range = Range { lower: 0.3 / widest, upper: 1000.0 / widest };
        vec![
            Parameter::strength("m_v", "V", Range { lower: 0.0, upper: 0.2 }, 2e-3),
            Parameter::shape("gamma", "", range, log_grid(3.0 / widest, 60.0 / widest, 3)),
        ]
    }

    /// From h = 0 the response to a small swing is of first order, the same in both directions.
    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        let per_c = p[0] * p[1] / (3600.0 * base.ocv.capacity_ah);
        z_ohm - Complex64::new(0.0, per_c / (std::f64::consts::TAU * at.freq_hz))
    }

    fn dynamics(&self, p: &[f64], base: &Base, _record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Path { m_v: p[0], gamma_per_c: p[1] / (3600.0 * base.ocv.capacity_ah), h: 0.0 }))
    }
}

struct Path {
    m_v: f64,
    /// γ over the capacity, 1/C.
    gamma_per_c: f64,
    h: f64,
}

impl Dynamics for Path {
    fn voltage_v(&self, _at: &Instant) -> f64 {
        self.m_v * self.h
    }

    fn advance(&mut self, at: &Instant, step_s: f64) {
        let moved = self.gamma_per_c * at.current_a.abs() * step_s;
        // At rest the exponent is zero and the sign does not matter.
        let end = -at.current_a.signum();
        self.h += -(-moved).exp_m1() * (end - self.h);
    }
}
