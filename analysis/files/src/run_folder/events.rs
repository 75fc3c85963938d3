//! The rows of `events.csv`.

/// The columns of `events.csv`.
pub const EVENT_COLUMNS: &str = "time_s,kind,event";

/// The event from which on current may flow, in words.
pub const OUTPUT_ON: &str = "bipolar supply: output on";

/// Kind of event in a row of `events.csv`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// A stage begins.
    Stage,
    /// A step begins.
    Step,
    /// State of an instrument, or an action of it outside the plan.
    Bench,
    /// The output of the bipolar supply is switched on: current may flow from here on.
    OutputOn,
    /// A check and its result.
    Check,
    /// Something is measured or done again.
    Again,
    /// A person's request is handled.
    Request,
    /// The run continues.
    Resumed,
    /// An anomaly, which the report lists too.
    Note,
}

impl Event {
    /// Every kind.
    const ALL: [Self; 9] = [
        Self::Stage,
        Self::Step,
        Self::Bench,
        Self::OutputOn,
        Self::Check,
        Self::Again,
        Self::Request,
        Self::Resumed,
        Self::Note,
    ];

    /// Returns its name in the file.
    pub fn label(self) -> &'static str {
        match self {
            Self::Stage => "stage",
            Self::Step => "step",
            Self::Bench => "bench",
            Self::OutputOn => "output_on",
            Self::Check => "check",
            Self::Again => "again",
            Self::Request => "request",
            Self::Resumed => "resumed",
            Self::Note => "note",
        }
    }

    fn of_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.label() == word)
    }

    /// The row of an event of this kind, without the end of its line.
    pub fn row(self, time_s: f64, text: &str) -> String {
        format!(
            "{time_s:.3},{},\"{}\"",
            self.label(),
            text.replace('"', "'")
        )
    }
}

/// One row of `events.csv`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EventRow<'a> {
    /// Bench time, s.
    pub time_s: f64,
    /// Its kind; `None` in older files without kinds.
    pub kind: Option<Event>,
    /// Text of the event, as in the file.
    pub text: &'a str,
}

impl<'a> EventRow<'a> {
    /// Parses a row; returns `None` without a time. Older files lack the kind [`Event::OutputOn`]
    /// or all kinds; the kind then follows from the text.
    pub fn parse(row: &'a str) -> Option<Self> {
        let (time, rest) = row.split_once(',')?;
        let with_kind = rest
            .split_once(',')
            .and_then(|(word, text)| Some((Event::of_word(word)?, text)));
        let (kind, text) = with_kind.map_or((None, rest), |(kind, text)| (Some(kind), text));
        let kind = match kind {
            Some(Event::Bench) | None if text.contains(OUTPUT_ON) => Some(Event::OutputOn),
            _ => kind,
        };
        Some(Self {
            time_s: time.parse().ok()?,
            kind,
            text,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_is_on_by_its_kind_or_in_older_files_by_its_words() {
        let read = |row: &str| EventRow::parse(row).map(|row| (row.time_s, row.kind));
        let on = Some((157.0, Some(Event::OutputOn)));
        assert_eq!(read(&Event::OutputOn.row(157.0, OUTPUT_ON)), on);
        assert_eq!(read(&Event::Bench.row(157.0, OUTPUT_ON)), on);
        assert_eq!(read("157.000,\"bipolar supply: output on\""), on);
        assert_eq!(
            read(&Event::Note.row(157.0, OUTPUT_ON)),
            Some((157.0, Some(Event::Note)))
        );
        assert_eq!(read("time_s,kind,event"), None);
    }

    #[test]
    fn every_kind_comes_back() {
        for kind in Event::ALL {
            let row = kind.row(1.5, "a, \"b\"");
            let read = EventRow::parse(&row).map(|row| (row.kind, row.text));
            assert_eq!(read, Some((Some(kind), "\"a, 'b'\"")));
        }
    }
}
