//! State of power: the most power that can be held for a time from a state, within the voltage
//! window, in both directions.
//!
//! A power is held if the simulation of [`crate::forward`] under it finds every cell within the
//! window and all of the power available, from the first instant to the last. If a power breaks a
//! limit, every larger one does, so the limit is bracketed from outside and from inside. The
//! Illinois variant of the false position on the margin closes the bracket, with bisection as its
//! guard. The limits apply at the cells' terminals, before the interconnect.

mod map;
mod search;

pub use map::{Limits, SopEntry, SopGrid, sop_map};
pub use search::{CurrentLimits, Limit, LimitedBy, SopOptions, most_power};

#[cfg(test)]
mod tests;
