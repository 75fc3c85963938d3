//! Safety functions that outlive a process: the stored [`state`] of a bench with its latch; the
//! [`guardian`], a second process that can only switch off; the [`bench_lease`] held during a run;
//! and [`failure`], the error with which a command ends, which reports first whether the bench is
//! safe.

pub mod bench_lease;
pub mod failure;
pub mod guardian;
pub mod state;
