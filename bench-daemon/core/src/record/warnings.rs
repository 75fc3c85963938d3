//! Collects warnings about a run and its points.

use super::names;
use crate::journal::Note;

/// Warnings of a run.
pub(super) struct Warnings {
    notes: Vec<Note>,
    /// Texts, with the sweeps and frequencies, Hz, that they concern.
    points: Vec<(String, Vec<(String, f64)>)>,
}

impl Warnings {
    /// Creates warnings from known notes.
    pub(super) fn of(notes: Vec<Note>) -> Self {
        Self {
            notes,
            points: Vec::new(),
        }
    }

    /// Checks whether a note with this content exists.
    pub(super) fn knows(&self, text: &str) -> bool {
        self.notes.iter().any(|known| odd(&known.text) == odd(text))
    }

    /// Adds a note.
    pub(super) fn add(&mut self, note: Note) {
        self.notes.push(note);
    }

    /// Adds a warning about a point of a sweep.
    pub(super) fn add_of_point(&mut self, sweep: &str, freq_hz: f64, text: &str) {
        let point = (sweep.to_owned(), freq_hz);
        match self.points.iter_mut().find(|(known, _)| known == text) {
            Some((_, points)) => points.push(point),
            None => self.points.push((text.to_owned(), vec![point])),
        }
    }

    /// Returns all texts: equal warnings about several points occur once.
    pub(super) fn texts(&self) -> Vec<String> {
        let points = self
            .points
            .iter()
            .map(|(text, points)| format!("{}: {text}", names::places(points)));
        let notes = self.notes.iter().map(|note| note.text.clone());
        points.chain(notes).collect()
    }

    /// Returns the notes that the state of charge was missed.
    pub(super) fn soc_missed(&self) -> impl Iterator<Item = &str> {
        let missed = self.notes.iter().filter(|note| note.is_soc_missed());
        missed.map(|note| note.text.as_str())
    }
}

/// Returns the text of a warning without the command for inspecting it: a resumed run may contain
/// another spelling of its path.
fn odd(text: &str) -> &str {
    text.split_once("; `eis-bench ")
        .map_or(text, |(odd, _)| odd)
}
