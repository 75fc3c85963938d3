//! Tests of the fleet against a real broker: `nats-server` in the PATH. If it is missing, the
//! tests report it and pass.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "helpers of tests may end a test"
)]

mod events;
mod faults;
mod protocol;
mod sight;
mod support;
