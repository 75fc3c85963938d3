//! State that the watch and the procedure share.

use std::sync::{Mutex, MutexGuard, PoisonError, atomic::AtomicBool};

use super::{envelope::InForce, log::WatchLog};

/// State that the watch and the procedure share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) force: Mutex<InForce>,
    pub(super) log: Mutex<WatchLog>,
    /// Whether no procedure runs: nothing may flow, and a drive that shows a current is switched
    /// off before it is queried again.
    pub(super) waits: bool,
    /// Every drive of the bench was read a moment ago, and answers in time.
    pub(super) sees_every_drive: AtomicBool,
}

/// Locks a mutex even if a thread has panicked while holding it.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
