//! The logged current lags behind the one that flows.

use super::{Base, Card, Effect, Group, Parameter, Range, Record};

static CARD: Card = Card {
    name: "current_smoothing",
    title: "smoothing of the logged current",
    group: Group::Bench,
    mechanism: "The current channel of the time records averages or filters, so that the voltage steps before the current does.",
    state_equation: "τ·di_logged/dt = i − i_logged, so that i = i_logged + τ·di_logged/dt; τ in s",
    impedance: "none: the sweeps' current is fitted at one frequency by another instrument",
    source: "first-order low-pass; its integral over a step, mean i = mean i_logged + τ·Δi_logged/Δt, is exact",
    signature: "at an edge the voltage has moved and the current has not yet; nothing later",
    confounders: &["channel_bandwidth", "rc_slow"],
    experiment: "a current step into a shunt, logged as fast as can be",
};

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
        vec![Parameter::strength("tau_s", "s", Range { lower: 0.0, upper }, 0.01 * upper)]
    }

    /// The slope is that of the step that follows a sample: a held current flows in it, and the charge of every step is right. The last sample takes
    /// the slope before it.
    fn current(&self, p: &[f64], record: &Record<'_>, current_a: &mut [f64]) {
        let mut slope_a_per_s = 0.0;
        for k in 0..current_a.len() {
            if let (Some(next_a), Some(next_s)) = (current_a.get(k + 1), record.time_s.get(k + 1)) {
                let step_s = next_s - record.time_s[k];
                if step_s > 0.0 {
                    slope_a_per_s = (next_a - current_a[k]) / step_s;
                }
            }
            current_a[k] += p[0] * slope_a_per_s;
        }
    }
}
