//! Sweeps under a direct current against sweeps of the same cells at rest: which branch of the model
//! changes, by which share, and how certain that is.
//!
//! The sweeps at rest give the model, the noise of a sweep, and how much cells differ. The difference
//! of a sweep from their mean is explained by a relative change of each resistance of the model, with
//! the capacitances held. What the model itself misses is in both and cancels. The same is computed for
//! every sweep at rest: its scatter within and between cells states how large a change is without any
//! current. A change is compared with the cell itself where both files name the cell, and with all
//! cells otherwise.
//!
//! Under a direct current the voltage drifts. A fit of a sine without drift turns that into an impedance
//! that rises towards low frequencies. The lowest points are left out if the change of all higher points
//! does not predict them, and what a drift leaves is fitted beside the changes.

mod base;
mod change;
mod figure;
mod options;
mod result;
mod solve;
mod trend;
mod words;

pub use change::under_current;
pub use figure::{change_chart, share_chart};
pub use options::{UnderCurrentError, UnderCurrentOptions};
pub use result::{BranchChange, Compared, CurrentChange, PairChange, PointChange, UnderCurrent};
pub use words::{branch_in_words, in_words, tau_in_words};

#[cfg(test)]
mod tests;
