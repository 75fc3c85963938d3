//! Simulation forward in time: [`forward`] simulates a cell or a pack under a load, [`sop`] finds
//! the maximum power that can be held.

pub mod forward;
pub mod sop;
