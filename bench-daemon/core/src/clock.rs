//! The clock of a run in typed seconds.

use instruments::{clock::Clock, units::Seconds};

/// Reads and waits in typed seconds.
pub(crate) trait TypedClock {
    /// Returns the bench time.
    fn now(&self) -> Seconds;

    /// Returns the time of the machine.
    fn machine(&self) -> Seconds;

    /// Waits for a bench time; nothing for zero, negative and not-a-number.
    async fn sleep_for(&self, span: Seconds);
}

impl TypedClock for Clock {
    fn now(&self) -> Seconds {
        Seconds(self.now_s())
    }

    fn machine(&self) -> Seconds {
        Seconds(self.machine_s())
    }

    async fn sleep_for(&self, span: Seconds) {
        self.sleep_s(span.value()).await;
    }
}
