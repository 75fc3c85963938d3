//! The rate of the cell's temperature, and the judges of bath and thermometers.

use std::collections::VecDeque;

use instruments::units::{Celsius, KelvinsPerSecond, Seconds};

use super::{
    allowance::Settings,
    bath::{BathJudge, BathReading},
    limits::{Limits, Reading, Trip},
    thermometers::{ThermometerJudge, ThermometerReadings},
};

/// Least number of temperatures, and least share of the window, that define a rate.
const RATE: (usize, f64) = (3, 0.5);

/// The temperatures of cell, air and bath.
#[derive(Debug)]
pub(super) struct Temperatures {
    /// Temperatures of the cell within the window: bench time, s, and value, °C.
    window: VecDeque<(Seconds, Celsius)>,
    bath: BathJudge,
    thermometers: ThermometerJudge,
}

impl Temperatures {
    /// Creates the state before the first reading.
    pub(super) fn new(settings: &Settings, limits: &Limits) -> Self {
        Self {
            window: VecDeque::new(),
            bath: BathJudge::watching(Some((limits.min_degc, limits.max_degc))),
            thermometers: ThermometerJudge::new(settings.capacity_coulomb),
        }
    }

    /// Drops the history after a change of the object in the jig.
    pub(super) fn change_fixture(&mut self) {
        self.forget();
        self.thermometers.forget();
    }

    /// Accepts a reading of voltage and current, from which the heat in the cell follows.
    pub(super) fn take_reading(&mut self, reading: &Reading) {
        if let Some(volts) = reading.voltage_v {
            let amps = reading.current_a.unwrap_or_default();
            self.thermometers.take_power(volts, amps, reading.time_s);
        }
    }

    /// Judges a reading of the bath's own sensor.
    pub(super) fn judge_bath(&mut self, reading: BathReading, time_s: Seconds) -> Option<Trip> {
        let fault = self.bath.judge(reading, time_s)?;
        Some(Trip::Bath { fault, time_s })
    }

    /// Judges a reading of all thermometers; `cell` is false while a control is in the jig.
    pub(super) fn judge_thermometers(
        &mut self,
        readings: ThermometerReadings,
        cell: bool,
        time_s: Seconds,
    ) -> Option<Trip> {
        let fault = self.thermometers.judge(readings, cell, time_s)?;
        Some(Trip::Thermometer { fault, time_s })
    }

    /// Drops earlier readings, which do not apply to later ones.
    pub(super) fn forget(&mut self) {
        self.window.clear();
    }

    /// Accepts a reading, and judges the least-squares slope over the window, unless the
    /// temperature is to change.
    pub(super) fn judge(
        &mut self,
        reading: &Reading,
        tempering: bool,
        settings: &Settings,
    ) -> Option<Trip> {
        let (window_s, greatest) = (settings.window_s, 60.0 * settings.rate_k_per_s.value());
        let new = (reading.time_s, reading.temperature_degc?);
        self.window.push_back(new);
        while self
            .window
            .front()
            .is_some_and(|(time_s, _)| new.0 - *time_s > window_s)
        {
            self.window.pop_front();
        }
        let span_s = new.0 - self.window.front().map_or(new.0, |(time_s, _)| *time_s);
        if tempering || self.window.len() < RATE.0 || span_s < RATE.1 * window_s {
            return None;
        }
        let value = 60.0 * slope(&self.window).value();
        (!(-greatest..=greatest).contains(&value)).then_some(Trip::Limit {
            what: "rate of the cell temperature",
            value,
            unit: "K/min",
            least: -greatest,
            greatest,
            time_s: reading.time_s,
        })
    }
}

/// Returns the least-squares slope of (time, value).
fn slope(points: &VecDeque<(Seconds, Celsius)>) -> KelvinsPerSecond {
    let count = points.len() as f64;
    let numbers = || points.iter().map(|(t, v)| (t.value(), v.value()));
    let (mean_t, mean_v) = numbers().fold((0.0, 0.0), |(t, v), point| {
        (t + point.0 / count, v + point.1 / count)
    });
    let (covariance, variance) = numbers().fold((0.0, 0.0), |(c, s), (t, v)| {
        (c + (t - mean_t) * (v - mean_v), s + (t - mean_t).powi(2))
    });
    KelvinsPerSecond(covariance / variance)
}
