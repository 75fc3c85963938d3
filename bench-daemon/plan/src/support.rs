//! Helpers that know nothing of a bench: paths, addresses, hashes, terminal, log.

pub mod account;
pub mod addresses;
pub mod calendar;
pub mod confined_path;
pub mod crash_point;
pub mod hash;
pub mod locks;
pub mod logging;
pub mod moment;
pub mod quoted;
pub mod sums;
pub mod terminal;
