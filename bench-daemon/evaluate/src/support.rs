//! Helpers of runs, the command line and the server.

pub mod chance;
pub mod compare;
pub mod present;
pub mod telemetry;
