//! A profile prepared for the inner loop: runs of rows with steps of one length. The demands stay
//! in the profile. A list of all steps would cost as much memory traffic as a cell costs
//! arithmetic.

use super::BatchOptions;
use crate::forward::law::{Beyond, Demand};
use crate::forward::profile::{Interpolation, Profile, parts};

/// Rows that follow each other, cut into equally many steps of one length.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    /// The first row.
    pub(super) first: usize,
    /// Number of rows.
    pub(super) rows: usize,
    /// Steps in each row.
    pub(super) parts: u64,
    /// One over it.
    pub(super) share: f64,
    /// Index of the length.
    pub(super) length: usize,
}

/// The steps of a profile and their common values.
#[derive(Debug, Clone)]
pub(in crate::forward) struct Plan<'p> {
    pub(super) demand: Demand,
    pub(super) beyond: Beyond,
    pub(super) start_s: f64,
    /// Different lengths, s.
    pub(super) lengths_s: Vec<f64>,
    pub(super) runs: Vec<Run>,
    value: &'p [f64],
    /// True if a row holds until the next.
    hold: bool,
}

impl<'p> Plan<'p> {
    pub(super) fn new(profile: &'p Profile, options: &BatchOptions) -> Self {
        let start_s = profile.time_s.first().copied().unwrap_or(0.0);
        let last_s = profile.time_s.last().copied().unwrap_or(0.0);
        // Equal steps written as decimals differ in their last bits; a quantum far below the
        // rounding of the times makes them equal again.
        let quantum = (last_s.abs().max(start_s.abs()) * 2f64.powi(-48)).max(f64::MIN_POSITIVE);
        let hold = profile.interpolation == Interpolation::Hold;
        let (demand, beyond, value) = (profile.demand, options.beyond, profile.value.as_slice());
        let mut plan = Self {
            demand,
            beyond,
            start_s,
            lengths_s: Vec::new(),
            runs: Vec::new(),
            value,
            hold,
        };
        let mut known = std::collections::HashMap::new();
        let (rows, mut first) = (profile.time_s.len().saturating_sub(1), 0);
        while first < rows {
            let row_s = profile.time_s[first + 1] - profile.time_s[first];
            let count = alike(
                &profile.time_s[first..],
                (row_s / quantum).round() * quantum,
                0.75 * quantum,
            )
            .max(1);
            let parts = parts(row_s, options.max_step_s);
            let step_s = (row_s / parts as f64 / quantum).round().max(1.0) * quantum;
            let next = plan.lengths_s.len();
            let length = *known.entry(step_s.to_bits()).or_insert(next);
            if length == next {
                plan.lengths_s.push(step_s);
            }
            plan.runs.push(Run {
                first,
                rows: count,
                parts,
                share: 1.0 / parts as f64,
                length,
            });
            first += count;
        }
        plan
    }

    /// Returns the demands of a run, each row with the next.
    #[inline(always)]
    pub(super) fn rows(&self, run: &Run) -> std::slice::Windows<'p, f64> {
        self.value[run.first..=run.first + run.rows].windows(2)
    }

    /// The demand at the start of a row, and how much it rises in each of its steps.
    #[inline(always)]
    pub(super) fn row(&self, row: &[f64], share: f64) -> (f64, f64) {
        (
            row[0],
            if self.hold {
                0.0
            } else {
                (row[1] - row[0]) * share
            },
        )
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

/// Returns the number of first rows that all last `row_s`.
fn alike(time_s: &[f64], row_s: f64, tolerance_s: f64) -> usize {
    let other = |from: &f64, to: &f64| ((to - from) - row_s).abs() > tolerance_s;
    if time_s.len() < 3 || other(&time_s[1], &time_s[2]) {
        return 1;
    }
    // Blocks without an early end are vectors for the compiler.
    let others = |block: usize| -> u64 {
        let times = &time_s[block * BLOCK..=(block + 1) * BLOCK];
        times
            .iter()
            .zip(&times[1..])
            .map(|(from, to)| u64::from(other(from, to)))
            .sum()
    };
    let rows = time_s.len().saturating_sub(1);
    let blocks = (0..rows / BLOCK)
        .take_while(|block| others(*block) == 0)
        .count();
    let rest = &time_s[blocks * BLOCK..];
    blocks * BLOCK
        + rest
            .iter()
            .zip(&rest[1..])
            .take_while(|(from, to)| !other(from, to))
            .count()
}

/// Rows looked at together.
const BLOCK: usize = 32;
