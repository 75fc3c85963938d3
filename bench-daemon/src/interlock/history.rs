//! What only several readings together show: the rate of the temperature, the charge that has moved, readings that are late or missing, values
//! that do not move.

use std::collections::VecDeque;

use instruments::chiller;

use super::{Limits, Reading, Trip, judge};

/// What the interlock allows beside the limits of the cell.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Greatest rate of the surface temperature, rising or falling, K/s.
    pub rate_k_per_s: f64,
    /// Time over which the rate is taken, s.
    pub window_s: f64,
    /// Greatest charge that one discharge or charge may move, C.
    pub charge_c: f64,
    /// How far the charge may be from what a step without a net charge, or with a known one, should have moved, C.
    pub drift_c: f64,
    /// Greatest time between two readings while current may flow, seconds of the machine.
    pub reading_age_s: f64,
    /// The same for the temperature, on a bench with a logger.
    pub temperature_age_s: f64,
    /// A value that stays the same to the last digit while so much charge passes is frozen, C.
    pub frozen_c: f64,
    /// The same for a voltage and a current that a slow sinusoid moves, s; at least two of its periods.
    pub frozen_s: f64,
}

/// What the step in work may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Allowance {
    /// Limits of each reading.
    pub limits: Limits,
    /// Outputs are on: readings must come.
    pub live: bool,
    /// The step belongs to the one before it: its charge counts on.
    pub continues: bool,
    /// Least and greatest net charge, C, charge positive.
    pub charge_c: (f64, f64),
    /// A supply holds the voltage from here on, V: that it stands still is no fault.
    pub held_v: f64,
    /// The period of a sinusoid that is slow enough to be followed reading by reading, s: current and, of a cell, voltage must move with it.
    pub swing_s: Option<f64>,
    /// The cell is in the jig: its voltage moves with the charge.
    pub cell: bool,
    /// The chiller is to change the temperature: its rate is not judged.
    pub tempering: bool,
}

impl Allowance {
    /// Nothing may flow.
    pub fn idle(limits: Limits) -> Self {
        let charge_c = (f64::NEG_INFINITY, f64::INFINITY);
        Self { limits, live: false, continues: false, charge_c, held_v: f64::INFINITY, swing_s: None, cell: true, tempering: false }
    }
}

/// A value, and the charge, C, and the bench time, s, at which it was seen to change last.
#[derive(Debug, Clone, Copy, Default)]
struct Last {
    value: Option<f64>,
    charge_c: f64,
    /// None: from the next reading on.
    time_s: Option<f64>,
}

impl Last {
    /// Charge, C, and time, s, that have passed since the value changed.
    fn since(&mut self, value: f64, (charge_c, time_s): (f64, f64)) -> (f64, f64) {
        if self.value != Some(value) {
            *self = Self { value: Some(value), charge_c, time_s: None };
        }
        ((charge_c - self.charge_c).abs(), time_s - *self.time_s.get_or_insert(time_s))
    }
}

/// Judges readings, one after the other.
#[derive(Debug)]
pub struct Interlock {
    settings: Settings,
    allowance: Allowance,
    /// There is a thermometer.
    logger: bool,
    /// Temperatures within the window, with their bench times, s.
    temperatures: VecDeque<(f64, f64)>,
    charge_c: f64,
    /// Current that was read last, with its bench time, s.
    current: Option<(f64, f64)>,
    /// When something was read last, and when the temperature was, seconds of the machine.
    read_s: Option<f64>,
    temperature_s: f64,
    voltage: Last,
    amps: Last,
    temperature: Last,
}

/// Periods of a slow sinusoid in which a reading must move.
const SWINGS: f64 = 2.0;
/// Fewest temperatures, and least share of the window, that make a rate.
const RATE: (usize, f64) = (3, 0.5);

impl Interlock {
    /// Nothing was read yet, and nothing may flow.
    pub fn new(settings: Settings, limits: Limits, logger: bool) -> Self {
        Self {
            settings,
            allowance: Allowance::idle(limits),
            logger,
            temperatures: VecDeque::new(),
            charge_c: 0.0,
            current: None,
            read_s: None,
            temperature_s: f64::NEG_INFINITY,
            voltage: Last::default(),
            amps: Last::default(),
            temperature: Last::default(),
        }
    }

    /// A step begins at `machine_s`.
    pub fn begin(&mut self, allowance: Allowance, machine_s: f64) {
        if !allowance.continues {
            (self.charge_c, self.current) = (0.0, None);
            (self.voltage, self.amps, self.temperature) = (Last::default(), Last::default(), Last::default());
            // What was not read while nothing flowed is not late.
            self.read_s = Some(machine_s);
            self.temperature_s = self.temperature_s.max(machine_s);
        }
        if allowance.swing_s != self.allowance.swing_s {
            // What stood still under another current stood still rightly.
            (self.voltage.time_s, self.amps.time_s) = (None, None);
        }
        if allowance.tempering != self.allowance.tempering {
            self.temperatures.clear();
        }
        self.allowance = allowance;
    }

    /// Something else is in the jig: what was seen before says nothing of it.
    pub fn forget(&mut self) {
        self.temperatures.clear();
        (self.voltage, self.amps, self.temperature) = (Last::default(), Last::default(), Last::default());
    }

    /// Limits of each reading of the step in work.
    pub fn limits(&self) -> &Limits {
        &self.allowance.limits
    }

    /// The temperature is half as old as it may be.
    pub fn wants_temperature(&self, machine_s: f64) -> bool {
        self.allowance.live && machine_s - self.temperature_s > 0.5 * self.settings.temperature_age_s
    }

    /// Judges a reading that came at `machine_s`.
    pub fn judge(&mut self, reading: &Reading, machine_s: f64) -> Option<Trip> {
        let late = self.late(reading, machine_s);
        self.count_charge(reading);
        judge(&self.allowance.limits, reading)
            .or(late)
            .or_else(|| self.rate(reading))
            .or_else(|| self.charge(reading.time_s))
            .or_else(|| self.frozen(reading))
    }

    /// Judges what the chiller says that was started.
    pub fn chiller(&self, status: &chiller::Status, time_s: f64) -> Option<Trip> {
        (!status.running || status.alarm.is_some()).then(|| Trip::Chiller { said: status.raw.clone(), time_s })
    }

    fn late(&mut self, reading: &Reading, machine_s: f64) -> Option<Trip> {
        let since_s = self.read_s.replace(machine_s).map_or(0.0, |read_s| machine_s - read_s);
        // Nobody saw what came before the reading that ends a gap.
        let age_s = if self.logger { machine_s - self.temperature_s } else { 0.0 };
        if reading.temperature_c.is_some() {
            self.temperature_s = machine_s;
        }
        let limit = |what, value, greatest| {
            (self.allowance.live && value > greatest).then_some(Trip::Limit {
                what,
                value,
                unit: "s",
                least: 0.0,
                greatest,
                time_s: reading.time_s,
            })
        };
        limit("time without a reading", since_s, self.settings.reading_age_s)
            .or_else(|| limit("time without a cell temperature", age_s, self.settings.temperature_age_s))
    }

    /// The trapezoidal rule.
    fn count_charge(&mut self, reading: &Reading) {
        let Some(current_a) = reading.current_a else { return };
        if let Some((before_s, before_a)) = self.current.replace((reading.time_s, current_a)) {
            self.charge_c += 0.5 * (before_a + current_a) * (reading.time_s - before_s);
        }
    }

    /// Least-squares slope over the window.
    fn rate(&mut self, reading: &Reading) -> Option<Trip> {
        let (window_s, greatest) = (self.settings.window_s, 60.0 * self.settings.rate_k_per_s);
        let new = (reading.time_s, reading.temperature_c?);
        self.temperatures.push_back(new);
        while self.temperatures.front().is_some_and(|(time_s, _)| new.0 - time_s > window_s) {
            self.temperatures.pop_front();
        }
        let span_s = new.0 - self.temperatures.front().map_or(new.0, |(time_s, _)| *time_s);
        if self.allowance.tempering || self.temperatures.len() < RATE.0 || span_s < RATE.1 * window_s {
            return None;
        }
        let value = 60.0 * slope(&self.temperatures);
        (!(-greatest..=greatest).contains(&value)).then_some(Trip::Limit {
            what: "rate of the cell temperature",
            value,
            unit: "K/min",
            least: -greatest,
            greatest,
            time_s: reading.time_s,
        })
    }

    fn charge(&self, time_s: f64) -> Option<Trip> {
        let (value, (least, greatest)) = (self.charge_c, self.allowance.charge_c);
        let outside = self.allowance.live && !(least..=greatest).contains(&value);
        outside.then_some(Trip::Limit { what: "net charge of the step", value, unit: "C", least, greatest, time_s })
    }

    fn frozen(&mut self, reading: &Reading) -> Option<Trip> {
        let (now, settings) = ((self.charge_c, reading.time_s), self.settings);
        let volts = reading.voltage_v.map(|volts| self.voltage.since(volts, now));
        let amps = reading.current_a.map(|amps| self.amps.since(amps, now));
        let celsius = reading.temperature_c.map(|celsius| self.temperature.since(celsius, now));
        if !self.allowance.live {
            return None;
        }
        let held = reading.voltage_v.is_some_and(|volts| volts >= self.allowance.held_v);
        let cell = |since: Option<(f64, f64)>| since.filter(|_| self.allowance.cell);
        let charge = |since: Option<(f64, f64)>| Some((cell(since)?.0, settings.frozen_c, "C"));
        let time = |since: Option<(f64, f64)>| Some((since?.1, settings.frozen_s.max(SWINGS * self.allowance.swing_s?), "s"));
        let stood = [
            ("charge while the cell voltage stood still", charge(volts.filter(|_| !held))),
            ("charge while the cell temperature stood still", charge(celsius)),
            ("time in which the cell voltage stood still under a sinusoid", time(cell(volts))),
            ("time in which the cell current stood still under a sinusoid", time(amps)),
        ];
        let frozen = stood.into_iter().find_map(|(what, found)| Some((what, found.filter(|(value, greatest, _)| value > greatest)?)));
        frozen.map(|(what, (value, greatest, unit))| Trip::Limit { what, value, unit, least: 0.0, greatest, time_s: reading.time_s })
    }
}

/// Least-squares slope of (time, value).
fn slope(points: &VecDeque<(f64, f64)>) -> f64 {
    let count = points.len() as f64;
    let (mean_t, mean_v) = points.iter().fold((0.0, 0.0), |(t, v), point| (t + point.0 / count, v + point.1 / count));
    let (covariance, variance) =
        points.iter().fold((0.0, 0.0), |(c, s), (t, v)| (c + (t - mean_t) * (v - mean_v), s + (t - mean_t).powi(2)));
    covariance / variance
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { min_v: 2.5, max_v: 4.2, charge_a: 13.5, discharge_a: 45.0, min_c: 0.0, max_c: 60.0 };
    const SETTINGS: Settings = Settings {
        rate_k_per_s: 5.0 / 60.0,
        window_s: 60.0,
        charge_c: 1000.0,
        drift_c: 100.0,
        reading_age_s: 15.0,
        temperature_age_s: 60.0,
        frozen_c: 50.0,
        frozen_s: 30.0,
    };

    fn live(charge_c: (f64, f64)) -> Interlock {
        let mut interlock = Interlock::new(SETTINGS, LIMITS, true);
        interlock.begin(Allowance { live: true, charge_c, ..Allowance::idle(LIMITS) }, 0.0);
        interlock
    }

    /// Plays readings until one trips; says which and at what bench time.
    fn play(interlock: &mut Interlock, readings: impl Iterator<Item = Reading>) -> Option<(String, f64)> {
        readings.into_iter().find_map(|reading| {
            let trip = interlock.judge(&reading, reading.time_s)?;
            Some((trip.to_string(), reading.time_s))
        })
    }

    /// A reading a second: volts, amperes and degrees over time, s.
    fn course(seconds: u32, of: impl Fn(f64) -> (f64, f64, Option<f64>)) -> impl Iterator<Item = Reading> {
        (1..=seconds).map(f64::from).map(move |time_s| {
            let (volts, amps, temperature_c) = of(time_s);
            Reading { time_s, voltage_v: Some(volts), current_a: Some(amps), temperature_c }
        })
    }

    const FREE: (f64, f64) = (f64::NEG_INFINITY, f64::INFINITY);

    /// Voltage, current and temperature over time.
    type Course = Box<dyn Fn(f64) -> (f64, f64, Option<f64>)>;

    #[test]
    fn a_sound_discharge_trips_nothing_and_each_fault_trips_its_own() {
        let sound = |t: f64| (4.0 - 1.0e-4 * t, -5.0, Some(25.0 + 0.02 * t));
        assert_eq!(play(&mut live((-1000.0, 10.0)), course(180, sound)), None);
        let cases: [(&str, Course, f64); 7] = [
            ("net charge of the step -1002", Box::new(|t| (4.0 - 1.0e-4 * t, -6.0, Some(25.0 + 0.01 * t))), 168.0),
            ("net charge of the step 1", Box::new(|t| (4.0 + 1.0e-4 * t, 1.0, Some(25.0 + 0.01 * t))), 12.0),
            ("charge while the cell voltage stood still 55", Box::new(|t| (4.0, -5.0, Some(25.0 + 0.01 * t))), 12.0),
            ("charge while the cell temperature stood still 55", Box::new(|t| (4.0 - 1.0e-4 * t, -5.0, Some(25.0))), 12.0),
            ("rate of the cell temperature 6.0000 K/min", Box::new(|t| (4.0 - 1.0e-4 * t, -5.0, Some(25.0 + 0.1 * t))), 31.0),
            ("rate of the cell temperature -6.0000 K/min", Box::new(|t| (4.0 - 1.0e-4 * t, -5.0, Some(25.0 - 0.1 * t))), 31.0),
            ("time without a cell temperature 61.0000 s", Box::new(|t| (4.0 - 1.0e-4 * t, -5.0, None)), 61.0),
        ];
        for (text, of, at_s) in cases {
            let tripped = play(&mut live((-1000.0, 10.0)), course(300, of));
            assert!(tripped.as_ref().is_some_and(|(found, time_s)| found.starts_with(text) && *time_s == at_s), "{text}: {tripped:?}");
        }
    }

    #[test]
    fn a_reading_that_comes_late_trips_only_while_current_may_flow() {
        let reading = |time_s| Reading { time_s, voltage_v: Some(3.7), temperature_c: Some(25.0), ..Reading::default() };
        let mut interlock = live(FREE);
        assert_eq!(interlock.judge(&reading(1.0), 1.0), None);
        let trip = interlock.judge(&reading(20.0), 20.0).map(|trip| trip.to_string()).unwrap_or_default();
        assert!(trip.starts_with("time without a reading 19.0000 s left its limits (0 s to 15 s)"), "{trip}");
        let mut resting = Interlock::new(SETTINGS, LIMITS, true);
        resting.begin(Allowance::idle(LIMITS), 0.0);
        assert_eq!((resting.judge(&reading(1.0), 1.0), resting.judge(&reading(500.0), 500.0)), (None, None));
        // What was not read at rest is not late when the step begins, and late when it still is not read.
        resting.begin(Allowance { live: true, ..Allowance::idle(LIMITS) }, 900.0);
        assert_eq!(resting.judge(&reading(901.0), 901.0), None);
        assert!(resting.judge(&reading(950.0), 950.0).is_some());
    }

    #[test]
    fn a_bench_without_a_logger_is_not_asked_for_a_temperature() {
        let mut interlock = Interlock::new(SETTINGS, LIMITS, false);
        interlock.begin(Allowance { live: true, charge_c: FREE, ..Allowance::idle(LIMITS) }, 0.0);
        assert_eq!(play(&mut interlock, course(200, |t| (4.0 - 1.0e-4 * t, 0.0, None))), None);
    }

    #[test]
    fn a_supply_that_holds_the_voltage_may_hold_it_and_a_step_that_goes_on_counts_on() {
        let mut interlock = Interlock::new(SETTINGS, LIMITS, false);
        let holding = Allowance { live: true, held_v: 4.1, ..Allowance::idle(LIMITS) };
        interlock.begin(holding, 0.0);
        assert_eq!(play(&mut interlock, course(200, |_| (4.15, 3.0, None))), None);
        interlock.begin(Allowance { continues: true, charge_c: (-10.0, 590.0), held_v: 0.0, ..holding }, 200.0);
        let reading = Reading { time_s: 201.0, voltage_v: Some(4.15), current_a: Some(3.0), ..Reading::default() };
        assert!(interlock.judge(&reading, 201.0).is_some_and(|trip| trip.to_string().starts_with("net charge of the step 600")));
    }

    #[test]
    fn a_meter_that_stands_still_under_a_slow_sinusoid_trips_and_a_coarse_one_at_rest_does_not() {
        let swinging = |period_s| {
            let mut interlock = Interlock::new(SETTINGS, LIMITS, false);
            interlock.begin(Allowance { live: true, charge_c: FREE, swing_s: period_s, ..Allowance::idle(LIMITS) }, 0.0);
            interlock
        };
        let phase = |t: f64| (std::f64::consts::TAU * t / 10.0).sin();
        // Whole millivolts and tenths of an ampere.
        let volts = move |t: f64| (1000.0 * (3.8 + 0.009 * phase(t))).round() / 1000.0;
        let amps = move |t: f64| (10.0 * phase(t)).round() / 10.0;
        let cases: [(Option<f64>, Course, Option<(&str, f64)>); 6] = [
            (Some(10.0), Box::new(move |t| (volts(t), amps(t), None)), None),
            (
                Some(10.0),
                Box::new(move |t| (3.8, amps(t), None)),
                Some(("time in which the cell voltage stood still under a sinusoid 31", 32.0)),
            ),
            (
                Some(10.0),
                Box::new(move |t| (volts(t), 0.3, None)),
                Some(("time in which the cell current stood still under a sinusoid 31", 32.0)),
            ),
            // Two periods at least.
            (
                Some(20.0),
                Box::new(move |t| (3.8, amps(t), None)),
                Some(("time in which the cell voltage stood still under a sinusoid 41", 42.0)),
            ),
            // A fast sinusoid is averaged away, and at rest nothing moves.
            (None, Box::new(|_| (3.8, 0.0, None)), None),
            (None, Box::new(|_| (3.8, 0.1, None)), None),
        ];
        for (period_s, of, expected) in cases {
            let tripped = play(&mut swinging(period_s), course(300, of));
            let right = match (&tripped, expected) {
                (Some((found, time_s)), Some((text, at_s))) => found.starts_with(text) && *time_s == at_s,
                (found, expected) => found.is_none() && expected.is_none(),
            };
            assert!(right, "{expected:?}: {tripped:?}");
        }
        // What stood still under the fast sinusoid before is not held against the slow one.
        let mut interlock = swinging(None);
        assert_eq!(play(&mut interlock, course(100, |_| (3.8, 0.0, None))), None);
        interlock.begin(Allowance { continues: true, ..Allowance { live: true, swing_s: Some(10.0), ..Allowance::idle(LIMITS) } }, 100.0);
        let later = (101..=300).map(f64::from).map(|t| Reading {
            time_s: t,
            voltage_v: Some(volts(t)),
            current_a: Some(amps(t)),
            ..Reading::default()
        });
        assert_eq!(play(&mut interlock, later), None);
        // Copper has no voltage to speak of: its current alone is looked at.
        let mut copper = swinging(None);
        copper.begin(Allowance { live: true, swing_s: Some(10.0), cell: false, ..Allowance::idle(LIMITS.of_control()) }, 0.0);
        assert_eq!(play(&mut copper, course(100, move |t| (0.0, amps(t), None))), None);
    }

    #[test]
    fn a_gap_in_the_temperatures_trips_even_when_it_ends() {
        let mut interlock = live(FREE);
        let reading =
            |time_s: f64, temperature_c| Reading { time_s, voltage_v: Some(3.8 - 1.0e-4 * time_s), temperature_c, ..Reading::default() };
        for time_s in 1..=6 {
            assert_eq!(interlock.judge(&reading(10.0 * f64::from(time_s), None), 10.0 * f64::from(time_s)), None);
        }
        let trip = interlock.judge(&reading(61.0, Some(25.0)), 61.0).map(|trip| trip.to_string()).unwrap_or_default();
        assert!(trip.starts_with("time without a cell temperature 61.0000 s left its limits (0 s to 60 s)"), "{trip}");
    }

    #[test]
    fn a_temperature_that_is_meant_to_change_may_change() {
        let mut interlock = Interlock::new(SETTINGS, LIMITS, true);
        interlock.begin(Allowance { tempering: true, ..Allowance::idle(LIMITS) }, 0.0);
        assert_eq!(play(&mut interlock, course(120, |t| (3.7, 0.0, Some(20.0 + 0.2 * t)))), None);
    }

    #[test]
    fn a_chiller_that_stopped_or_has_an_alarm_trips() {
        let interlock = live(FREE);
        let said = |running, alarm: bool| chiller::Status {
            running,
            remote: true,
            alarm: alarm.then(|| "-01 LOW LEVEL ALARM".to_owned()),
            raw: "02 REMOTE STOP".to_owned(),
        };
        assert_eq!(interlock.chiller(&said(true, false), 7.0), None);
        for status in [said(false, false), said(true, true)] {
            let trip = interlock.chiller(&status, 7.0).map(|trip| trip.to_string());
            assert_eq!(trip.as_deref(), Some("chiller: expected it to run without an alarm, found `02 REMOTE STOP` at 7.0 s"));
        }
    }
}
