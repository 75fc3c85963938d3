//! Condition of a run's process: whether it waits, is safe, or has ended.

use crate::live::QuestionNow;
use bench_core::journal::{Entry, Line};

/// Condition by the last entries of the journal.
#[derive(Debug, Default)]
pub(super) struct Condition {
    /// It waits on request.
    pub(super) paused: bool,
    /// Question that waits for an answer.
    pub(super) question: Option<QuestionNow>,
    /// At the last entry, all outputs were read back as off.
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
        self.safe = matches!(line.entry, Entry::Safe | Entry::Paused | Entry::Asked(_))
            || (self.safe && matches!(line.entry, Entry::Note(_) | Entry::Ended { .. }));
        if let Entry::Asked(question) = &line.entry {
            self.question = Some(QuestionNow {
                number: line.number,
                text: question.text.clone(),
                cell: question.cell.clone(),
                serial: question.serial.clone(),
                barcode: question.barcode.clone(),
                on_terminal: question.on_terminal,
                asked_s: line.time_s.0,
            });
        } else if !matches!(line.entry, Entry::Note(_)) {
            // Any other entry means that the run no longer waits for a person.
            self.question = None;
        }
        match &line.entry {
            Entry::Paused => self.paused = true,
            Entry::GoneOn => self.paused = false,
            Entry::Resumed { .. } => (self.paused, self.process_s) = (false, line.time_s.value()),
            Entry::Ended { how } => self.ended = Some(how.clone()),
            _ => {}
        }
    }
}
