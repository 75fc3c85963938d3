//! The open-circuit voltage depends on the direction from which the charge came.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Moved, Parameter, Point, Range, Record,
    quantity::log_grid,
};
use num_complex::Complex64;

static CARD: Card = Card {
    name: "hysteresis",
    title: "hysteresis of one state",
    group: Group::Cell,
    mechanism: "Particles fill and empty along different paths, so that the voltage at rest stays \
    lower after a discharge than after a charge.",
    state_equation: "dh/dt = −|γi/3600Q|·(h + sgn i), V += M·(h − h₀); h₀ at the start of a record \
    is 0, or what all charge since the first record has made of that one's; M in V",
    impedance: "Z += M·γ/(jω·3600Q), from h = 0",
    source: "Plett, Battery Management Systems I, chapter 2: one-state hysteresis",
    signature: "depends on the charge since the last reversal, not on time; rest does not remove \
    it",
    confounders: &["ocv_slope", "rc_slow", "diffusion", "current_asymmetry"],
    contains: &[],
    experiment: "minor loops: charge and discharge of growing size with rests",
};

/// Largest error of the state of charge at the start: on a flat curve a voltage contains little
/// information about it.
const MOST_OFF: f64 = 0.02;

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
        let range = Range {
            lower: 0.3 / widest,
            upper: 1000.0 / widest,
        };
        vec![
            Parameter::strength(
                "m_v",
                "V",
                Range {
                    lower: 0.0,
                    upper: 0.2,
                },
                2e-3,
            ),
            Parameter::shape("gamma", "", range, log_grid(3.0 / widest, 60.0 / widest, 3)),
            // Each record from the middle, or from where all charge since the first one has led.
            Parameter::choice("carried", 2),
            // Wider than can be, for what lies at a bound is not named.
            Parameter::state(
                "first",
                Range {
                    lower: -1.5,
                    upper: 1.5,
                },
                vec![0.9],
                2,
                1.0,
            ),
        ]
    }

    fn tells_repeats_apart(&self, p: &[f64]) -> bool {
        p[2] > 0.5
    }

    /// Prediction starts from the middle: the state at the end of the campaign does not hold for
    /// the cell that is predicted.
    fn predicting(&self, mut p: Vec<f64>) -> Vec<f64> {
        p[2] = 0.0;
        p
    }

    /// From h = 0 the response to a small swing is of first order, and equal in both directions.
    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        let per_coulomb = p[0] * p[1] / (3600.0 * base.ocv.capacity_ah);
        z_ohm - Complex64::new(0.0, per_coulomb / (std::f64::consts::TAU * at.freq_hz))
    }

    fn dynamics(&self, p: &[f64], base: &Base, record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        let gamma_per_coulomb = p[1] / (3600.0 * base.ocv.capacity_ah);
        let carried = || {
            record
                .before
                .iter()
                .fold(p[3].clamp(-1.0, 1.0), |h, moved| {
                    after(h, gamma_per_coulomb, *moved)
                })
        };
        let start = if p[2] > 0.5 { carried() } else { 0.0 };
        let slope_v = base.ocv.at(record.soc).1;
        let soc_off = (p[0] * start / slope_v.max(1e-9)).clamp(-MOST_OFF, MOST_OFF);
        Some(Box::new(Path {
            m_v: p[0],
            gamma_per_coulomb,
            start,
            h: start,
            soc_off,
            slope_v,
        }))
    }

    fn equation(&self, p: &[f64], base: &Base) -> Option<Equation> {
        // A state that the charge before has made is not known in a prediction.
        (p[2] <= 0.5).then(|| Equation::Hysteresis {
            m_v: p[0],
            per_coulomb: p[1] / (3600.0 * base.ocv.capacity_ah),
        })
    }
}

/// Returns the state after a charge. Swings that are small against 1/γ wear off the previous state,
/// regardless of their direction.
fn after(h: f64, gamma_per_coulomb: f64, moved: Moved) -> f64 {
    if moved.through_coulomb <= 0.0 {
        return h;
    }
    h - (-gamma_per_coulomb * moved.through_coulomb).exp_m1()
        * (moved.charge_coulomb / moved.through_coulomb - h)
}

struct Path {
    m_v: f64,
    /// γ over the capacity, 1/C.
    gamma_per_coulomb: f64,
    start: f64,
    h: f64,
    /// Error of the state of charge at the start, positive if the reading was too high. It was read
    /// from a voltage that contained M·h₀.
    soc_off: f64,
    /// Slope of the open-circuit voltage there, V.
    slope_v: f64,
}

impl Dynamics for Path {
    fn voltage_v(&self, at: &Instant) -> f64 {
        self.m_v * (self.h - self.start) + (self.slope_v - at.slope_v) * self.soc_off
    }

    fn advance(&mut self, at: &Instant, step_s: f64) {
        self.h = after(
            self.h,
            self.gamma_per_coulomb,
            Moved::one_way(-at.current_a * step_s),
        );
    }
}
