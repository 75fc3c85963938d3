//! Integration tests of the daemon: one binary.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests may end a test")]

mod accuracy;
mod additions;
mod architecture;
mod bad_day;
mod benches;
mod campaign;
mod configuration;
mod crash;
mod demo;
mod diagnose;
mod fit;
mod fit_circuit;
mod gate;
mod guardian;
mod investigate;
mod kill;
mod kk;
mod mock_process;
mod multisine;
mod ocv_joint;
mod ocv_soc;
mod profiles;
mod quality;
mod ranging;
mod real_data;
mod resume;
mod safety;
mod simulate;
mod soc_reset;
mod study;
mod support;
mod sweeps;
mod traces;
mod verdicts;
