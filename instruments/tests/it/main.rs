//! What only shows when the layers work together, over real ports and in-process ones.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test that panics has found something")]

mod device;
mod drivers;
mod link;
mod mocks_devices;
mod mocks_plant;
mod mocks_ports;
mod mocks_random;
mod mocks_scope;
mod ports;
