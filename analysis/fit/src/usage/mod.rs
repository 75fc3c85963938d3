//! Impedance from records of ordinary use: a log of a robot, a drive cycle, or a battery management
//! system, of one cell or of cells in series with a common current.
//!
//! [`usage`] divides the record into windows of several lengths, estimates the impedance from the cross
//! spectra of current and voltage (Welch, 1967), and states its uncertainty from their coherence. Where the
//! current has too little power the impedance is refused. In a string every cell is compared with the mean
//! of all: all voltages answer one current, so that neither a model nor the lag of the current sensor
//! matters. A lag that the impedances show is taken out of them.

mod grid;
mod lag;
mod record;
mod result;
mod string;
mod transfer;

pub use lag::{Lag, LagKind};
pub use record::{CellVoltage, UsageError, UsageRecord};
pub use result::{CellUsage, RefusedBand, StringCell, Usage};
pub use transfer::usage;

#[cfg(test)]
mod tests;
