//! Detects meters whose values do not change: values that stay the same while charge passes or a
//! sinusoid flows, and values that stay the same for longer than the noise of their meter allows.

use instruments::units::{Amps, Celsius, Coulombs, Seconds, Unit, Volts};

use super::{
    allowance::{Allowance, Settings},
    limits::{Reading, Trip},
    noise::Noise,
};

/// Number of periods of a slow sinusoid in which a reading must change.
const SWINGS: f64 = 2.0;

/// A meter that shows the same value for longer than its noise allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stuck {
    /// Quantity that it measures.
    pub quantity: Quantity,
    /// Number of equal readings.
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

/// Charge and time: at a moment, or passed since then.
#[derive(Debug, Clone, Copy)]
struct Passed {
    charge_coulomb: Coulombs,
    time_s: Seconds,
}

/// A value, and the charge, C, and the bench time, s, of its last change.
#[derive(Debug, Clone, Copy, Default)]
struct Last<Q> {
    value: Option<Q>,
    charge_coulomb: Coulombs,
    /// `None`: counted from the next reading on.
    time_s: Option<Seconds>,
}

impl<Q: Unit> Last<Q> {
    /// Returns the charge and time that have passed since the value changed.
    fn since(&mut self, value: Q, now: Passed) -> Passed {
        if self.value != Some(value) {
            *self = Self {
                value: Some(value),
                charge_coulomb: now.charge_coulomb,
                time_s: None,
            };
        }
        Passed {
            charge_coulomb: (now.charge_coulomb - self.charge_coulomb).abs(),
            time_s: now.time_s - *self.time_s.get_or_insert(now.time_s),
        }
    }
}

/// One meter: its last value and its known noise.
#[derive(Debug, Default)]
struct Meter<Q> {
    last: Last<Q>,
    noise: Noise,
}

impl<Q: Unit> Meter<Q> {
    fn stuck(&self, quantity: Quantity) -> Option<Stuck> {
        Some(Stuck {
            quantity,
            times: self.noise.stuck()?,
            value: self.last.value?.number(),
        })
    }
}

/// The meters of the cell.
#[derive(Debug, Default)]
pub(super) struct Meters {
    voltage: Meter<Volts>,
    current: Meter<Amps>,
    temperature: Meter<Celsius>,
}

impl Meters {
    /// Returns a meter that shows the same value for longer than its noise allows.
    pub(super) fn stuck(&self) -> Option<Stuck> {
        self.temperature
            .stuck(Quantity::Temperature)
            .or_else(|| self.voltage.stuck(Quantity::Voltage))
            .or_else(|| self.current.stuck(Quantity::Current))
    }

    /// Begins an independent step. The noise of voltage and current applied to the previous step,
    /// because their ranges change from step to step.
    pub(super) fn begin(&mut self) {
        (self.voltage, self.current) = (Meter::default(), Meter::default());
        self.temperature.last = Last::default();
    }

    /// Resets the meters when another current flows: values that did not change before were
    /// correct.
    pub(super) fn move_anew(&mut self) {
        (self.voltage.last.time_s, self.current.last.time_s) = (None, None);
    }

    /// Checks whether the temperature has not changed for longer than usual.
    pub(super) fn temperature_is_suspect(&self) -> bool {
        self.temperature.noise.suspect()
    }

    /// Estimates the noise of each meter. Under a sinusoid readings reverse their direction
    /// without any noise.
    pub(super) fn listen(&mut self, reading: &Reading, allowance: &Allowance) {
        if let Some(celsius) = reading.temperature_degc {
            self.temperature.noise.take(celsius.value());
        }
        if allowance.mean.is_some() || allowance.swing_s.is_some() {
            return;
        }
        // A supply in voltage control may hold the voltage better than the meter resolves.
        if let Some(volts) = reading.voltage_v.filter(|volts| *volts < allowance.held_v) {
            self.voltage.noise.take(volts.value());
        }
        if let Some(amps) = reading.current_a.filter(|_| allowance.live) {
            self.current.noise.take(amps.value());
        }
    }

    /// Accepts a reading, before which the step has moved a charge, C, and judges whether a value
    /// has not changed for too long.
    pub(super) fn judge(
        &mut self,
        reading: &Reading,
        charge_coulomb: Coulombs,
        allowance: &Allowance,
        settings: &Settings,
    ) -> Option<Trip> {
        let now = Passed {
            charge_coulomb,
            time_s: reading.time_s,
        };
        let volts = reading
            .voltage_v
            .map(|volts| self.voltage.last.since(volts, now));
        let amps = reading
            .current_a
            .map(|amps| self.current.last.since(amps, now));
        let celsius = reading
            .temperature_degc
            .map(|celsius| self.temperature.last.since(celsius, now));
        if !allowance.live {
            return None;
        }
        let held = reading
            .voltage_v
            .is_some_and(|volts| volts >= allowance.held_v);
        let cell = |since: Option<Passed>| since.filter(|_| allowance.cell);
        let charge = |what, since: Option<Passed>| {
            let moved_coulomb = cell(since)?.charge_coulomb;
            Trip::above(what, moved_coulomb, settings.frozen_coulomb, reading.time_s)
        };
        let time = |what, since: Option<Passed>| {
            let greatest_s = settings.frozen_s.max(SWINGS * allowance.swing_s?);
            Trip::above(what, since?.time_s, greatest_s, reading.time_s)
        };
        charge(
            "charge while the cell voltage stood still",
            volts.filter(|_| !held),
        )
        .or_else(|| charge("charge while the cell temperature stood still", celsius))
        .or_else(|| {
            let what = "time in which the cell voltage stood still under a sinusoid";
            time(what, cell(volts))
        })
        .or_else(|| {
            let what = "time in which the cell current stood still under a sinusoid";
            time(what, amps)
        })
    }
}
