//! Readings that are late or missing while a current may flow.

use instruments::units::Seconds;

use super::{
    allowance::Settings,
    limits::{Reading, Trip},
};

/// Times of the last readings, seconds of the machine.
#[derive(Debug)]
pub(super) struct Ages {
    /// Whether there is a thermometer.
    logger: bool,
    /// Time of the last reading of any instrument.
    read_s: Option<Seconds>,
    /// Time of the last temperature.
    temperature_s: Seconds,
}

impl Ages {
    /// Creates the state before the first reading.
    pub(super) fn new(logger: bool) -> Self {
        Self {
            logger,
            read_s: None,
            temperature_s: Seconds::NEG_INFINITY,
        }
    }

    /// Begins an independent step: quantities that were not read while nothing flowed are not
    /// late.
    pub(super) fn begin(&mut self, machine_s: Seconds) {
        self.read_s = Some(machine_s);
        self.temperature_s = self.temperature_s.max(machine_s);
    }

    /// Returns the time since the temperature was read, s.
    pub(super) fn temperature_age_s(&self, machine_s: Seconds) -> Seconds {
        machine_s - self.temperature_s
    }

    /// Accepts a reading that arrived at `machine_s`, and judges the time before it if a current
    /// may flow.
    pub(super) fn judge(
        &mut self,
        reading: &Reading,
        machine_s: Seconds,
        live: bool,
        settings: &Settings,
    ) -> Option<Trip> {
        let since_s = self
            .read_s
            .replace(machine_s)
            .map_or(Seconds::ZERO, |read_s| machine_s - read_s);
        // No earlier reading covers the gap that this reading ends.
        let age_s = if self.logger {
            self.temperature_age_s(machine_s)
        } else {
            Seconds::ZERO
        };
        if reading.temperature_degc.is_some() {
            self.temperature_s = machine_s;
        }
        let limit = |what, age_s, greatest_s| {
            live.then(|| Trip::above(what, age_s, greatest_s, reading.time_s))
                .flatten()
        };
        limit("time without a reading", since_s, settings.reading_age_s).or_else(|| {
            limit(
                "time without a cell temperature",
                age_s,
                settings.temperature_age_s,
            )
        })
    }
}
