//! Judges the readings of one drive. A reading beyond the envelope is repeated at once: a single
//! glitch of a meter does not end a run.

use instruments::{instrument::Measured, units::Seconds, units::Unit};

use super::envelope::Envelopes;
use bench_plan::interlock::{Drive, Trip};

/// Two readings beyond the envelope within this time end the run, s: a slow sinusoid with too
/// large an amplitude is beyond it only near its crests.
const MEMORY_S: Seconds = Seconds(3.0);

/// Consequence of a reading.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Judgement {
    /// The reading is within the envelope.
    Within,
    /// The reading is beyond the envelope for the first time. It is repeated at once, including
    /// the voltage if that was the cause.
    AskAgain {
        /// The voltage was beyond its limits.
        volts: bool,
        /// The trip that a second reading would confirm.
        trip: Trip,
    },
    /// The reading is beyond the envelope again.
    Beyond(Trip),
}

/// Tracks readings of one drive beyond the envelope.
#[derive(Debug)]
pub(super) struct Judge {
    drive: Drive,
    /// Whether the voltage of this meter is that of the cell.
    reads_cell: bool,
    /// Time of the last reading beyond the envelope, s.
    beyond_s: Option<Seconds>,
}

impl Judge {
    pub(super) fn new(drive: Drive, reads_cell: bool) -> Self {
        Self {
            drive,
            reads_cell,
            beyond_s: None,
        }
    }

    /// Judges a reading; `time_s` is bench time, for the message.
    pub(super) fn judge(
        &mut self,
        reading: &Measured,
        envelopes: &Envelopes,
        time_s: Seconds,
    ) -> Judgement {
        let Some(trip) = self.trip(reading, envelopes, time_s) else {
            return Judgement::Within;
        };
        let since_s = self
            .beyond_s
            .replace(Seconds(reading.answered_s))
            .map_or(Seconds::INFINITY, |before_s| {
                Seconds(reading.answered_s) - before_s
            });
        if since_s <= MEMORY_S {
            Judgement::Beyond(trip)
        } else {
            Judgement::AskAgain {
                volts: matches!(trip, Trip::Limit { unit: "V", .. }),
                trip,
            }
        }
    }

    /// Returns the quantity that is beyond the envelope, with the limits of the present step.
    fn trip(&self, reading: &Measured, envelopes: &Envelopes, time_s: Seconds) -> Option<Trip> {
        let Envelopes { allowed, present } = envelopes;
        let what = match self.drive {
            Drive::Supply4q if present.uses(self.drive) => "cell current",
            drive => drive.current(),
        };
        let of = self.drive;
        let current = limited(
            what,
            reading.amps,
            [allowed.amps(of), present.amps(of)],
            time_s,
        );
        current.or_else(|| {
            let volts = reading.volts.filter(|_| self.reads_cell)?;
            let limits = allowed.volts()?;
            limited("cell voltage", volts, [limits, limits], time_s)
        })
    }
}

/// Trips if a value is outside what is allowed; the trip states the limits of the present step.
fn limited<Q: Unit>(
    what: &'static str,
    value: Q,
    [allowed, present]: [(Q, Q); 2],
    time_s: Seconds,
) -> Option<Trip> {
    let present = present.0..=present.1;
    (!(allowed.0..=allowed.1).contains(&value)).then(|| Trip::limit(what, value, &present, time_s))
}

#[cfg(test)]
mod tests {
    use instruments::units::{Amps, Celsius, Volts};

    use super::*;
    use crate::watch::Envelope;
    use bench_plan::interlock::{Allowance, Drives, Limits};

    fn judged(readings: &[(f64, f64, f64)]) -> Vec<&'static str> {
        let limits = Limits {
            min_v: Volts(2.5),
            max_v: Volts(4.2),
            charge_a: Amps(1.2),
            discharge_a: Amps(1.2),
            min_degc: Celsius(0.0),
            max_degc: Celsius(60.0),
        };
        let envelope = Envelope::of(&Allowance {
            live: true,
            drives: Drives::SUPPLY4Q,
            ..Allowance::idle(limits)
        });
        let envelopes = Envelopes {
            allowed: envelope,
            present: envelope,
        };
        let mut judge = Judge::new(Drive::Supply4q, true);
        readings
            .iter()
            .map(|(time_s, volts, amps)| {
                let reading = Measured {
                    volts: Some(Volts(*volts)),
                    amps: Amps(*amps),
                    asked_s: *time_s,
                    answered_s: *time_s,
                };
                match judge.judge(&reading, &envelopes, Seconds(*time_s)) {
                    Judgement::Within => "within",
                    Judgement::AskAgain { .. } => "again",
                    Judgement::Beyond(_) => "beyond",
                }
            })
            .collect()
    }

    #[test]
    fn one_reading_is_asked_again_and_a_second_one_ends_the_run() {
        for (readings, expected) in [
            (vec![(0.0, 3.7, 1.2), (0.5, 3.7, -1.2)], vec!["within"; 2]),
            (
                vec![(0.0, 3.7, 1.9), (0.1, 3.7, 1.0), (4.0, 3.7, 1.9)],
                vec!["again", "within", "again"],
            ),
            (
                vec![(0.0, 3.7, 1.9), (0.1, 3.7, 1.9)],
                vec!["again", "beyond"],
            ),
            // One crest of a slow sinusoid, and the next.
            (
                vec![(0.0, 3.7, 1.9), (1.0, 3.7, 0.3), (2.5, 3.7, -1.9)],
                vec!["again", "within", "beyond"],
            ),
            (
                vec![(0.0, 4.3, 1.0), (0.2, 4.3, 1.0)],
                vec!["again", "beyond"],
            ),
            (
                vec![(0.0, 3.7, f64::NAN), (0.2, 3.7, f64::NAN)],
                vec!["again", "beyond"],
            ),
        ] {
            assert_eq!(judged(&readings), expected, "{readings:?}");
        }
    }
}
