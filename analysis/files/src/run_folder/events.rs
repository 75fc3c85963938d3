//! The rows of `events.csv`.

/// The columns of `events.csv`.
pub const EVENT_COLUMNS: &str = "time_s,kind,event";

/// What kind of event a row of `events.csv` tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// A stage begins.
    Stage,
    /// A step begins.
    Step,
    /// What an instrument is found in, or what it does beside the plan.
    Bench,
    /// A check, and what it says.
    Check,
    /// Something is measured or done again.
    Again,
    /// A person's request is heeded.
    Request,
    /// The run goes on.
    Resumed,
    /// Something odd, which stands in the report too.
    Note,
}

impl Event {
    /// Its word in the file.
    pub fn word(self) -> &'static str {
        match self {
            Self::Stage => "stage",
            Self::Step => "step",
            Self::Bench => "bench",
            Self::Check => "check",
            Self::Again => "again",
            Self::Request => "request",
            Self::Resumed => "resumed",
            Self::Note => "note",
        }
    }

    /// The row of an event of this kind, without the end of its line.
    pub fn row(self, time_s: f64, text: &str) -> String {
        format!("{time_s:.3},{},\"{}\"", self.word(), text.replace('"', "'"))
    }
}
