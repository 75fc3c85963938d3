//! A profile as the inner loop wants it: a list of steps, each with the number of its length.

use super::BatchOptions;
use crate::forward::law::{Beyond, Demand};
use crate::forward::profile::Profile;

/// One step.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlanStep {
    /// Demand at the start and, before a jump, at the end.
    pub(super) demand: (f64, f64),
    /// Which of the lengths.
    pub(super) length: u32,
}

/// The steps of a profile and what they have in common.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    pub(super) demand: Demand,
    pub(super) beyond: Beyond,
    pub(super) start_s: f64,
    /// Different lengths, s.
    pub(super) lengths_s: Vec<f64>,
    pub(super) steps: Vec<PlanStep>,
}

impl Plan {
    pub(super) fn new(profile: &Profile, options: &BatchOptions) -> Self {
        let start_s = profile.time_s.first().copied().unwrap_or(0.0);
        let last_s = profile.time_s.last().copied().unwrap_or(0.0);
        // Equal steps written as decimals differ in their last bits; a quantum far below the rounding of the times makes them equal again.
        let quantum = (last_s.abs().max(start_s.abs()) * 2f64.powi(-48)).max(f64::MIN_POSITIVE);
        let mut plan = Self { demand: profile.demand, beyond: options.beyond, start_s, lengths_s: Vec::new(), steps: Vec::new() };
        plan.steps.reserve(profile.time_s.len());
        let mut known = std::collections::HashMap::new();
        let mut last = (f64::NAN, 0u32);
        profile.pieces(options.max_step_s).for_each(|piece| {
            if (piece.step_s - last.0).abs() > 0.5 * quantum || last.0.is_nan() {
                let rounded_s = (piece.step_s / quantum).round().max(1.0) * quantum;
                let next = plan.lengths_s.len() as u32;
                let length = *known.entry(rounded_s.to_bits()).or_insert(next);
                if length == next {
                    plan.lengths_s.push(rounded_s);
                }
                last = (rounded_s, length);
            }
            plan.steps.push(PlanStep { demand: (piece.from, piece.to), length: last.1 });
        });
        plan
    }

    /// When a step starts, s.
    pub(super) fn time_s(&self, step: usize) -> f64 {
        let lengths = self.steps.iter().take(step).filter_map(|s| self.lengths_s.get(s.length as usize));
        self.start_s + lengths.sum::<f64>()
    }
}
