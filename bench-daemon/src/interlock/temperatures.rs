//! Rate of the cell's temperature.

use std::collections::VecDeque;

use super::{
    allowance::Settings,
    limits::{Reading, Trip},
};

/// Fewest temperatures, and least share of the window, that make a rate.
const RATE: (usize, f64) = (3, 0.5);

/// Temperatures within the window, °C, behind their bench times, s.
#[derive(Debug, Default)]
pub(super) struct Temperatures(VecDeque<(f64, f64)>);

impl Temperatures {
    /// Drops what was read so far: it says nothing of what comes.
    pub(super) fn forget(&mut self) {
        self.0.clear();
    }

    /// Takes a reading, and judges the least-squares slope over the window, unless the temperature
    /// is to change.
    pub(super) fn judge(
        &mut self,
        reading: &Reading,
        tempering: bool,
        settings: &Settings,
    ) -> Option<Trip> {
        let (window_s, greatest) = (settings.window_s, 60.0 * settings.rate_k_per_s);
        let new = (reading.time_s, reading.temperature_c?);
        self.0.push_back(new);
        while self
            .0
            .front()
            .is_some_and(|(time_s, _)| new.0 - time_s > window_s)
        {
            self.0.pop_front();
        }
        let span_s = new.0 - self.0.front().map_or(new.0, |(time_s, _)| *time_s);
        if tempering || self.0.len() < RATE.0 || span_s < RATE.1 * window_s {
            return None;
        }
        let value = 60.0 * slope(&self.0);
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
