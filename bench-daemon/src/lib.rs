//! The daemon of a battery test bench: decides, records, reports. The only crate that knows configuration files and the command line.
//!
//! In reading order: [`config`] (files → a checked experiment), [`procedure`] (experiment → [`plan`]), [`interlock`] (reading → trip), [`mod@bench`] (the
//! named instruments), [`executor`] (plan → instruments → records), [`record`] (the run folder), [`dataset`] (runs of a campaign as a diagnosis wants them), [`sim`] (a simulated world behind mocks),
//! [`investigation`] (campaign, diagnosis, and the run that it asks for), [`command`] (what the command line does).

pub mod bench;
pub mod cli;
pub mod command;
pub mod config;
pub mod dataset;
pub mod executor;
pub mod fixture_check;
pub mod interlock;
pub mod investigation;
pub mod logging;
pub mod next_experiment;
pub mod operator;
pub mod plan;
pub mod present;
pub mod procedure;
pub mod progress;
pub mod quality;
pub mod record;
pub mod sim;
pub mod study;
pub mod terminal;
