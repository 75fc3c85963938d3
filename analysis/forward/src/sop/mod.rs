//! State of power: the most power that can be held for a time from a state, within the voltage
//! window, in both directions.
//!
//! A power is held if the simulation of [`crate::forward`] under it finds every cell within the
//! window and all of the power to be had, from the first instant to the last. What a power does not
//! keep, no larger one keeps, so that the limit is bracketed from outside and from inside and the
//! bracket closed by the Illinois variant of the false position on the margin, with bisection as
//! its guard. The limits hold at the cells' terminals, before the interconnect.

mod map;
mod search;

pub use map::{Limits, SopEntry, SopGrid, sop_map};
pub use search::{CurrentLimits, Limit, LimitedBy, SopOptions, most_power};

#[cfg(test)]
mod tests;
