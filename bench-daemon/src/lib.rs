//! The daemon of a battery test bench: decides, records, reports. The only crate that knows
//! configuration files and the command line.
//!
//! In reading order: [`config`] (files → a checked experiment), [`procedure`] (experiment →
//! [`plan`]), [`interlock`] (reading → trip), [`mod@bench`] (the named instruments), [`state`]
//! (state of a bench across processes), [`guardian`] (a second process that can only switch off),
//! [`bench_lease`] (lease of a bench: lock, latch and guardian around a run), [`executor`] (plan →
//! instruments → records), [`record`] (the run folder), [`dataset`] (runs of a campaign, for a
//! diagnosis), [`sim`] (a simulated world behind mocks), [`investigation`] (campaign, diagnosis,
//! and the recommended run), [`command`] (commands of the command line).

pub mod addresses;
pub mod bench;
pub mod bench_lease;
pub mod cli;
pub mod command;
pub mod compare;
pub mod config;
pub mod confined_path;
pub mod dataset;
pub mod doctor;
pub mod drill;
pub mod executor;
pub mod failure;
mod figures;
mod files;
pub mod fixture_check;
pub mod guardian;
pub mod hash;
pub mod interlock;
pub mod investigation;
pub mod journal;
pub mod journal_replay;
pub mod logging;
pub mod loopback;
pub mod measure;
mod mocks;
pub mod next_experiment;
pub mod operator;
pub mod plan;
pub mod present;
pub mod procedure;
pub mod progress;
pub mod record;
pub mod run;
pub mod run_control;
pub mod serve;
pub mod sim;
pub mod state;
pub mod state_readback;
pub mod sums;
pub mod survey;
pub mod terminal;
pub mod thermostat;
