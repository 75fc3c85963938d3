//! The integration tests of the crate, in one binary.

mod mocks_devices;
mod mocks_plant;
mod mocks_ports;
mod mocks_scope;
