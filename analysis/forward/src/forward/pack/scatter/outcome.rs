//! Result of one pack, and percentiles over many.

use super::super::links::LinkLoads;
use analysis_model::map::Outside;
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
    /// cells without links.
    pub largest_share: f64,
    /// Difference of the highest and the lowest state of charge at the end; none for a constant
    /// OCV.
    pub soc_spread_end: Option<f64>,
    /// States of charge at the start and the end; none for a constant OCV.
    pub soc_range: Option<SocRange>,
    /// Joule heat in the cell with the most of it, J.
    pub hottest_heat_j: f64,
    /// Its temperature rise if no heat leaves it, K.
    pub hottest_rise_k: f64,
    /// Temperatures of the cells.
    pub temperatures: Temperatures,
    /// Heat of the interconnect and of the tabs, J.
    pub interconnect_heat_j: f64,
    /// Largest distance outside the range in which a map was measured; `None` without a map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub outside_map: Option<LeftMap>,
    /// Loads of the links between the cells; `None` without links.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub links: Option<LinkLoads>,
    /// Energy delivered at the terminals, J.
    pub energy_j: f64,
    /// Steps whose equations were not solved to their tolerance.
    pub unsettled_steps: u64,
    /// Whether all requested power was available.
    pub feasible: bool,
}

impl Outcome {
    /// Returns whether every cell stayed within the window and all power could be had.
    pub fn within(&self) -> bool {
        self.feasible && self.margin_low_v >= 0.0 && self.margin_high_v >= 0.0
    }
}

/// Lowest and highest state of charge of any cell, over the start and the end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SocRange {
    /// Lowest.
    pub lowest: f64,
    /// Highest.
    pub highest: f64,
}

/// Position of a cell in a pack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Position {
    /// Its group, from 1.
    pub group: usize,
    /// Its place in the group, from 1.
    pub place: usize,
}

impl Position {
    /// Returns the position of a cell by its number from 0, group by group.
    pub(super) fn of(cell: usize, parallel: usize) -> Self {
        Self {
            group: cell / parallel + 1,
            place: cell % parallel + 1,
        }
    }
}

impl std::fmt::Display for Position {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "group {}, place {}", self.group, self.place)
    }
}

/// Temperatures of the cells of a pack.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Temperatures {
    /// Highest temperature of any cell, °C.
    pub hottest_degc: f64,
    /// When, s.
    pub hottest_time_s: f64,
    /// Which cell.
    pub hottest: Position,
    /// Lowest of the highest temperatures of the cells, °C: that of the cell that stays coldest.
    pub lowest_peak_degc: f64,
    /// Which cell.
    pub coldest: Position,
    /// Largest difference between two cells at one instant, K.
    pub spread_k: f64,
}

/// Largest distance outside the range in which a map was measured, and the cells that go there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LeftMap {
    /// The distance.
    #[serde(flatten)]
    pub outside: Outside,
    /// Cell that is farthest in state of charge.
    pub soc_cell: Position,
    /// Cell that is farthest in temperature.
    pub temperature_cell: Position,
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
