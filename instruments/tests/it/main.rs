//! What only shows when the layers work together, over real ports and in-process ones.

mod device;
mod link;
mod mocks_devices;
mod mocks_plant;
mod mocks_ports;
mod mocks_scope;
mod ports;
