//! A current for a while.

use instruments::units::{Amps, Seconds, Watts};

/// A current for a while.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Current, A, charge positive; for a power, the current at the minimum voltage of the cell.
    pub current_a: Amps,
    /// How long it flows, s.
    pub duration_s: Seconds,
    /// Power into the cell, W, if given: the current follows from the voltage at its start.
    pub power_w: Option<Watts>,
}
