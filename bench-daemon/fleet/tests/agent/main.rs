//! Agents beside real servers, all of them processes, with a real broker: `nats-server` in the PATH.
//! If it is missing, the tests report it and pass. Needs the program `eis-bench` beside `eis-fleet`,
//! where `cargo test --workspace` puts it.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may end a test"
)]

mod access;
mod between;
mod faults;
mod files;
mod jobs;
mod names;
mod processes;
mod stops;
#[allow(dead_code, reason = "other test binaries use the rest")]
#[path = "../../../tests/it/under_test.rs"]
mod under_test;
