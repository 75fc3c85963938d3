//! A current for a while.

/// A current for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Current, A, charge positive; of a power, what it takes at the least voltage of the cell.
    pub current_a: f64,
    /// How long it flows, s.
    pub duration_s: f64,
    /// Power into the cell, W, where it is given: the current follows from the voltage when it
    /// begins.
    pub power_w: Option<f64>,
}
