//! The open-circuit voltage follows the temperature that the current makes.

use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Parameter, Range, Record,
};
use analysis_model::map::ZERO_DEGC_K;

static CARD: Card = Card {
    name: "entropic_heat",
    title: "entropic heat and open-circuit voltage over temperature",
    group: Group::Cell,
    mechanism: "The reaction's entropy gives off or takes up heat with the current's sign, and by \
    the same dU/dT the open-circuit voltage follows the temperature.",
    state_equation: "C·dΔT/dt = P − i·T·dU/dT − C·ΔT/τ, V += dU/dT·ΔT; P the power in the \
    resistances, dU/dT in V/K, C in J/K about 14.8 per Ah (70 g of 950 J/(kg·K) at 4.5 Ah), τ in \
    s; what the heat does to resistances is self_heating's",
    impedance: "none within the band",
    source: "Bernardi, Pawlikowski, Newman, J. Electrochem. Soc. 132 (1985) 5, with the reversible \
    term; heat capacity of a P45B cell",
    signature: "a slow shift of the voltage with the heat received, which lasts for minutes at \
    rest; Joule's part is the same for charge and discharge, the reversible part changes its sign",
    confounders: &["self_heating", "thermal_emf", "ocv_curvature", "hysteresis"],
    contains: &[],
    experiment: "bursts without net charge and a rest; open-circuit voltage at two temperatures",
};

/// Heat capacity over electric capacity, J/K per Ah: 0.070 kg · 950 J/(kg·K) / 4.5 Ah.
const HEAT_CAPACITY_J_PER_K_AH: f64 = 0.070 * 950.0 / 4.5;
/// Largest deviation of the heat capacity from it, as a factor.
const HEAT_CAPACITY_REACH: f64 = 2.0;

/// Entropy of 96 J/(mol K) over the Faraday constant, V/K.
const MOST_V_PER_K: f64 = 1e-3;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct EntropicHeat;

impl Effect for EntropicHeat {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 {
            return Vec::new();
        }
        let heat = HEAT_CAPACITY_J_PER_K_AH * base.ocv.capacity_ah;
        let around = Range {
            lower: heat / HEAT_CAPACITY_REACH,
            upper: heat * HEAT_CAPACITY_REACH,
        };
        vec![
            Parameter::strength(
                "du_dt_v_per_k",
                "V/K",
                Range {
                    lower: -6e-3,
                    upper: 6e-3,
                },
                1e-4,
            )
            .usually(
                Range {
                    lower: -MOST_V_PER_K,
                    upper: MOST_V_PER_K,
                },
                "the entropy of full cells stays below 96 J/(mol K), which is 1 mV/K (Viswanathan \
                et al., J. Power Sources 195 (2010) 3720)",
            ),
            Parameter::shape("heat_j_per_k", "J/K", around, vec![heat]),
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

    fn dynamics(&self, p: &[f64], _base: &Base, record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        Some(Box::new(Warmth {
            du_dt_v_per_k: p[0],
            start_k: record.temperature_degc + ZERO_DEGC_K,
            heat_capacity_j_per_k: p[1],
            cooling_s: p[2],
            rise_k: 0.0,
        }))
    }

    fn equation(&self, p: &[f64], base: &Base) -> Option<Equation> {
        Some(Equation::Entropic {
            v_per_k: p[0],
            start_k: base.facts.temperature_degc + ZERO_DEGC_K,
            heat_j_per_k: p[1],
            tau_s: p[2],
        })
    }
}

struct Warmth {
    du_dt_v_per_k: f64,
    start_k: f64,
    heat_capacity_j_per_k: f64,
    cooling_s: f64,
    /// ΔT.
    rise_k: f64,
}

impl Dynamics for Warmth {
    fn voltage_v(&self, _at: &Instant) -> f64 {
        self.du_dt_v_per_k * self.rise_k
    }

    fn asks_heat(&self) -> bool {
        true
    }

    fn advance(&mut self, at: &Instant, step_s: f64) {
        // C·dΔT/dt = P − i·(T₀ + ΔT)·dU/dT − C·ΔT/τ is linear in ΔT.
        let reversible_v = self.du_dt_v_per_k * self.start_k;
        let heating_k_per_s =
            (at.heat_w() - at.current_a * reversible_v) / self.heat_capacity_j_per_k;
        let rate =
            1.0 / self.cooling_s + at.current_a * self.du_dt_v_per_k / self.heat_capacity_j_per_k;
        let x = rate * step_s;
        let held_s = if x.abs() > 1e-9 {
            -(-x).exp_m1() / rate
        } else {
            step_s
        };
        self.rise_k += held_s * (heating_k_per_s - rate * self.rise_k);
    }
}
