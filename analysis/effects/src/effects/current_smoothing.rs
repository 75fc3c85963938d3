//! The logged current lags behind the one that flows.

use crate::contract::{Base, Card, Effect, Group, Parameter, Range, Record};

static CARD: Card = Card {
    name: "current_smoothing",
    title: "smoothing of the logged current",
    group: Group::Bench,
    mechanism: "The current channel of the time records averages or filters, so that the voltage \
    steps before the current does.",
    state_equation: "τ·dy/dt = i − y, i_logged the mean of y over a sampling interval; τ in s",
    impedance: "none: the sweeps' current is fitted at one frequency by another instrument",
    source: "first-order low-pass averaged over the sampling interval, inverted step by step",
    signature: "at an edge the voltage has moved and the current has not yet; nothing later",
    confounders: &["channel_bandwidth", "rc_slow"],
    contains: &[],
    experiment: "a current step into a shunt, logged as fast as can be",
};

/// Part of a step's mean that must be new: below it, nothing is left to undo the lag from.
const LEAST_NEW: f64 = 1e-3;

/// See [`Effect::card`].
#[derive(Debug)]
pub(super) struct CurrentSmoothing;

impl Effect for CurrentSmoothing {
    fn card(&self) -> &'static Card {
        &CARD
    }

    fn parameters(&self, base: &Base) -> Vec<Parameter> {
        if base.facts.longest_s <= 0.0 {
            return Vec::new();
        }
        let upper = (0.1 * base.facts.longest_s).min(5.0);
        let typical = (0.01 * upper).min(0.1 * base.facts.shortest_s);
        vec![Parameter::strength(
            "tau_s",
            "s",
            Range { lower: 0.0, upper },
            typical,
        )]
    }

    /// Inverts exactly a first-order lag whose output is averaged over each step: with m = (τ/h)(1
    /// − exp(−h/τ)), the part of a step's mean that is still the lagging state y, i = (logged −
    /// m·y)/(1 − m) and y moves to i + (y − i)exp(−h/τ).
    fn current(&self, p: &[f64], record: &Record<'_>, current_a: &mut [f64]) {
        let tau_s = p[0];
        if tau_s <= 0.0 {
            return;
        }
        let mut lagging_a = current_a.first().copied().unwrap_or(0.0);
        let mut step_s = 1.0;
        for (k, logged_a) in current_a.iter_mut().enumerate() {
            if let Some(next_s) = record.time_s.get(k + 1) {
                step_s = (next_s - record.time_s[k]).max(1e-9);
            }
            let gone = -(-step_s / tau_s).exp_m1();
            let m = tau_s / step_s * gone;
            let flowed_a = (*logged_a - m * lagging_a) / (1.0 - m).max(LEAST_NEW);
            lagging_a = flowed_a + (lagging_a - flowed_a) * (1.0 - gone);
            *logged_a = flowed_a;
        }
    }
}
