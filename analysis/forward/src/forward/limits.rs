//! The voltages between which a cell may be (thesis 4.3).

use serde::Serialize;

/// Lowest and highest voltage of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CellWindow {
    /// Lowest voltage, V.
    pub low_v: f64,
    /// Highest voltage, V.
    pub high_v: f64,
}

impl CellWindow {
    /// 2.5 to 4.2 V, as in the thesis (Molicel P45B).
    pub const THESIS: Self = Self {
        low_v: 2.5,
        high_v: 4.2,
    };

    /// Returns the distance of a cell's voltage above the lower limit, V; negative below it.
    pub fn margin_low_v(&self, cell_v: f64) -> f64 {
        cell_v - self.low_v
    }

    /// Returns the distance of a cell's voltage below the upper limit, V; negative above it.
    pub fn margin_high_v(&self, cell_v: f64) -> f64 {
        self.high_v - cell_v
    }
}
