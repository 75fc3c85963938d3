//! Results of a record.

use analysis_signal::spectrum::Spectrum;
use serde::Serialize;

use super::lag::Lag;

/// What a record of ordinary use shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Usage {
    /// Time between two rows of the even grid, s.
    pub interval_s: f64,
    /// Length of the record without gaps, s.
    pub length_s: f64,
    /// Lag of the current channel, which the impedances no longer have; `None` if none is certain.
    pub lag: Option<Lag>,
    /// One entry for each cell.
    pub cells: Vec<CellUsage>,
    /// Each cell against the mean of the string; empty for fewer than four cells.
    pub string: Vec<StringCell>,
}

/// The impedance of one cell.
#[derive(Debug, Clone, PartialEq)]
pub struct CellUsage {
    /// Its impedance where the current has power, with its uncertainty.
    pub spectrum: Spectrum,
    /// Frequencies where it has too little.
    pub refused: Vec<RefusedBand>,
    /// Relative change of |Z| from the first to the second half of the record, and its standard
    /// uncertainty; `None` if the halves have no frequency in common.
    pub change: Option<[f64; 2]>,
}

/// A frequency that is refused.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RefusedBand {
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Relative uncertainty that the impedance would have.
    pub uncertainty: f64,
}

/// One cell against the mean of the string.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StringCell {
    /// Its name.
    pub name: String,
    /// Excess of its response to the current over the mean response of all cells.
    pub excess: f64,
    /// Standard uncertainty of the excess by the record.
    pub sigma: f64,
    /// Excess over the scatter of the other cells.
    pub scatters: f64,
    /// Probability that the greatest of as many equal cells shows such an excess (Student).
    pub p: f64,
    /// True if the cell is weak: the excess is neither the record's noise nor the cells' scatter.
    pub weak: bool,
}
