//! `eis-fleet`: one bench among many. Registration, a queue of work, leases and stops over NATS
//! JetStream. The only user of NATS.
//!
//! The broker only arbitrates: every change of a job is a compare-and-swap on its revision, so
//! that no wall clock decides which bench has a job. A bench takes a job in two steps. Any bench
//! may revert `queued → claimed` once the claim has stood unchanged for the lease time. A run may
//! begin only after `claimed → started`, and only a person can revert that step.
//!
//! A bench is a [`LocalBench`]. The agent implements it over the HTTP API of the server of the
//! benches; this crate does not depend on the server.
//!
//! In reading order: [`job`], [`standing`] (holds and stops), [`local`] (what a bench must be
//! able to do), [`link`] (the broker), `watched`, [`intent`] (what a restart continues with),
//! `member` (the work of a bench), [`view`] (the fleet as it is shown), [`client`] (requests of
//! users), `sight` (the whole fleet as a daemon sees it), [`fleet`] (the benches of a daemon),
//! [`agent`] (a daemon beside a server), [`command`], [`cli`].

pub mod agent;
pub mod api;
pub mod cli;
pub mod client;
pub mod command;
pub mod config;
pub mod error;
pub mod failure;
pub mod fleet;
pub mod intent;
pub mod job;
pub mod link;
pub mod local;
mod member;
pub mod quantity;
mod record;
pub mod settings;
mod sight;
pub mod standing;
mod terminal;
pub mod view;
mod watched;

pub use client::{Client, Submission};
pub use error::FleetError;
pub use fleet::Fleet;
pub use job::{Job, JobState, Needs, Place};
pub use local::{BenchState, Capabilities, Condition, End, Fate, LocalBench, Order, Reading};
pub use settings::{Credentials, FleetSettings};
pub use view::{BenchView, FleetView, JobCounts, Tally};
