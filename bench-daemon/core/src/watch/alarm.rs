//! Alarms of the watch.

use instruments::units::Seconds;

use bench_plan::interlock::Trip;

/// An alarm of the watch.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Alarm {
    /// A reading left its limits twice.
    #[error("interlock: {0}")]
    Trip(Trip),
    /// The settings of an instrument differ from those that this run made.
    #[error("{role}: {met}: another client, a hand at its panel, or a protection?")]
    Meddled {
        /// Its role.
        role: &'static str,
        /// State as the instrument reports it.
        met: String,
    },
    /// The meter of a drive in use does not answer.
    #[error(
        "{role}: expected a reading within {limit_s:.1} while a current may flow, found none for \
        {age_s:.1}: {why}"
    )]
    Blind {
        /// Its role.
        role: &'static str,
        /// Time without a reading, s.
        age_s: Seconds,
        /// Longest time without a reading, s.
        limit_s: Seconds,
        /// The last error of its link.
        why: String,
    },
    /// The meter of a drive in use answers, but later than the bound of the watch allows.
    #[error(
        "{role}: expected an answer within {limit_s:.2} while a current may flow, found {answer_s:.2} \
        twice in a row; if its answers usually take that long, state it as `answer` in the bench file"
    )]
    Slow {
        /// Its role.
        role: &'static str,
        /// The shorter of the last two answer times, s.
        answer_s: Seconds,
        /// Longest answer time that is tolerated twice in a row, s.
        limit_s: Seconds,
    },
    /// The watch itself has ended.
    #[error("the watch of the bench has ended: {0}")]
    Lost(String),
}
