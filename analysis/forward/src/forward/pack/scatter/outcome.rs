//! Result of one pack, and percentiles over many.

use serde::Serialize;

/// Result of one pack.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Outcome {
    /// Lowest voltage of any cell, V.
    pub min_cell_v: f64,
    /// When, s.
    pub min_cell_time_s: f64,
    /// Its group, from 1.
    pub min_cell_group: usize,
    /// Highest voltage of any cell, V.
    pub max_cell_v: f64,
    /// Lowest voltage of the pack, V.
    pub min_ccv_v: f64,
    /// Lowest voltage above the lower limit, V; negative below it.
    pub margin_low_v: f64,
    /// Highest voltage below the upper limit, V; negative above it.
    pub margin_high_v: f64,
    /// Largest current of any cell, A, without sign.
    pub largest_cell_a: f64,
    /// Largest current of any cell over the largest mean current of the cells; 1 for identical
    /// cells.
    pub largest_share: f64,
    /// Difference of the highest and the lowest state of charge at the end; none for a constant
    /// OCV.
    pub soc_spread_end: Option<f64>,
    /// Joule heat in the hottest cell, J.
    pub hottest_heat_j: f64,
    /// Its temperature rise if no heat leaves it, K.
    pub hottest_rise_k: f64,
    /// Energy delivered at the terminals, J.
    pub energy_j: f64,
    /// Whether all requested power was available.
    pub feasible: bool,
}

impl Outcome {
    /// Returns whether every cell stayed within the window and all power could be had.
    pub fn within(&self) -> bool {
        self.feasible && self.margin_low_v >= 0.0 && self.margin_high_v >= 0.0
    }
}

/// Percentiles of a figure over the draws.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Percentiles {
    /// 1 % of the draws lie below.
    pub p1: f64,
    /// 5 %.
    pub p5: f64,
    /// Half.
    pub p50: f64,
    /// 95 %.
    pub p95: f64,
    /// 99 %.
    pub p99: f64,
}

impl Percentiles {
    /// Percentiles by linear interpolation between the order statistics; not a number for no
    /// values.
    pub fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_by(f64::total_cmp);
        let at = |p: f64| {
            let Some(last) = sorted.len().checked_sub(1) else {
                return f64::NAN;
            };
            let place = p * last as f64;
            let (low, high) = (place.floor() as usize, (place.ceil() as usize).min(last));
            sorted[low] + (place - place.floor()) * (sorted[high] - sorted[low])
        };
        Self {
            p1: at(0.01),
            p5: at(0.05),
            p50: at(0.5),
            p95: at(0.95),
            p99: at(0.99),
        }
    }
}
