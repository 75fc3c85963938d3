//! Errors that end a stage early: from an instrument, the interlock, a file, a person, a bound, or
//! a bench that does something else than it was told to.

use crate::{
    bench::BenchError, interlock::Trip, operator::OperatorError, record::RecordError, watch::Alarm,
};

/// Error that ends a stage early.
#[derive(Debug, thiserror::Error)]
pub enum ExecuteError {
    /// An instrument.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// An instrument is not set as this run has set it.
    #[error("{role}: {met}: another client, a hand at its panel, or a protection?")]
    Meddled {
        /// Its role.
        role: &'static str,
        /// State by its own answer.
        met: String,
    },
    /// The watch has ended the run.
    #[error(transparent)]
    Watch(Alarm),
    /// Two meters of one quantity say different things.
    #[error("{what}: {one}, {other}: they may differ by {allowed}; one of them is wrong")]
    Disagree {
        /// The quantity.
        what: &'static str,
        /// First reading, in words.
        one: String,
        /// Second reading, in words.
        other: String,
        /// How far they may be apart.
        allowed: String,
    },
    /// A meter shows the same for longer than its noise allows.
    #[error(
        "{what}: the last {times} readings of {meter} are all {value}, although its readings \
        before went up and down by noise: it is frozen{other}"
    )]
    Frozen {
        /// The quantity.
        what: &'static str,
        /// Who measures it.
        meter: &'static str,
        /// How many readings.
        times: u32,
        /// Value that all readings share, in words.
        value: String,
        /// Reading of another meter, in words that follow.
        other: String,
    },
    /// The channels of a record contradict each other.
    #[error("{freq_hz} Hz: the channels contradict each other: {found}: {cause}")]
    Channels {
        /// Frequency, Hz.
        freq_hz: f64,
        /// What was expected and what was found.
        found: String,
        /// Faults of leads that explain it, in words.
        cause: String,
    },
    /// The scope sends a record that it has sent before.
    #[error(
        "{freq_hz} Hz: expected a new record from the scope, found that of {earlier} again, code by \
        code in all four channels: the scope repeats an old record"
    )]
    Repeated {
        /// Frequency, Hz.
        freq_hz: f64,
        /// The record that was sent before, in words.
        earlier: String,
    },
    /// The interlock.
    #[error("interlock: {0}")]
    Trip(#[from] Trip),
    /// A file.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The person at the bench.
    #[error(transparent)]
    Operator(#[from] OperatorError),
    /// A person wants the run to end.
    #[error("ended on request; `eis-bench resume` with the run folder goes on")]
    Aborted,
    /// A step reached its upper bound.
    #[error("{step}: not reached within {max_s:.0} s ({state})")]
    Bound {
        /// The step in words.
        step: String,
        /// The bound, s.
        max_s: f64,
        /// State that was reached instead.
        state: String,
    },
    /// The bench does something else than it was told to.
    #[error("{what}: expected {expected}, measured {met}")]
    Disobeyed {
        /// Command that was given.
        what: String,
        /// Expected reaction.
        expected: String,
        /// Reaction that was met.
        met: String,
    },
    /// A control is asked for, and something with a voltage is in the jig.
    #[error(
        "{what}: expected nothing with a voltage in the jig, found {volts:.2} V: is the cell still \
        in?"
    )]
    CellLeftIn {
        /// Action that was about to be done.
        what: String,
        /// Voltage at the jig with every output off, V.
        volts: f64,
    },
    /// A frame of a trace cannot be used.
    #[error("trace {trace}, {frame}: {reason}")]
    Frame {
        /// Name of the trace.
        trace: String,
        /// The frame.
        frame: String,
        /// Why not.
        reason: String,
    },
    /// A record cannot be analysed.
    #[error("{freq_hz} Hz: {reason}")]
    Signal {
        /// Frequency, Hz.
        freq_hz: f64,
        /// Why not.
        reason: String,
    },
}

impl ExecuteError {
    /// A temperature, or what makes it, is wrong: the bath must not go on.
    pub fn is_of_temperature(&self) -> bool {
        match self {
            Self::Trip(trip) => trip.is_of_temperature(),
            Self::Disagree { what, .. } | Self::Frozen { what, .. } => what.contains("temperature"),
            _ => false,
        }
    }
}

impl From<Alarm> for ExecuteError {
    fn from(alarm: Alarm) -> Self {
        match alarm {
            Alarm::Trip(trip) => Self::Trip(trip),
            Alarm::Meddled { role, met } => Self::Meddled { role, met },
            Alarm::Blind { .. } | Alarm::Slow { .. } | Alarm::Lost(_) => Self::Watch(alarm),
        }
    }
}
