//! How fast the watch reads, and the bound on the time from a cause to zero current that follows
//! from the speed of the meters.

use instruments::units::Seconds;

use bench_plan::{
    config::{self, ANSWER_S, Experiment},
    interlock::Drive,
};

/// Target for the time between two readings of a drive, s.
const PERIOD_S: Seconds = Seconds(0.5);
/// Time in which an output that is switched off loses its current, and in which threads and
/// connections are scheduled, s.
const MARGIN_S: Seconds = Seconds(1.0);
/// Greatest number of answers between a cause and zero current: the query of the procedure in
/// progress, the current, the current once more, and two queries that switch off.
const ANSWERS: f64 = 5.0;
/// The number of answers for meters slower than [`ANSWER_S`]: procedure, watch and comparison of
/// settings then queue for one connection. Measured on answers 1 s late: 10.2 s at most.
const ANSWERS_OF_SLOW: f64 = 12.0;
/// Number of answer times that may pass without a reading, beside [`MARGIN_S`].
const ANSWERS_WITHOUT: f64 = 4.0;
/// Factor on the usual answer time of a drive in use that two successive answers must not both
/// exceed.
const LATE: f64 = 1.5;
/// Number of answer times that it may take to make the settings of a step.
const ANSWERS_TO_SET: f64 = 12.0;

/// Pace of the watch of one bench.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Longest usual time in which the meter of each drive answers, s.
    pub answers_s: [Seconds; 3],
    /// Longest time without a temperature while a current may flow, s.
    pub temperature_age_s: Seconds,
}

impl Pace {
    /// Returns the pace for an experiment.
    pub fn of(experiment: &Experiment) -> Self {
        let config::Instruments {
            supply4q,
            load,
            supply,
            ..
        } = &experiment.bench.instruments;
        Self {
            answers_s: [supply4q, load, supply]
                .map(|one| one.as_ref().map_or(ANSWER_S, |one| one.answer_s)),
            temperature_age_s: experiment.cell.interlock.temperature_age_s,
        }
    }

    /// Returns an error if the meters of the bench are too slow for the cell.
    ///
    /// # Errors
    /// The bound, and what the cell file allows.
    pub fn check(&self, experiment: &Experiment) -> Result<(), String> {
        let (bound_s, most_s) = (self.bound_s(), experiment.cell.interlock.reading_age_s);
        if bound_s <= most_s {
            return Ok(());
        }
        Err(format!(
            "expected the watch to end a current within {most_s} (interlock.reading_age_max of the \
            cell), found {bound_s:.1}: {}",
            self.describe(&experiment.bench.instruments)
        ))
    }

    /// Describes the bound, with the answer times that it follows from.
    pub fn describe(&self, instruments: &config::Instruments) -> String {
        let config::Instruments {
            supply4q,
            load,
            supply,
            ..
        } = instruments;
        let answers: Vec<String> = Drive::ALL
            .into_iter()
            .zip([supply4q, load, supply])
            .filter(|(_, present)| present.is_some())
            .map(|(drive, _)| format!("{} {} s", drive.role(), (self.answers_s[drive as usize]).0))
            .collect();
        format!(
            "watch: from a cause to no current within {:.1} s (usual time of an answer: {})",
            self.bound_s().0,
            answers.join(", ")
        )
    }

    /// Returns the answer time of the slowest meter.
    fn slowest_s(&self) -> Seconds {
        self.answers_s.iter().copied().fold(ANSWER_S, Seconds::max)
    }

    /// Returns the time between two readings of a drive, s.
    pub(super) fn period_s(&self) -> Seconds {
        PERIOD_S
    }

    /// Returns the longest time without a reading of a drive in use, s.
    pub fn blind_s(&self, drive: Drive) -> Seconds {
        MARGIN_S + ANSWERS_WITHOUT * self.answers_s[drive as usize].max(ANSWER_S)
    }

    /// Returns the longest answer time of a drive in use that is tolerated twice in a row, s.
    pub(super) fn late_s(&self, drive: Drive) -> Seconds {
        LATE * self.answers_s[drive as usize].max(ANSWER_S)
    }

    /// Returns the longest time to zero current from a cause that a meter shows at once, s.
    pub fn bound_s(&self) -> Seconds {
        let slowest_s = self.slowest_s();
        let answers = if slowest_s > ANSWER_S {
            ANSWERS_OF_SLOW
        } else {
            ANSWERS
        };
        PERIOD_S + MARGIN_S + answers * slowest_s
    }

    /// Returns how long the envelope of the previous step may apply, s.
    pub(super) fn settle_s(&self) -> Seconds {
        MARGIN_S + ANSWERS_TO_SET * self.slowest_s()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bound_follows_the_slowest_meter() {
        for (answer_s, bound_s, blind_s) in [
            (0.1, 3.0, 2.2),
            (0.3, 3.0, 2.2),
            (1.0, 13.5, 5.0),
            (2.0, 25.5, 9.0),
        ] {
            let pace = Pace {
                answers_s: [ANSWER_S, Seconds(answer_s), ANSWER_S],
                temperature_age_s: Seconds(60.0),
            };
            assert!((pace.bound_s() - Seconds(bound_s)).abs() < Seconds(1e-9));
            assert!((pace.blind_s(Drive::Load) - Seconds(blind_s)).abs() < Seconds(1e-9));
        }
    }
}
