//! What moves current through a cell: configuration, plan, interlock, executor, recorder, journal,
//! safe state and guardian. It knows instruments, signals and the run folder. It does not know the
//! command line, HTTP, plots, the catalogue and the diagnosis.
//!
//! In reading order, each module using earlier ones only: [`support`] (paths, hashes, terminal),
//! [`interlock`] (reading → trip), [`measure`] (point of a sweep and its quality), [`plan`]
//! (steps and their check), [`config`] (files → a checked experiment), [`procedure`] (experiment
//! → plan), [`mod@bench`] (the named instruments), [`operator`] (messages to a person and their
//! requests), [`journal`] and [`record`] (the run folder), [`watch`] (meters → alarm, beside
//! everything else), [`sim`] (a simulated world behind mocks), [`executor`] (plan → instruments →
//! records), [`safety`] (what outlives a process: state, latch, lease, guardian).

pub mod bench;
pub mod config;
pub mod executor;
pub mod interlock;
pub mod journal;
pub mod measure;
pub mod mocks;
pub mod operator;
pub mod plan;
pub mod procedure;
pub mod record;
pub mod safety;
pub mod sim;
pub mod support;
pub mod watch;
