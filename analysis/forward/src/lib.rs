//! Simulation forward in time: [`forward`] plays a cell or a pack under a load, [`sop`] finds the
//! most power that can be held.

pub mod forward;
pub mod sop;
