//! Helpers of the command line and the server.

pub mod chance;
pub mod compare;
pub mod present;
pub mod telemetry;

pub use bench_core::support::{
    account, calendar, confined_path, crash_point, hash, locks, logging, loopback, quoted, sums,
    terminal,
};
