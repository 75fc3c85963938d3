//! Rests and loads of a log of current and voltage: finds rests, pulses, discharges and drive cycles,
//! counts the charge between them, and estimates the noise of the channels.

mod load;
mod noise;
mod rest;
mod segment;
mod state;
mod thresholds;

pub use load::{Base, Kind, KnownSoc, Load, LogSearch, SocFrom, loads};
pub use noise::{Estimate, estimate};
pub use rest::Rest;
pub use segment::Course;
pub(crate) use segment::median;
pub use state::{ChargeKnown, Counted, at_voltage, count_charge, drawn_by_counter};
pub use thresholds::{CONSTANT_PART, LONGEST_PULSE_S, SHORTEST_PULSE_S};
pub(crate) use thresholds::{CUT_S, FEWEST_OF_SLOPE, LEAD_S, SOC_BEYOND};
