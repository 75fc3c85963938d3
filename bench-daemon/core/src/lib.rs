//! What moves current through a cell: instruments, executor, recorder, journal, safe state and
//! guardian. It knows instruments, signals and the run folder. It does not know the command line,
//! HTTP, plots, the catalogue and the diagnosis.
//!
//! In reading order: [`operator`] (messages to a person and their requests), [`mod@bench`] (the
//! named instruments), [`sim`] (a simulated world behind mocks), [`journal`] and [`record`] (the run
//! folder), [`watch`] (meters → alarm, beside everything else), [`executor`] (plan → instruments →
//! records), [`safety`] (what outlives a process: state, latch, lease, guardian).

pub mod bench;
mod clock;
pub mod executor;
pub mod journal;
pub mod operator;
pub mod record;
pub mod safety;
pub mod sim;
#[cfg(test)]
mod test_plan;
pub mod watch;
