//! A profile as the inner loop wants it: runs of rows with steps of one length. The demands stay where they are, in the profile: a list of
//! all steps would cost as much memory traffic as a cell costs arithmetic.

use super::BatchOptions;
use crate::forward::law::{Beyond, Demand};
use crate::forward::profile::{Interpolation, Profile, parts};

/// Rows that follow each other, cut into equally many steps of one length.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    /// The first row.
    pub(super) first: usize,
    /// How many rows.
    pub(super) rows: usize,
    /// Steps in each row.
    pub(super) parts: u64,
    /// One over it.
    pub(super) share: f64,
    /// Which of the lengths.
    pub(super) length: usize,
}

/// The steps of a profile and what they have in common.
#[derive(Debug, Clone)]
pub(super) struct Plan<'p> {
    pub(super) demand: Demand,
    pub(super) beyond: Beyond,
    pub(super) start_s: f64,
    /// Different lengths, s.
    pub(super) lengths_s: Vec<f64>,
    pub(super) runs: Vec<Run>,
    value: &'p [f64],
    /// True where a row holds until the next.
    hold: bool,
}

impl<'p> Plan<'p> {
    pub(super) fn new(profile: &'p Profile, options: &BatchOptions) -> Self {
        let start_s = profile.time_s.first().copied().unwrap_or(0.0);
        let last_s = profile.time_s.last().copied().unwrap_or(0.0);
        // Equal steps written as decimals differ in their last bits; a quantum far below the rounding of the times makes them equal again.
        let quantum = (last_s.abs().max(start_s.abs()) * 2f64.powi(-48)).max(f64::MIN_POSITIVE);
        let hold = profile.interpolation == Interpolation::Hold;
        let (demand, beyond, value) = (profile.demand, options.beyond, profile.value.as_slice());
        let mut plan = Self { demand, beyond, start_s, lengths_s: Vec::new(), runs: Vec::new(), value, hold };
        let mut known = std::collections::HashMap::new();
        let (mut run, mut last_s) = (Run { first: 0, rows: 0, parts: 0, share: 1.0, length: 0 }, f64::NAN);
        for (row, pair) in profile.time_s.windows(2).enumerate() {
            let row_s = pair[1] - pair[0];
            let parts = parts(row_s, options.max_step_s);
            let step_s = if parts == 1 { row_s } else { row_s / parts as f64 };
            if parts == run.parts && (step_s - last_s).abs() <= 0.5 * quantum {
                run.rows += 1;
                continue;
            }
            last_s = (step_s / quantum).round().max(1.0) * quantum;
            let next = plan.lengths_s.len();
            let length = *known.entry(last_s.to_bits()).or_insert(next);
            if length == next {
                plan.lengths_s.push(last_s);
            }
            plan.runs.extend((run.rows > 0).then_some(run));
            run = Run { first: row, rows: 1, parts, share: 1.0 / parts as f64, length };
        }
        plan.runs.extend((run.rows > 0).then_some(run));
        plan
    }

    /// The demands of a run, each row with the next.
    #[inline(always)]
    pub(super) fn rows(&self, run: &Run) -> std::slice::Windows<'p, f64> {
        self.value[run.first..=run.first + run.rows].windows(2)
    }

    /// The demand at the start of a row, and how much it rises in each of its steps.
    #[inline(always)]
    pub(super) fn row(&self, row: &[f64], share: f64) -> (f64, f64) {
        (row[0], if self.hold { 0.0 } else { (row[1] - row[0]) * share })
    }

    /// When a step starts, s.
    pub(super) fn time_s(&self, step: u64) -> f64 {
        let (mut left, mut time_s) = (step, self.start_s);
        for run in &self.runs {
            let steps = left.min(run.rows as u64 * run.parts);
            time_s += self.lengths_s[run.length] * steps as f64;
            left -= steps;
        }
        time_s
    }
}
