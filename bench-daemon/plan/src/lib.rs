//! An experiment and what it may do: files, plan, procedures and the interlock. It knows no link to
//! an instrument.
//!
//! In reading order, each module using earlier ones only: [`support`] (paths, hashes, terminal),
//! [`interlock`] (reading → trip), [`measure`] (point of a sweep and its quality), [`plan`] (steps
//! and their check), [`config`] (files → a checked experiment), [`procedure`] (experiment → plan).

pub mod config;
pub mod interlock;
pub mod measure;
pub mod mocks;
pub mod plan;
pub mod procedure;
pub mod support;
