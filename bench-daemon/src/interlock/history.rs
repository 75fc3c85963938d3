//! Checks that need several readings: the rate of the temperature, the charge that has moved,
//! readings that are late or missing, values that do not move.

use std::collections::VecDeque;

use instruments::chiller;

use super::{Limits, NET_CHARGE, NO_CURRENT_A, Reading, Trip, judge, noise::Noise};

/// Settings of the interlock beside the limits of the cell.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Greatest rate of the surface temperature, rising or falling, K/s.
    pub rate_k_per_s: f64,
    /// Time over which the rate is taken, s.
    pub window_s: f64,
    /// Greatest charge that one discharge or charge may move, C.
    pub charge_c: f64,
    /// How far the charge may be from what a step without a net charge, or with a known one, should
    /// have moved, C.
    pub drift_c: f64,
    /// Greatest time between two readings while current may flow, seconds of the machine.
    pub reading_age_s: f64,
    /// The same for the temperature, on a bench with a logger.
    pub temperature_age_s: f64,
    /// A value that stays the same to the last digit while so much charge passes is frozen, C.
    pub frozen_c: f64,
    /// The same for a voltage and a current that a slow sinusoid moves, s; at least two of its
    /// periods.
    pub frozen_s: f64,
}

/// The mean of a periodic current.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mean {
    /// Its period, s.
    pub period_s: f64,
    /// Greatest magnitude of the mean over a period, A.
    pub greatest_a: f64,
    /// Amplitude of the sinusoid, A; none for a current of several.
    pub amplitude_a: Option<f64>,
}

impl Mean {
    /// Readings a second apart are enough for a mean over one period.
    fn followed(&self) -> bool {
        self.period_s >= FOLLOWED_S
    }

    /// Half of the period, where two readings that far apart tell the mean: slower ones are
    /// followed reading by reading, and a faster one goes on too far while a reading is under way.
    pub fn pair_s(&self) -> Option<f64> {
        (!self.followed() && self.period_s >= PAIR_S && self.amplitude_a.is_some())
            .then_some(0.5 * self.period_s)
    }

    /// Between two readings while the current is followed, s: often enough for a mean of each
    /// period.
    pub fn poll_s(&self) -> f64 {
        if self.followed() {
            self.period_s / POLLS
        } else {
            f64::INFINITY
        }
    }

    /// Judges a mean.
    pub fn judge(&self, value: f64, time_s: f64) -> Option<Trip> {
        self.judge_pair(value, 0.0, time_s)
    }

    /// Judges the mean of two readings that are half a period apart, but for `unsure_s`: by so much
    /// of the amplitude it may be off, A·sin(π·f·unsure).
    pub fn judge_pair(&self, value: f64, unsure_s: f64, time_s: f64) -> Option<Trip> {
        let phase =
            (std::f64::consts::PI * unsure_s / self.period_s).min(std::f64::consts::FRAC_PI_2);
        let greatest = self.greatest_a + self.amplitude_a.unwrap_or(0.0) * phase.sin();
        let what = "mean of the cell current";
        (!(-greatest..=greatest).contains(&value)).then_some(Trip::Limit {
            what,
            value,
            unit: "A",
            least: -greatest,
            greatest,
            time_s,
        })
    }
}

/// Fewest readings in a period that give its mean.
const FEWEST: f64 = 4.0;
/// Shortest period over which readings somewhat more than a second apart give a mean, s.
const FOLLOWED_S: f64 = 5.0;
/// Readings in a period that are aimed at, where it is followed: their own time taken, [`FEWEST`]
/// come.
const POLLS: f64 = 8.0;
/// Shortest period of which two readings half of it apart give the mean, s. A record of a faster
/// one is there 2 s after its beginning; 20 ms by which a reading comes late add 0.6 of the
/// amplitude to the limit there.
const PAIR_S: f64 = 0.1;

/// Allowance of the step in work.
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
    /// The period of a sinusoid that is slow enough to be followed reading by reading, s: current
    /// and, of a cell, voltage must move with it.
    pub swing_s: Option<f64>,
    /// Allowed mean of the current.
    pub mean: Option<Mean>,
    /// The cell is in the jig: its voltage moves with the charge.
    pub cell: bool,
    /// The chiller is to change the temperature: its rate is not judged.
    pub tempering: bool,
}

impl Allowance {
    /// Nothing may flow.
    pub fn idle(limits: Limits) -> Self {
        let charge_c = (f64::NEG_INFINITY, f64::INFINITY);
        let held_v = f64::INFINITY;
        Self {
            limits,
            live: false,
            continues: false,
            charge_c,
            held_v,
            swing_s: None,
            mean: None,
            cell: true,
            tempering: false,
        }
    }
}

/// Charge and time: at a moment, or passed since then.
#[derive(Debug, Clone, Copy)]
struct Passed {
    charge_c: f64,
    time_s: f64,
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
    /// Charge and time that have passed since the value changed.
    fn since(&mut self, value: f64, now: Passed) -> Passed {
        if self.value != Some(value) {
            *self = Self {
                value: Some(value),
                charge_c: now.charge_c,
                time_s: None,
            };
        }
        Passed {
            charge_c: (now.charge_c - self.charge_c).abs(),
            time_s: now.time_s - *self.time_s.get_or_insert(now.time_s),
        }
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
    /// Reading of the ammeter while no current flows, A.
    zero_a: f64,
    /// Current that was read last, with its bench time, s.
    current: Option<(f64, f64)>,
    /// Bench times, s, and currents, A, of one period of the sinusoid in work.
    period: VecDeque<(f64, f64)>,
    /// When something was read last, and when the temperature was, seconds of the machine.
    read_s: Option<f64>,
    temperature_s: f64,
    voltage: Last,
    amps: Last,
    temperature: Last,
    silent: bool,
    noise: Noises,
}

/// Known noise of each meter. That of voltage and current holds for the step in work, because their
/// ranges change from step to step.
#[derive(Debug, Default)]
struct Noises {
    volts: Noise,
    amps: Noise,
    celsius: Noise,
}

/// A meter that shows the same for longer than its noise allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stuck {
    /// Quantity that it measures.
    pub quantity: Quantity,
    /// How often it was read alike.
    pub times: u32,
    /// Value that it shows, in V, A or °C.
    pub value: f64,
}

/// Quantity that a meter measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// The cell's voltage.
    Voltage,
    /// The cell's current.
    Current,
    /// The cell's temperature.
    Temperature,
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
            zero_a: 0.0,
            current: None,
            period: VecDeque::new(),
            read_s: None,
            temperature_s: f64::NEG_INFINITY,
            voltage: Last::default(),
            amps: Last::default(),
            temperature: Last::default(),
            silent: false,
            noise: Noises::default(),
        }
    }

    /// A meter that shows the same for longer than its noise allows.
    pub fn stuck(&self) -> Option<Stuck> {
        let of = |quantity, noise: &Noise, last: &Last| {
            Some(Stuck {
                quantity,
                times: noise.stuck()?,
                value: last.value?,
            })
        };
        of(
            Quantity::Temperature,
            &self.noise.celsius,
            &self.temperature,
        )
        .or_else(|| of(Quantity::Voltage, &self.noise.volts, &self.voltage))
        .or_else(|| of(Quantity::Current, &self.noise.amps, &self.amps))
    }

    /// A step begins at `machine_s`.
    pub fn begin(&mut self, allowance: Allowance, machine_s: f64) {
        if !allowance.continues {
            (self.charge_c, self.zero_a, self.current) = (0.0, 0.0, None);
            (self.voltage, self.amps, self.temperature) =
                (Last::default(), Last::default(), Last::default());
            (self.noise.volts, self.noise.amps) = (Noise::default(), Noise::default());
            // What was not read while nothing flowed is not late.
            self.read_s = Some(machine_s);
            self.temperature_s = self.temperature_s.max(machine_s);
        }
        if allowance.mean != self.allowance.mean || !allowance.continues {
            self.period.clear();
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

    /// Whether the signal of the step has ended by itself: nothing moves any more then, and the
    /// last period is no whole one.
    pub fn silent(&mut self, silent: bool) {
        if silent != self.silent {
            self.lose_period();
            (self.voltage.time_s, self.amps.time_s) = (None, None);
        }
        self.silent = silent;
    }

    /// Drops the readings of the period so far, because they are not of one signal or not of known
    /// times.
    pub fn lose_period(&mut self) {
        self.period.clear();
    }

    /// Something else is in the jig: what was seen before says nothing of it.
    pub fn forget(&mut self) {
        self.temperatures.clear();
        (self.voltage, self.amps, self.temperature) =
            (Last::default(), Last::default(), Last::default());
        self.noise = Noises::default();
    }

    /// Limits of each reading of the step in work.
    pub fn limits(&self) -> &Limits {
        &self.allowance.limits
    }

    /// The temperature is half as old as it may be.
    pub fn wants_temperature(&self, machine_s: f64) -> bool {
        let old = machine_s - self.temperature_s > 0.5 * self.settings.temperature_age_s;
        self.allowance.live && (old || self.noise.celsius.suspect())
    }

    /// Judges a reading that came at `machine_s`.
    pub fn judge(&mut self, reading: &Reading, machine_s: f64) -> Option<Trip> {
        self.listen(reading);
        let late = self.late(reading, machine_s);
        self.count_charge(reading);
        judge(&self.allowance.limits, reading)
            .or(late)
            .or_else(|| self.rate(reading))
            .or_else(|| self.mean(reading))
            .or_else(|| self.charge(reading.time_s))
            .or_else(|| self.frozen(reading))
    }

    /// Under a sinusoid readings turn back without any noise.
    fn listen(&mut self, reading: &Reading) {
        if let Some(celsius) = reading.temperature_c {
            self.noise.celsius.take(celsius);
        }
        if self.allowance.mean.is_some() || self.allowance.swing_s.is_some() {
            return;
        }
        // A supply that holds the voltage may hold it better than the meter shows.
        if let Some(volts) = reading
            .voltage_v
            .filter(|volts| *volts < self.allowance.held_v)
        {
            self.noise.volts.take(volts);
        }
        if let Some(amps) = reading.current_a.filter(|_| self.allowance.live) {
            self.noise.amps.take(amps);
        }
    }

    /// Judges what the chiller says that was started.
    pub fn chiller(&self, status: &chiller::Status, time_s: f64) -> Option<Trip> {
        (!status.running || status.alarm.is_some()).then(|| Trip::Chiller {
            message: status.raw.clone(),
            time_s,
        })
    }

    fn late(&mut self, reading: &Reading, machine_s: f64) -> Option<Trip> {
        let since_s = self
            .read_s
            .replace(machine_s)
            .map_or(0.0, |read_s| machine_s - read_s);
        // Nobody saw what came before the reading that ends a gap.
        let age_s = if self.logger {
            machine_s - self.temperature_s
        } else {
            0.0
        };
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
        limit(
            "time without a reading",
            since_s,
            self.settings.reading_age_s,
        )
        .or_else(|| {
            limit(
                "time without a cell temperature",
                age_s,
                self.settings.temperature_age_s,
            )
        })
    }

    /// Sets the reading of the ammeter with the output off, A: that is no charge. A reading beyond
    /// a zero error is taken as 0.
    pub fn zero(&mut self, zero_a: f64) {
        self.zero_a = if zero_a.abs() <= NO_CURRENT_A {
            zero_a
        } else {
            0.0
        };
    }

    /// The trapezoidal rule.
    fn count_charge(&mut self, reading: &Reading) {
        let Some(current_a) = reading.current_a else {
            return;
        };
        if let Some((before_s, before_a)) = self.current.replace((reading.time_s, current_a)) {
            self.charge_c +=
                (0.5 * (before_a + current_a) - self.zero_a) * (reading.time_s - before_s);
        }
    }

    /// Least-squares slope over the window.
    fn rate(&mut self, reading: &Reading) -> Option<Trip> {
        let (window_s, greatest) = (self.settings.window_s, 60.0 * self.settings.rate_k_per_s);
        let new = (reading.time_s, reading.temperature_c?);
        self.temperatures.push_back(new);
        while self
            .temperatures
            .front()
            .is_some_and(|(time_s, _)| new.0 - time_s > window_s)
        {
            self.temperatures.pop_front();
        }
        let span_s = new.0
            - self
                .temperatures
                .front()
                .map_or(new.0, |(time_s, _)| *time_s);
        if self.allowance.tempering
            || self.temperatures.len() < RATE.0
            || span_s < RATE.1 * window_s
        {
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

    /// The mean over the last period, by the trapezoidal rule, as soon as a whole one was read.
    fn mean(&mut self, reading: &Reading) -> Option<Trip> {
        let mean = self
            .allowance
            .mean
            .filter(|mean| mean.followed() && !self.silent)?;
        self.period.push_back((reading.time_s, reading.current_a?));
        let from_s = reading.time_s - mean.period_s;
        while self
            .period
            .get(1)
            .is_some_and(|(time_s, _)| *time_s <= from_s)
        {
            self.period.pop_front();
        }
        mean.judge(self.over_period(&mean, |amps| amps)?, reading.time_s)
    }

    /// The mean of something of the current over the last period, as soon as a whole one was read.
    fn over_period(&self, mean: &Mean, of: fn(f64) -> f64) -> Option<f64> {
        let pairs = || self.period.iter().zip(self.period.iter().skip(1));
        let from_s = self.period.back()?.0 - mean.period_s;
        // What came too seldom says nothing of a mean.
        let apart_s = pairs()
            .map(|(one, other)| other.0 - one.0)
            .fold(0.0, f64::max);
        if self
            .period
            .front()
            .is_none_or(|(time_s, _)| *time_s > from_s)
            || apart_s > mean.period_s / FEWEST
        {
            return None;
        }
        let part = |((t0, a0), (t1, a1)): (&(f64, f64), &(f64, f64))| {
            // The first pair begins before the period does.
            let start_s = t0.max(from_s);
            let start_a = a0 + (a1 - a0) * (start_s - t0) / (t1 - t0);
            0.5 * (of(start_a) + of(*a1)) * (t1 - start_s)
        };
        Some(pairs().map(part).sum::<f64>() / mean.period_s)
    }

    /// The effective current over the last period, A, where readings follow it.
    pub fn effective_a(&self) -> Option<f64> {
        let mean = self.allowed_mean().filter(Mean::followed)?;
        self.over_period(&mean, |amps| amps * amps).map(f64::sqrt)
    }

    /// A current may flow.
    pub fn is_live(&self) -> bool {
        self.allowance.live
    }

    /// The temperature is to change.
    pub fn tempering(&self) -> bool {
        self.allowance.tempering
    }

    /// Allowed mean of the current in the step in work; `None` while no reading is to be judged.
    pub fn allowed_mean(&self) -> Option<Mean> {
        self.allowance.mean.filter(|_| !self.silent)
    }

    fn charge(&self, time_s: f64) -> Option<Trip> {
        let (value, (least, greatest)) = (self.charge_c, self.allowance.charge_c);
        let outside = self.allowance.live && !(least..=greatest).contains(&value);
        outside.then_some(Trip::Limit {
            what: NET_CHARGE,
            value,
            unit: "C",
            least,
            greatest,
            time_s,
        })
    }

    fn frozen(&mut self, reading: &Reading) -> Option<Trip> {
        let settings = self.settings;
        let now = Passed {
            charge_c: self.charge_c,
            time_s: reading.time_s,
        };
        let volts = reading
            .voltage_v
            .map(|volts| self.voltage.since(volts, now));
        let amps = reading.current_a.map(|amps| self.amps.since(amps, now));
        let celsius = reading
            .temperature_c
            .map(|celsius| self.temperature.since(celsius, now));
        if !self.allowance.live {
            return None;
        }
        let held = reading
            .voltage_v
            .is_some_and(|volts| volts >= self.allowance.held_v);
        let cell = |since: Option<Passed>| since.filter(|_| self.allowance.cell);
        let charge = |since: Option<Passed>| Some((cell(since)?.charge_c, settings.frozen_c, "C"));
        let swing_s = self.allowance.swing_s.filter(|_| !self.silent);
        let time = |since: Option<Passed>| {
            Some((since?.time_s, settings.frozen_s.max(SWINGS * swing_s?), "s"))
        };
        let stood = [
            (
                "charge while the cell voltage stood still",
                charge(volts.filter(|_| !held)),
            ),
            (
                "charge while the cell temperature stood still",
                charge(celsius),
            ),
            (
                "time in which the cell voltage stood still under a sinusoid",
                time(cell(volts)),
            ),
            (
                "time in which the cell current stood still under a sinusoid",
                time(amps),
            ),
        ];
        let frozen = stood.into_iter().find_map(|(what, found)| {
            Some((what, found.filter(|(value, greatest, _)| value > greatest)?))
        });
        frozen.map(|(what, (value, greatest, unit))| Trip::Limit {
            what,
            value,
            unit,
            least: 0.0,
            greatest,
            time_s: reading.time_s,
        })
    }
}

/// Least-squares slope of (time, value).
fn slope(points: &VecDeque<(f64, f64)>) -> f64 {
    let count = points.len() as f64;
    let (mean_t, mean_v) = points.iter().fold((0.0, 0.0), |(t, v), point| {
        (t + point.0 / count, v + point.1 / count)
    });
    let (covariance, variance) = points.iter().fold((0.0, 0.0), |(c, s), (t, v)| {
        (c + (t - mean_t) * (v - mean_v), s + (t - mean_t).powi(2))
    });
    covariance / variance
}

#[cfg(test)]
mod tests;
