//! The archive against a store in memory that fails in every way that a store can.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may end a test"
)]

mod faults;
mod made;
mod moved;
mod pushed;
mod tables;
