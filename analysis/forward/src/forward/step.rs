//! One step in time: the branches exactly for a current that changes linearly, the current by two
//! evaluations of the law.
//!
//! A branch obeys C·dv/dt = i − v/R. For i from i₀ to i₁ along a straight line over a step h its
//! solution is v(h) = a·v + R(φ − a)·i₀ + R(1 − φ)·i₁ with a = exp(−h/τ), φ = (1 − a)τ/h. The
//! current under a power or a load follows from the state; here i₀ is the current at the start and
//! i₁ the one at the end to which i₀ alone would lead: second order, and exact for a prescribed
//! current.

use super::law::{Drive, Reply};
use super::model::{SimModel, SimState};
use analysis_effects::contract::Ramp;

/// Action of one step length on each branch.
#[derive(Debug, Clone)]
pub(super) struct Coefficients {
    pub(super) step_s: f64,
    pub(super) branches: Vec<Gain>,
}

/// One branch over one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gain {
    /// a: factor that remains of its voltage.
    pub(super) decay: f64,
    /// Ω: its voltage per ampere at the start.
    pub(super) start: f64,
    /// Ω: its voltage per ampere at the end.
    pub(super) end: f64,
    /// φ = (1 − a)τ/h.
    pub(super) phi: f64,
}

impl Gain {
    pub(super) fn new(r_ohm: f64, c_f: f64, step_s: f64) -> Self {
        let x = step_s / (r_ohm * c_f);
        let decay = (-x).exp();
        let phi = if x > 0.0 { -(-x).exp_m1() / x } else { 1.0 };
        Self {
            decay,
            start: r_ohm * (phi - decay),
            end: r_ohm * (1.0 - phi),
            phi,
        }
    }
}

impl Coefficients {
    pub(super) fn new(model: &SimModel, step_s: f64) -> Self {
        Self {
            step_s,
            branches: model
                .erm
                .branches
                .iter()
                .map(|b| Gain::new(b.r_ohm, b.c_f, step_s))
                .collect(),
        }
    }
}

/// The replies at both ends of a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ends {
    pub(super) start: Reply,
    pub(super) end: Reply,
    /// The lower of the voltages behind the series resistance, V.
    pub(super) least_e_v: f64,
    /// The lower of the voltages at the terminals, V.
    pub(super) least_ccv_v: f64,
}

/// A model under a drive.
#[derive(Debug, Clone)]
pub(super) struct Integrator<'m> {
    pub(super) model: &'m SimModel,
    pub(super) drive: Drive,
    pub(super) capacity_coulomb: f64,
}

impl<'m> Integrator<'m> {
    pub(super) fn new(model: &'m SimModel, drive: Drive) -> Self {
        Self {
            model,
            drive,
            capacity_coulomb: model.capacity_coulomb(),
        }
    }

    /// E = OCV − Σvₖ, V.
    pub(super) fn e_v(&self, state: &SimState) -> f64 {
        self.model.ocv_v(state.soc).0 - state.v_rc_v.iter().sum::<f64>()
    }

    /// One step of the length of the coefficients.
    pub(super) fn step(
        &self,
        c: &Coefficients,
        from: &SimState,
        to: &mut SimState,
        demand: Ramp,
    ) -> Ends {
        let e0 = self.e_v(from);
        let start = self.drive.reply(e0, demand.start);
        let i0 = start.current_a;
        let held: f64 = c
            .branches
            .iter()
            .zip(&from.v_rc_v)
            .map(|(g, v)| g.decay * v + (g.start + g.end) * i0)
            .sum();
        let e1 = self
            .model
            .ocv_v(from.soc - c.step_s * i0 / self.capacity_coulomb)
            .0
            - held;
        let end = self.drive.reply(e1, demand.end);
        let i1 = end.current_a;
        for ((new, old), g) in to.v_rc_v.iter_mut().zip(&from.v_rc_v).zip(&c.branches) {
            *new = g.decay * old + g.start * i0 + g.end * i1;
        }
        to.soc = from.soc - 0.5 * c.step_s * (i0 + i1) / self.capacity_coulomb;
        let ccv_v = |e_v: f64, reply: &Reply| e_v - self.drive.r_ohm * reply.current_a;
        Ends {
            start,
            end,
            least_e_v: e0.min(e1),
            least_ccv_v: ccv_v(e0, &start).min(ccv_v(e1, &end)),
        }
    }

    /// Returns the thesis' three steps (equations 4.5–4.10) for any number of branches: explicit
    /// Euler on the charges.
    pub(super) fn euler(
        &self,
        step_s: f64,
        from: &SimState,
        to: &mut SimState,
        demand: f64,
    ) -> Reply {
        let reply = self.drive.reply(self.e_v(from), demand);
        for ((new, old), b) in to
            .v_rc_v
            .iter_mut()
            .zip(&from.v_rc_v)
            .zip(&self.model.erm.branches)
        {
            let into_capacitor_a = reply.current_a - old / b.r_ohm;
            *new = old + into_capacitor_a * step_s / b.c_f;
        }
        to.soc = from.soc - step_s * reply.current_a / self.capacity_coulomb;
        reply
    }
}
