//! What the watch and the procedure share.

use std::sync::{Mutex, MutexGuard, PoisonError};

use super::{envelope::InForce, log::WatchLog};

/// What the watch and the procedure share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) force: Mutex<InForce>,
    pub(super) log: Mutex<WatchLog>,
    /// No procedure runs: nothing may flow, and a drive that shows a current is switched off before
    /// it is asked again.
    pub(super) waits: bool,
}

/// A lock that a panic of the other side does not poison.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
