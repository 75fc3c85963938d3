//! The daemon of a battery test bench: decides, records, reports. The only crate that reads
//! configuration files and the command line.
//!
//! In reading order, each module using earlier ones only: [`support`] (paths, hashes, terminal),
//! [`interlock`] (reading → trip), [`measure`] (point of a sweep and its quality), [`plan`]
//! (steps and their check), [`config`] (files → a checked experiment), [`procedure`] (experiment
//! → plan), [`mod@bench`] (the named instruments), [`operator`] (messages to a person and their
//! requests), [`journal`] and [`record`] (the run folder), [`watch`] (meters → alarm, beside
//! everything else), [`sim`] (a simulated world behind mocks), [`executor`] (plan → instruments →
//! records), [`safety`] (what outlives a process: state, latch, lease, guardian), [`doctor`]
//! (proof of a bench), [`run`] (a whole run), [`investigate`] (runs → diagnosis → the recommended
//! run), [`mod@campaign`] (cells over benches), [`serve`] (HTTP), [`command`] and [`cli`].

pub mod bench;
pub mod campaign;
pub mod cli;
pub mod command;
pub mod config;
pub mod doctor;
pub mod executor;
mod figures;
mod files;
pub mod interlock;
pub mod investigate;
pub mod journal;
pub mod measure;
mod mocks;
pub mod operator;
pub mod plan;
pub mod procedure;
pub mod record;
pub mod run;
pub mod safety;
pub mod serve;
pub mod sim;
pub mod support;
pub mod watch;
