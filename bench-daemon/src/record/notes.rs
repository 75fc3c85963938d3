//! Collects the warnings of a run for its report.

use super::{Event, Recorder, names};
use crate::journal::{Entry, Note};

impl Recorder {
    /// Remembers something odd for the report.
    pub fn warning(&mut self, text: &str) {
        self.note(Note::of(text));
    }

    /// As [`Self::warning`], with a kind where results depend on it.
    pub fn note(&mut self, note: Note) {
        let text = note.text.as_str();
        if self.notes.iter().any(|known| odd(&known.text) == odd(text)) {
            return;
        }
        // A folder that cannot be written ends the run at the next record; the warning itself is
        // not worth it.
        let noted = self.journal(Entry::Note(note.clone()));
        if let Err(error) = noted.and_then(|()| self.event(Event::Note, text)) {
            tracing::error!("{error}");
        }
        self.notes.push(note);
    }

    /// Remembers something odd about a point of a sweep; what was odd about several is said once.
    pub fn point_warning(&mut self, sweep: &str, freq_hz: f64, text: &str) {
        if let Err(error) = self.event(Event::Note, &format!("{sweep}, {freq_hz:.4} Hz: {text}")) {
            tracing::error!("{error}");
        }
        self.known_point_warning(sweep, freq_hz, text);
    }

    /// As [`Self::point_warning`], for a point whose event was written when it was measured.
    pub fn known_point_warning(&mut self, sweep: &str, freq_hz: f64, text: &str) {
        match self
            .point_warnings
            .iter_mut()
            .find(|(known, _)| known == text)
        {
            Some((_, points)) => points.push((sweep.to_owned(), freq_hz)),
            None => self
                .point_warnings
                .push((text.to_owned(), vec![(sweep.to_owned(), freq_hz)])),
        }
    }

    /// Warnings of the run.
    pub fn warnings(&self) -> Vec<String> {
        let points = self
            .point_warnings
            .iter()
            .map(|(text, points)| format!("{}: {text}", names::places(points)));
        let notes = self.notes.iter().map(|note| note.text.clone());
        points.chain(notes).collect()
    }

    /// Notes that tell that the state of charge was missed.
    pub fn soc_missed(&self) -> impl Iterator<Item = &str> {
        let missed = self.notes.iter().filter(|note| note.is_soc_missed());
        missed.map(|note| note.text.as_str())
    }
}

/// Text of a warning without the command that looks at it: a resumed run may spell the path in it
/// another way.
fn odd(text: &str) -> &str {
    text.split_once("; `eis-bench ")
        .map_or(text, |(odd, _)| odd)
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
