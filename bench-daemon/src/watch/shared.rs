//! State that the watch and the procedure share.

use std::sync::{Mutex, MutexGuard, PoisonError};

use super::{envelope::InForce, log::WatchLog};

/// State that the watch and the procedure share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) force: Mutex<InForce>,
    pub(super) log: Mutex<WatchLog>,
    /// Whether no procedure runs: nothing may flow, and a drive that shows a current is switched
    /// off before it is queried again.
    pub(super) waits: bool,
}

/// Locks a mutex even if a thread has panicked while holding it.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
