//! Errors that end a stage early: from an instrument, the interlock, a file, a person, a bound, or
//! a bench that does not execute a command.

use instruments::units::{Hertz, Seconds, Volts};

use crate::{bench::BenchError, operator::OperatorError, record::RecordError, watch::Alarm};
use bench_plan::interlock::Trip;

/// Error that ends a stage early.
#[derive(Debug, thiserror::Error)]
pub enum ExecuteError {
    /// An instrument failed.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The settings of an instrument differ from those that this run made.
    #[error("{role}: {met}: another client, a hand at its panel, or a protection?")]
    Meddled {
        /// Its role.
        role: &'static str,
        /// State as the instrument reports it.
        met: String,
    },
    /// The watch has ended the run.
    #[error(transparent)]
    Watch(Alarm),
    /// Two meters of one quantity disagree.
    #[error("{what}: {one}, {other}: they may differ by {allowed}; one of them is wrong")]
    Disagree {
        /// The quantity.
        what: &'static str,
        /// First reading, as text.
        one: String,
        /// Second reading, as text.
        other: String,
        /// Allowed difference.
        allowed: String,
    },
    /// A meter shows the same value for longer than its noise allows.
    #[error(
        "{what}: the last {times} readings of {meter} are all {value}, although its readings \
        before went up and down by noise: it is frozen{other}"
    )]
    Frozen {
        /// The quantity.
        what: &'static str,
        /// The role that measures it.
        meter: &'static str,
        /// Number of readings.
        times: u32,
        /// Value of all these readings, as text.
        value: String,
        /// Reading of another meter, as text that follows.
        other: String,
    },
    /// The channels of a record contradict each other.
    #[error("{freq_hz}: the channels contradict each other: {found}: {cause}")]
    Channels {
        /// Frequency, Hz.
        freq_hz: Hertz,
        /// What was expected and what was found.
        found: String,
        /// Lead faults that explain it, as text.
        cause: String,
    },
    /// The scope sends a record that it has already sent.
    #[error(
        "{freq_hz}: expected a new record from the scope, found that of {earlier} again, code by \
        code in all four channels: the scope repeats an old record"
    )]
    Repeated {
        /// Frequency, Hz.
        freq_hz: Hertz,
        /// The earlier record, as text.
        earlier: String,
    },
    /// The interlock tripped.
    #[error("interlock: {0}")]
    Trip(#[from] Trip),
    /// A file cannot be written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The person at the bench cannot be asked.
    #[error(transparent)]
    Operator(#[from] OperatorError),
    /// A person has ended the run.
    #[error("ended on request; `eis-bench resume` with the run folder goes on")]
    Aborted,
    /// A step reached its upper bound.
    #[error("{step}: not reached within {max_s:.0} ({state})")]
    Bound {
        /// The step, as text.
        step: String,
        /// The bound, s.
        max_s: Seconds,
        /// State that was reached instead.
        state: String,
    },
    /// The bench does something other than it was commanded.
    #[error("{what}: expected {expected}, measured {met}")]
    Disobeyed {
        /// Command that was given.
        what: String,
        /// Expected reaction.
        expected: String,
        /// Observed reaction.
        met: String,
    },
    /// A control is requested, but something with a voltage is in the jig.
    #[error(
        "{what}: expected nothing with a voltage in the jig, found {volts:.2}: is the cell still \
        in?"
    )]
    CellLeftIn {
        /// Action that was about to be taken.
        what: String,
        /// Voltage at the jig with every output off, V.
        volts: Volts,
    },
    /// A frame of a trace cannot be used.
    #[error("trace {trace}, {frame}: {reason}")]
    Frame {
        /// Name of the trace.
        trace: String,
        /// The frame.
        frame: String,
        /// Reason.
        reason: String,
    },
    /// A record cannot be analysed.
    #[error("{freq_hz}: {reason}")]
    Signal {
        /// Frequency, Hz.
        freq_hz: Hertz,
        /// Reason.
        reason: String,
    },
}

impl ExecuteError {
    /// Checks whether a temperature, or the device that controls it, is faulty. If so, the bath
    /// must not continue.
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
