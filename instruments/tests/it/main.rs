//! Tests that need several layers together, over real ports and in-process ones.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that panics has found something"
)]

mod conformance;
mod device;
mod drivers_common;
mod drivers_confirming;
mod drivers_firmware;
mod drivers_generator;
mod drivers_power;
mod drivers_scope;
mod drivers_second;
mod drivers_supply4q;
mod drivers_thermal;
mod faults;
mod fuzz;
mod fuzz_models;
mod fuzz_sessions;
mod fuzz_usbtmc;
mod link;
mod link_broken;
mod link_shared;
mod mocks_clients;
mod mocks_devices;
mod mocks_plant;
mod mocks_ports;
mod mocks_random;
mod mocks_scope;
mod ports;
mod quirks;
mod replay;
mod transports;
mod usbtmc_pieces;
