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
    /// The cell is in the jig: its voltage moves with the charge.
    pub cell: bool,
    /// The chiller is to change the temperature: its rate is not judged.
    pub tempering: bool,
}

impl Allowance {
    /// Nothing may flow.
    pub fn idle(limits: Limits) -> Self {
        let charge_c = (f64::NEG_INFINITY, f64::INFINITY);
        Self { limits, live: false, continues: false, charge_c, held_v: f64::INFINITY, cell: true, tempering: false }
    }
}

/// A value, and the charge at which it was seen to change last.
#[derive(Debug, Clone, Copy, Default)]
struct Last {
    value: Option<f64>,
    charge_c: f64,
}

impl Last {
    /// Charge that has passed since the value changed, C.
    fn since_c(&mut self, value: f64, charge_c: f64) -> f64 {
        if self.value != Some(value) {
            *self = Self { value: Some(value), charge_c };
        }
        (charge_c - self.charge_c).abs()
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
    temperature: Last,
}

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
            temperature: Last::default(),
        }
    }

    /// A step begins at `machine_s`.
    pub fn begin(&mut self, allowance: Allowance, machine_s: f64) {
        if !allowance.continues {
            (self.charge_c, self.current) = (0.0, None);
            (self.voltage, self.temperature) = (Last::default(), Last::default());
            // What was not read while nothing flowed is not late.
            self.read_s = Some(machine_s);
            self.temperature_s = self.temperature_s.max(machine_s);
        }
        if allowance.tempering != self.allowance.tempering {
            self.temperatures.clear();
        }
        self.allowance = allowance;
    }

    /// Something else is in the jig: what was seen before says nothing of it.
    pub fn forget(&mut self) {
        self.temperatures.clear();
        (self.voltage, self.temperature) = (Last::default(), Last::default());
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
        limit("time without a reading", since_s, self.settings.reading_age_s).or_else(|| {
            let age_s = if self.logger { machine_s - self.temperature_s } else { 0.0 };
            limit("time without a cell temperature", age_s, self.settings.temperature_age_s)
        })
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
        let (charge_c, greatest) = (self.charge_c, self.settings.frozen_c);
        let volts = reading.voltage_v.filter(|volts| *volts < self.allowance.held_v);
        let stale_c = [
            ("charge while the cell voltage stood still", volts.map(|volts| self.voltage.since_c(volts, charge_c))),
            ("charge while the cell temperature stood still", reading.temperature_c.map(|c| self.temperature.since_c(c, charge_c))),
        ];
        let frozen = stale_c.into_iter().find_map(|(what, since_c)| Some((what, since_c.filter(|c| *c > greatest)?)));
        let (what, value) = frozen.filter(|_| self.allowance.live && self.allowance.cell)?;
        Some(Trip::Limit { what, value, unit: "C", least: 0.0, greatest, time_s: reading.time_s })
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
