//! The program `eis-bench`: command line, server, whole runs and their results. [`bench_core`]
//! contains everything that moves current.
//!
//! In reading order, each module using earlier ones only: [`support`] (helpers), [`doctor`] (proof of
//! a bench), [`run`] (a whole run), [`investigate`] (runs → diagnosis → the recommended run),
//! [`mod@campaign`] (cells over benches), [`serve`] (HTTP), [`command`] and [`cli`].

pub mod campaign;
pub mod cli;
pub mod command;
pub mod doctor;
mod figures;
mod files;
pub mod investigate;
pub mod run;
pub mod serve;
pub mod support;

pub use bench_core::{
    bench, config, executor, interlock, journal, measure, mocks, operator, plan, procedure, record,
    safety, sim, watch,
};
