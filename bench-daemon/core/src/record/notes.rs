//! Collects the warnings of a run for its report.

use analysis_files::run_folder::Event;

use super::Recorder;
use crate::journal::{Entry, Note};

impl Recorder {
    /// Adds a warning to the report.
    pub fn warning(&mut self, text: &str) {
        self.note(Note::of(text));
    }

    /// As [`Self::warning`], with a kind if results depend on it.
    pub fn note(&mut self, note: Note) {
        let text = note.text.as_str();
        if self.warnings.knows(text) {
            return;
        }
        // If the folder cannot be written, the next record ends the run; the warning alone does
        // not justify that.
        let noted = self.journal(Entry::Note(note.clone()));
        if let Err(error) = noted.and_then(|()| self.event(Event::Note, text)) {
            tracing::error!("{error}");
        }
        self.warnings.add(note);
    }

    /// Adds a warning about a point of a sweep; equal warnings about several points are reported
    /// once.
    pub fn point_warning(&mut self, sweep: &str, freq_hz: f64, text: &str) {
        if let Err(error) = self.event(Event::Note, &format!("{sweep}, {freq_hz:.4} Hz: {text}")) {
            tracing::error!("{error}");
        }
        self.known_point_warning(sweep, freq_hz, text);
    }

    /// As [`Self::point_warning`], for a point whose event was written when it was measured.
    pub fn known_point_warning(&mut self, sweep: &str, freq_hz: f64, text: &str) {
        self.warnings.add_of_point(sweep, freq_hz, text);
    }

    /// Returns the warnings of the run.
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.texts()
    }

    /// Returns the notes that the state of charge was missed.
    pub fn soc_missed(&self) -> impl Iterator<Item = &str> {
        self.warnings.soc_missed()
    }
}

#[cfg(test)]
mod tests {
    use instruments::clock::Clock;

    use super::*;

    #[test]
    fn what_is_odd_about_several_points_is_said_once() {
        let folder = tempfile::tempdir().unwrap();
        let clock = Clock::start(instruments::clock::TimeMode::Real);
        let mut recorder = Recorder::create(&folder.path().join("run"), clock).unwrap();
        recorder.warning("of the run");
        recorder.warning("never looked at; `eis-bench doctor benches/a.toml` looks at it");
        recorder.warning("never looked at; `eis-bench doctor /srv/benches/a.toml` looks at it");
        for (sweep, freq_hz, text) in [
            ("shunt", 1.0, "odd"),
            ("shunt", 1.0, "other"),
            ("cell", 1.0, "odd"),
        ] {
            recorder.point_warning(sweep, freq_hz, text);
        }
        let messages = [
            "shunt, 1.0000 Hz; cell, 1.0000 Hz: odd",
            "shunt, 1.0000 Hz: other",
            "of the run",
            "never looked at; `eis-bench doctor benches/a.toml` looks at it",
        ];
        assert_eq!(recorder.warnings(), messages);
    }
}
