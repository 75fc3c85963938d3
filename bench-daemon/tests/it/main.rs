//! Integration tests of the daemon: one binary.

mod architecture;
mod configuration;
mod demo;
mod fit;
mod mock_process;
