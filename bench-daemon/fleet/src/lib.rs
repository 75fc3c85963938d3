//! One bench among many: registration, a queue of work, leases and stops over NATS JetStream. The
//! only user of NATS.
//!
//! The broker arbitrates and nothing else: every change of a job is a compare-and-swap on its
//! revision, so that no wall clock decides who has a job. A bench takes a job in two steps. `queued →
//! claimed` may be taken back by anybody once it has stood unchanged for the lease time. `claimed →
//! started` is the one point after which a run may begin, and only a person takes it back.
//!
//! The daemon that owns the benches implements [`LocalBench`]; this crate knows nothing of it.
//!
//! In reading order: [`job`], [`standing`] (holds and stops), [`local`] (what a bench must be able
//! to do), [`link`] (the broker), `watched`, [`intent`] (what a restart goes on with), `member`
//! (the work of a bench), [`view`] (the fleet as it is shown), [`client`] (what people ask for),
//! `sight` (the whole fleet as a daemon sees it), [`fleet`] (the benches of a daemon).

pub mod client;
pub mod error;
pub mod fleet;
pub mod intent;
pub mod job;
pub mod link;
pub mod local;
mod member;
mod record;
pub mod settings;
mod sight;
pub mod standing;
pub mod view;
mod watched;

pub use client::{Client, Submission};
pub use error::FleetError;
pub use fleet::Fleet;
pub use job::{Job, JobState, Needs, Place};
pub use local::{BenchState, Capabilities, Condition, End, Fate, LocalBench, Order, Reading};
pub use settings::{Credentials, FleetSettings};
pub use view::{BenchView, FleetView, JobCounts, Tally};
