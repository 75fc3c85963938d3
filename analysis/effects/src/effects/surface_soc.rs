//! The open-circuit voltage is that of the particles' surface.

use super::ladder::{Rung, reflective};
use crate::contract::{
    Base, Card, Dynamics, Effect, Equation, Group, Instant, Parameter, Point, Range, Record,
    Relaxation, quantity::log_grid,
};
use analysis_model::ocv::OcvCurve;
use num_complex::Complex64;

static CARD: Card = Card {
    name: "surface_soc",
    title: "open-circuit voltage at the surface concentration",
    group: Group::Cell,
    mechanism: "Diffusion within the particles is slow: their surface, which makes the voltage, \
    empties and fills before their middle.",
    state_equation: "z_s = z − Σx_k, dx_k/dt = (6d·i/(k²π²) − x_k)·k²π²/τ_d, V += U(z_s) − U(z); d \
    in 1/A, τ_d in s; close terms merged, the far ones lumped",
    impedance: "Z += 3d·U'(z)·(coth(√(jωτ_d))/√(jωτ_d) − 1/(jωτ_d))",
    source: "Crank, The Mathematics of Diffusion, chapter 4: plane sheet with constant flux at the \
    surface",
    signature: "as diffusion, but with the slope of the open-circuit voltage at the surface: \
    depends on the state of charge and on the sign near a knee",
    confounders: &[
        "diffusion",
        "warburg",
        "rc_slow",
        "electrolyte_depletion",
        "ocv_curvature",
    ],
    contains: &[],
    experiment: "pulses at three states of charge, one near a knee of the curve",
};

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct SurfaceSoc;

impl Effect for SurfaceSoc {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        let greatest_a = base.facts.greatest_a;
        if greatest_a <= 0.0 {
            return Vec::new();
        }
        let upper = 1.0 / greatest_a;
        let slowest_s = base.facts.slowest_s();
        let range = Range {
            lower: 10.0 * base.facts.fastest_s(),
            upper: 30.0 * slowest_s,
        };
        vec![
            Parameter::strength("d_per_a", "1/A", Range { lower: 0.0, upper }, 0.01 * upper),
            Parameter::shape(
                "tau_s",
                "s",
                range,
                log_grid(0.03 * slowest_s, 3.0 * slowest_s, 3),
            ),
        ]
    }

    fn impedance(&self, p: &[f64], base: &Base, at: &Point, z_ohm: Complex64) -> Complex64 {
        if !at.is_cell {
            return z_ohm;
        }
        let s = Complex64::new(0.0, std::f64::consts::TAU * at.freq_hz * p[1]);
        let shape: Complex64 = reflective()
            .iter()
            .map(|r| r.part / (1.0 + s * r.time))
            .sum();
        z_ohm + p[0] * base.ocv.slope_v(at.soc) * shape
    }

    fn dynamics(&self, p: &[f64], base: &Base, _record: &Record<'_>) -> Option<Box<dyn Dynamics>> {
        let states = reflective()
            .iter()
            .map(|rung| State {
                rung: *rung,
                x: 0.0,
                decay: 1.0,
            })
            .collect();
        Some(Box::new(Surface {
            d_per_a: p[0],
            tau_s: p[1],
            step_s: 0.0,
            states,
            curve: base.ocv.clone(),
        }))
    }

    fn equation(&self, p: &[f64], _base: &Base) -> Option<Equation> {
        let elements = reflective().iter().map(|rung| Relaxation {
            per_a: p[0] * rung.part,
            tau_s: p[1] * rung.time,
        });
        Some(Equation::Surface {
            elements: elements.collect(),
        })
    }
}

struct Surface {
    d_per_a: f64,
    tau_s: f64,
    /// Step that the decays belong to, s.
    step_s: f64,
    states: Vec<State>,
    curve: OcvCurve,
}

struct State {
    rung: Rung,
    /// Deviation of the surface below the mean that this rung adds, as SOC.
    x: f64,
    /// Factor that one step leaves of the deviation.
    decay: f64,
}

impl Dynamics for Surface {
    fn voltage_v(&self, at: &Instant) -> f64 {
        let gradient: f64 = self.states.iter().map(|s| s.x).sum();
        self.curve.voltage_v(at.soc - gradient) - at.ocv_v
    }

    fn advance(&mut self, at: &Instant, step_s: f64) {
        if step_s != self.step_s {
            self.step_s = step_s;
            self.states
                .iter_mut()
                .for_each(|s| s.decay = (-step_s / (self.tau_s * s.rung.time)).exp());
        }
        let steady = self.d_per_a * at.current_a;
        for s in &mut self.states {
            s.x = s.decay * s.x + (1.0 - s.decay) * s.rung.part * steady;
        }
    }
}
