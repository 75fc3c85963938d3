//! The program `eis-bench`: its command line. [`bench_plan`] and [`bench_core`] contain everything
//! that moves current, [`bench_evaluate`] the runs and their results, [`bench_serve`] the server.

pub mod cli;
pub mod command;
