//! Judges the readings of a bath's own sensor. The functions are pure: they take readings with
//! their times and return a fault or nothing. The daemon calls them at each check of the bath; the
//! guardian and `eis-bench safe` call them with a few successive readings.

use instruments::units::{Celsius, Kelvins, Seconds};

use serde::{Deserialize, Serialize};

/// Distance from its set-point within which a bath counts as held, K. Circulators hold 0.1 K and
/// overshoot by 1 K to 2 K.
const HELD_K: Kelvins = Kelvins(3.0);
/// Greatest distance of the sensor from the cell's temperature limits, K: a bath that holds the
/// cell at a limit regulates around it.
const BEYOND_LIMITS_K: Kelvins = Kelvins(1.0);
/// Change of the distance from the set-point that shows a direction, K: more than the noise and the
/// digits of a bath's sensor.
const DIRECTION_K: Kelvins = Kelvins(0.2);
/// Decrease of the distance from its greatest value that shows that a bath returns, K.
const TURNED_K: Kelvins = Kelvins(0.5);

/// One reading of a bath.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BathReading {
    /// Temperature by its own sensor, °C; `None` if the answer was not a temperature.
    pub sensor_degc: Option<Celsius>,
    /// Its set-point, °C.
    pub setpoint_degc: Celsius,
}

/// Fault of a bath.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum BathFault {
    /// Its sensor reads a temperature that the cell does not tolerate.
    #[error(
        "its sensor reads {sensor_degc:.1}, and the cell bears {least_degc} to {greatest_degc}; \
        its set-point is {setpoint_degc:.1}"
    )]
    OutsideLimits {
        /// Reading of its sensor, °C.
        #[serde(rename = "sensor_c")]
        sensor_degc: Celsius,
        /// Its set-point, °C.
        #[serde(rename = "setpoint_c")]
        setpoint_degc: Celsius,
        /// Least temperature of the cell, °C.
        #[serde(rename = "least_c")]
        least_degc: Celsius,
        /// Greatest temperature of the cell, °C.
        #[serde(rename = "greatest_c")]
        greatest_degc: Celsius,
    },
    /// It moves away from its set-point and does not return.
    #[error(
        "its sensor reads {sensor_degc:.1} and moves away from the set-point of {setpoint_degc:.1}: \
        the distance was {nearest_k:.1} before"
    )]
    MovesAway {
        /// Reading of its sensor, °C.
        #[serde(rename = "sensor_c")]
        sensor_degc: Celsius,
        /// Its set-point, °C.
        #[serde(rename = "setpoint_c")]
        setpoint_degc: Celsius,
        /// Least distance between the two since it had this set-point, K.
        nearest_k: Kelvins,
    },
    /// Its sensor returns no temperature.
    #[error("its sensor has read no temperature for {age_s:.0}")]
    Unread {
        /// Time since the last temperature, s.
        age_s: Seconds,
    },
}

/// How far and how long a sound bath may deviate.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Patience {
    /// Growth of the distance from the set-point beyond its least value, K.
    grown_k: Kelvins,
    /// How long the distance may stay grown, and the longest time until the next step towards its
    /// set-point for a bath outside the cell's limits, s.
    away_s: Seconds,
    /// How long the sensor may return no temperature, s.
    unread_s: Seconds,
}

/// For a bath that is read repeatedly, and stopped later if it does not return.
const WATCHED: Patience = Patience {
    grown_k: HELD_K,
    away_s: Seconds(60.0),
    unread_s: Seconds(60.0),
};
/// For a bath that is read for some seconds and not watched afterwards.
const LEFT_ALONE: Patience = Patience {
    grown_k: DIRECTION_K,
    away_s: Seconds::ZERO,
    unread_s: Seconds::ZERO,
};

/// Distance between sensor and set-point over time, since the bath has this set-point.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Course {
    setpoint_degc: Celsius,
    /// Least distance, K.
    nearest_k: Kelvins,
    /// Distance at the last step towards the set-point, K, and its time, s; `None` before the first.
    step: (Kelvins, Option<Seconds>),
    began_s: Seconds,
    /// Start of the present growth of the distance, s, and its greatest value since then, K.
    away: Option<(Seconds, Kelvins)>,
    /// Whether every reading was outside the cell's limits.
    outside: bool,
}

impl Course {
    fn begin(setpoint_degc: Celsius, distance_k: Kelvins, now_s: Seconds) -> Self {
        Self {
            setpoint_degc,
            nearest_k: distance_k,
            step: (distance_k, None),
            began_s: now_s,
            away: None,
            outside: true,
        }
    }

    /// Adds a distance. Returns true if the bath moves away.
    fn moves_away(&mut self, distance_k: Kelvins, now_s: Seconds, patience: Patience) -> bool {
        self.nearest_k = self.nearest_k.min(distance_k);
        if distance_k <= self.step.0 - DIRECTION_K {
            self.step = (distance_k, Some(now_s));
        }
        if distance_k <= HELD_K || distance_k <= self.nearest_k + patience.grown_k {
            self.away = None;
            return false;
        }
        let (since_s, farthest_k) = self.away.unwrap_or((now_s, distance_k));
        if distance_k < farthest_k - TURNED_K {
            // The bath returns: from here on it approaches again.
            *self = Self {
                outside: self.outside,
                ..Self::begin(self.setpoint_degc, distance_k, now_s)
            };
            return false;
        }
        self.away = Some((since_s, farthest_k.max(distance_k)));
        now_s - since_s >= patience.away_s
    }

    /// Checks whether the bath made a step towards its set-point, or received the set-point,
    /// within this time.
    fn approaches(&self, now_s: Seconds, within_s: Seconds) -> bool {
        now_s - self.step.1.unwrap_or(self.began_s) < within_s
    }
}

/// Judges successive readings of one bath.
#[derive(Debug, Clone, PartialEq)]
pub struct BathJudge {
    /// Least and greatest temperature of the cell, °C, if they are known.
    cell_degc: Option<(Celsius, Celsius)>,
    patience: Patience,
    course: Option<Course>,
    /// Time of the last temperature, or of the first query, s.
    read_s: Option<Seconds>,
}

impl BathJudge {
    /// Creates a judge for a bath that is read at each check. It stops a bath that is more than 3
    /// K farther from its set-point than before for 60 s without returning. `cell_degc` is the least
    /// and the greatest temperature of the cell, °C.
    pub fn watching(cell_degc: Option<(Celsius, Celsius)>) -> Self {
        Self::new(cell_degc, WATCHED)
    }

    /// Creates a judge for a bath that is not watched after a few readings: it tolerates no
    /// deviation over time.
    pub fn leaving(cell_degc: Option<(Celsius, Celsius)>) -> Self {
        Self::new(cell_degc, LEFT_ALONE)
    }

    fn new(cell_degc: Option<(Celsius, Celsius)>, patience: Patience) -> Self {
        Self {
            cell_degc,
            patience,
            course: None,
            read_s: None,
        }
    }

    /// Judges a reading that was taken at `now_s`. A new set-point resets the history: a bath that
    /// approaches it, from any distance, is sound.
    pub fn judge(&mut self, reading: BathReading, now_s: Seconds) -> Option<BathFault> {
        let Some(sensor_degc) = reading.sensor_degc.filter(|celsius| celsius.is_finite()) else {
            let age_s = now_s - *self.read_s.get_or_insert(now_s);
            return (age_s >= self.patience.unread_s).then_some(BathFault::Unread { age_s });
        };
        self.read_s = Some(now_s);
        let setpoint_degc = reading.setpoint_degc;
        let distance_k = (sensor_degc - setpoint_degc).abs();
        let course = self
            .course
            .get_or_insert_with(|| Course::begin(setpoint_degc, distance_k, now_s));
        if course.setpoint_degc != setpoint_degc {
            *course = Course::begin(setpoint_degc, distance_k, now_s);
        }
        let away = course.moves_away(distance_k, now_s, self.patience);
        let outside = self.cell_degc.filter(|(least_degc, greatest_degc)| {
            !(*least_degc - BEYOND_LIMITS_K..=*greatest_degc + BEYOND_LIMITS_K)
                .contains(&sensor_degc)
        });
        course.outside &= outside.is_some();
        let comes_back = course.outside && course.approaches(now_s, self.patience.away_s);
        match outside.filter(|_| !comes_back) {
            Some((least_degc, greatest_degc)) => Some(BathFault::OutsideLimits {
                sensor_degc,
                setpoint_degc,
                least_degc,
                greatest_degc,
            }),
            None => away.then_some(BathFault::MovesAway {
                sensor_degc,
                setpoint_degc,
                nearest_k: course.nearest_k,
            }),
        }
    }

    /// Checks whether a single reading is sufficient: a bath near its set-point is under control.
    pub fn is_held(reading: BathReading) -> bool {
        reading
            .sensor_degc
            .is_some_and(|sensor_degc| (sensor_degc - reading.setpoint_degc).abs() <= HELD_K)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CELL_C: Option<(Celsius, Celsius)> = Some((Celsius(0.0), Celsius(45.0)));

    /// Returns the first fault, and its time, of readings every ten seconds for two hours.
    fn first_fault(
        mut judge: BathJudge,
        setpoint_degc: f64,
        sensor_degc: impl Fn(f64) -> f64,
    ) -> Option<(f64, BathFault)> {
        (0..720).find_map(|k| {
            let now_s = 10.0 * f64::from(k);
            let reading = BathReading {
                sensor_degc: Some(Celsius(sensor_degc(now_s)))
                    .filter(|celsius| celsius.is_finite()),
                setpoint_degc: Celsius(setpoint_degc),
            };
            Some((now_s, judge.judge(reading, Seconds(now_s))?))
        })
    }

    /// Returns a first-order approach from one temperature to another.
    fn approach(from_degc: f64, to_degc: f64, tau_s: f64) -> impl Fn(f64) -> f64 {
        move |now_s| to_degc + (from_degc - to_degc) * (-now_s / tau_s).exp()
    }

    #[test]
    fn a_bath_that_approaches_holds_or_overshoots_is_sound() {
        let overshoots = |now_s: f64| 40.0 + 5.6 * (-now_s / 200.0).exp() * (now_s / 60.0).sin();
        let noisy = |now_s: f64| 25.0 + 0.1 * (now_s * 7.0).sin();
        let late = |now_s: f64| if now_s < 900.0 { 22.0 } else { 40.0 };
        let dips = |now_s: f64| 22.0 - 2.5 * (-now_s / 50.0).exp() + now_s / 400.0;
        for (case, setpoint_degc, sensor_degc) in [
            (
                "heats",
                40.0,
                &approach(22.0, 40.0, 600.0) as &dyn Fn(f64) -> f64,
            ),
            ("cools", 5.0, &approach(40.0, 5.0, 900.0)),
            ("heats slowly", 45.0, &approach(5.0, 45.0, 3000.0)),
            ("holds at the limit", 45.0, &|now_s| {
                45.4 + 0.3 * (now_s / 100.0).sin()
            }),
            ("overshoots", 40.0, &overshoots),
            ("is noisy", 25.0, &noisy),
            ("does not move for a while", 40.0, &late),
            ("mixes first", 40.0, &dips),
            (
                "cools from where no cell may be",
                25.0,
                &approach(70.0, 25.0, 400.0),
            ),
        ] {
            let fault = first_fault(BathJudge::watching(CELL_C), setpoint_degc, sensor_degc);
            assert_eq!(fault, None, "{case}");
        }
    }

    #[test]
    fn a_bath_that_runs_away_is_at_fault_within_two_minutes_of_leaving_its_band() {
        for (case, sensor_degc, at_most_s, away) in [
            (
                "heats",
                &(|now_s| 25.0 + 0.1 * now_s) as &dyn Fn(f64) -> f64,
                100.0,
                true,
            ),
            ("heats slowly", &|now_s| 25.0 + 0.01 * now_s, 370.0, true),
            ("cools", &|now_s| 25.0 - 0.1 * now_s, 100.0, true),
            (
                "jumps and stays",
                &|now_s| if now_s < 100.0 { 25.0 } else { 33.0 },
                160.0,
                true,
            ),
            ("heats fast", &|now_s| 25.0 + now_s, 30.0, false),
            (
                "turns in the middle",
                &|now_s| 40.0 - 0.05 * now_s.min(200.0) + 0.1 * (now_s - 200.0).max(0.0),
                300.0,
                true,
            ),
            ("is hot and stays", &|_| 70.0, 60.0, false),
            (
                "is hot and gets hotter",
                &|now_s| 70.0 + 0.1 * now_s,
                60.0,
                false,
            ),
            (
                "cools and stands still outside",
                &|now_s| (70.0 - 0.1 * now_s).max(60.0),
                160.0,
                false,
            ),
        ] {
            let Some((at_s, fault)) = first_fault(BathJudge::watching(CELL_C), 25.0, sensor_degc)
            else {
                panic!("{case}: no fault")
            };
            assert!(at_s <= at_most_s, "{case}: {at_s} s");
            assert_eq!(
                matches!(fault, BathFault::MovesAway { .. }),
                away,
                "{case}: {fault}"
            );
        }
    }

    #[test]
    fn a_sensor_that_reads_nothing_is_a_fault_after_a_minute() {
        let fault = first_fault(BathJudge::watching(None), 25.0, |now_s| {
            if now_s < 100.0 { 25.0 } else { f64::NAN }
        });
        let (at_s, fault) = fault.unwrap();
        assert_eq!(at_s, 150.0);
        assert_eq!(
            fault.to_string(),
            "its sensor has read no temperature for 60 s"
        );
    }

    #[test]
    fn an_unwatched_bath_is_judged_within_seconds() {
        let fault = |cell_degc, sensors_degc: &[f64]| {
            let mut judge = BathJudge::leaving(cell_degc);
            sensors_degc
                .iter()
                .enumerate()
                .find_map(|(k, sensor_degc)| {
                    let reading = BathReading {
                        sensor_degc: Some(Celsius(*sensor_degc)),
                        setpoint_degc: Celsius(25.0),
                    };
                    judge.judge(reading, Seconds(k as f64))
                })
        };
        for (sensors_degc, cell_degc, words) in [
            (&[24.9, 25.0, 25.1][..], CELL_C, None),
            (
                &[75.0],
                CELL_C,
                Some(
                    "its sensor reads 75.0 °C, and the cell bears 0 °C to 45 °C; its set-point is \
                    25.0 °C",
                ),
            ),
            (
                &[75.0, 75.1, 75.3],
                None,
                Some(
                    "its sensor reads 75.3 °C and moves away from the set-point of 25.0 °C: the \
                    distance was 50.0 K before",
                ),
            ),
            (
                &[30.0, 30.1, 30.3],
                CELL_C,
                Some(
                    "its sensor reads 30.3 °C and moves away from the set-point of 25.0 °C: the \
                    distance was 5.0 K before",
                ),
            ),
            (&[30.0, 29.9, 29.7], CELL_C, None),
            (&[30.0, 30.0, 30.0], CELL_C, None),
            (&[10.0, 10.4, 11.0], CELL_C, None),
        ] {
            let met = fault(cell_degc, sensors_degc).map(|fault| fault.to_string());
            assert_eq!(met.as_deref(), words, "{sensors_degc:?}");
        }
    }

    #[test]
    fn a_new_set_point_begins_a_new_course() {
        let mut judge = BathJudge::watching(CELL_C);
        for k in 0..400 {
            let now_s = 10.0 * f64::from(k);
            let setpoint_degc = if k < 200 { 25.0 } else { 5.0 };
            let sensor_degc = if k < 200 {
                25.0
            } else {
                // The compressor starts late.
                approach(25.0, 5.0, 300.0)((now_s - 2120.0).max(0.0))
            };
            let reading = BathReading {
                sensor_degc: Some(Celsius(sensor_degc)),
                setpoint_degc: Celsius(setpoint_degc),
            };
            assert_eq!(judge.judge(reading, Seconds(now_s)), None, "{now_s}");
        }
    }
}
