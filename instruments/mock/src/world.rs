//! Access of a mock to the simulated world, at the time of the message in hand.

use std::sync::{MutexGuard, PoisonError};

use super::plant::{Action, Meter, Plant, SharedPlant};

/// The shared plant and the bench time of the message in hand, s.
pub(super) struct World {
    plant: SharedPlant,
    pub(super) now_s: f64,
}

impl World {
    /// Creates a handle on the world from the time of switching on, bench s.
    pub(super) fn new(plant: SharedPlant, now_s: f64) -> Self {
        Self { plant, now_s }
    }

    /// Returns the plant, locked. A panic elsewhere must not take the whole bench down, so that
    /// poison is ignored.
    pub(super) fn plant(&self) -> MutexGuard<'_, dyn Plant + 'static> {
        self.plant.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn act(&self, action: Action) {
        self.plant().act(self.now_s, action);
    }

    pub(super) fn read(&self, meter: Meter) -> f64 {
        self.plant().read(self.now_s, meter)
    }
}
