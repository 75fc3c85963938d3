//! Joule heat warms the cell, warmth lowers its resistance.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Modulation, Parameter, Point, Range,
    Record,
};
use analysis_model::map::ZERO_DEGC_K;
use num_complex::Complex64;

static CARD: Card = Card {
    name: "self_heating",
    title: "Joule self-heating with Arrhenius resistance",
    group: Group::Cell,
    mechanism: "The current's heat warms the cell above its surroundings; ions and charge transfer \
    follow Arrhenius, so that all resistances fall.",
    state_equation: "C·dΔT/dt = P − ΔT/R_th, P the power in the resistances, R = \
    R_ref·exp(−κ·ΔT/(1 + ΔT/T)); with the heat kept h = C·ΔT: dh/dt = P − h/τ; g = κ/C in 1/J, τ = \
    R_th·C in s; C is taken as 14.8 J/K per Ah for 1 + ΔT/T",
    impedance: "under a direct current I that has flowed for t, all R with the heat \
    I²·R·τ·(1 − exp(−t/τ)); at rest none: g = κ/C does not give κ alone, so that the start \
    temperature of a run is left out",
    source: "Bernardi, Pawlikowski, Newman, J. Electrochem. Soc. 132 (1985) 5, without the \
    reversible term; Arrhenius: 1/T − 1/(T + ΔT) = ΔT/T²/(1 + ΔT/T)",
    signature: "resistance falls with the heat received, the same for both signs, lasts for \
    minutes",
    confounders: &[
        "soc_resistance",
        "butler_volmer",
        "shunt_heating",
        "entropic_heat",
        "ageing",
    ],
    contains: &[],
    experiment: "bursts of ±100 A without net charge; a thermocouple",
};

/// Heat capacity of a cell by its capacity, J/(K·Ah): that of a P45B; only the bend of Arrhenius'
/// law hangs on it, a few percent of the effect.
const HEAT_PER_AH: f64 = 14.8;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct SelfHeating;

impl Effect for SelfHeating {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 {
            return Vec::new();
        }
        // κ up to 0.08 /K over a heat capacity of at least 10 J/K per Ah (a P45B cell has 14.8).
        let upper = 0.08 / (10.0 * base.ocv.capacity_ah);
        vec![
            Parameter::strength("g_per_j", "1/J", Range { lower: 0.0, upper }, 0.05 * upper),
            Parameter::shape(
                "tau_s",
                "s",
                Range {
                    lower: 60.0,
                    upper: 6000.0,
                },
                vec![600.0],
            ),
        ]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell || at.bias_a == 0.0 {
            return z_ohm;
        }
        let power_w = at.bias_a.powi(2) * base.erm.dc_resistance_ohm();
        let heat = Heat {
            g_per_j: p[0],
            tau_s: p[1],
            bend_per_j: bend_per_j(base, at.temperature_degc),
            heat_j: -power_w * p[1] * (-at.held_s / p[1]).exp_m1(),
        };
        z_ohm + Modulation::all(heat.factor()).change_ohm(&base.erm, at.freq_hz)
    }

    fn dynamics(&self, p: &[f64], base: &Base, record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Heat {
            g_per_j: p[0],
            tau_s: p[1],
            bend_per_j: bend_per_j(base, record.temperature_degc),
            heat_j: 0.0,
        }))
    }

    fn equation(&self, p: &[f64], base: &Base) -> Option<Equation> {
        Some(Equation::FactorOfHeat {
            per_j: p[0],
            bend_per_j: bend_per_j(base, base.facts.temperature_degc),
            tau_s: p[1],
        })
    }
}

/// Relative rise of the temperature per heat kept, 1/J.
fn bend_per_j(base: &Base, start_degc: f64) -> f64 {
    1.0 / (HEAT_PER_AH * base.ocv.capacity_ah * (start_degc + ZERO_DEGC_K))
}

struct Heat {
    g_per_j: f64,
    tau_s: f64,
    /// Relative rise of the temperature per heat kept, 1/J.
    bend_per_j: f64,
    /// Heat kept, J.
    heat_j: f64,
}

impl Heat {
    /// Factor on all resistances.
    fn factor(&self) -> f64 {
        (-self.g_per_j * self.heat_j / (1.0 + self.bend_per_j * self.heat_j)).exp()
    }
}

impl Dynamics for Heat {
    fn modulation(&self, _at: &Instant) -> Modulation {
        Modulation::all(self.factor())
    }

    fn asks_heat(&self) -> bool {
        true
    }

    fn advance(&mut self, at: &Instant, step_s: f64) {
        let decay = (-step_s / self.tau_s).exp();
        self.heat_j = decay * self.heat_j + (1.0 - decay) * self.tau_s * at.heat_w();
    }
}
