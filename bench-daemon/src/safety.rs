//! What outlives a process: [`state`] of a bench with its latch, [`guardian`], a second process that
//! can only switch off, [`bench_lease`] around a run, and [`failure`], the end of a command, which
//! says first whether the bench is safe.

pub mod bench_lease;
pub mod failure;
pub mod guardian;
pub mod state;
