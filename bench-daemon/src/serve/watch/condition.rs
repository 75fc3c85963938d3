//! Condition of a run's process: whether it waits, is safe, or has ended.

use crate::journal::{Entry, Line};

/// Condition by the last entries of the journal.
#[derive(Debug, Default)]
pub(super) struct Condition {
    /// It waits on request.
    pub(super) paused: bool,
    /// Everything was off and read back at the last entry.
    pub(super) safe: bool,
    /// How it ended, if it did.
    pub(super) ended: Option<String>,
    /// Bench time at which the process that runs it, or ran it last, began, s.
    pub(super) process_s: f64,
}

impl Condition {
    /// Takes the next entry of the journal.
    pub(super) fn take(&mut self, line: &Line) {
        self.ended = None;
        self.safe = matches!(line.entry, Entry::Safe | Entry::Paused)
            || (self.safe && matches!(line.entry, Entry::Note(_) | Entry::Ended { .. }));
        match &line.entry {
            Entry::Paused => self.paused = true,
            Entry::GoneOn => self.paused = false,
            Entry::Resumed { .. } => (self.paused, self.process_s) = (false, line.time_s),
            Entry::Ended { how } => self.ended = Some(how.clone()),
            _ => {}
        }
    }
}
