//! Checks that need several readings: the rate of the temperature, the charge that was moved,
//! readings that are late or missing, and values that do not change.

use instruments::{
    chiller,
    units::{Amps, Seconds},
};

use super::{
    ages::Ages,
    allowance::{Allowance, Mean, Settings},
    bath::BathReading,
    charge::ChargeCount,
    limits::{Limits, Reading, Trip, judge},
    meters::{Meters, Stuck},
    period::Period,
    temperatures::Temperatures,
    thermometers::ThermometerReadings,
};

/// Judges successive readings.
#[derive(Debug)]
pub struct Interlock {
    settings: Settings,
    allowance: Allowance,
    /// Whether the signal of the step has ended on its own.
    silent: bool,
    ages: Ages,
    charge: ChargeCount,
    period: Period,
    temperatures: Temperatures,
    meters: Meters,
}

impl Interlock {
    /// Creates an interlock without readings that allows no current.
    pub fn new(settings: Settings, limits: Limits, logger: bool) -> Self {
        Self {
            settings,
            allowance: Allowance::idle(limits),
            silent: false,
            ages: Ages::new(logger),
            charge: ChargeCount::default(),
            period: Period::default(),
            temperatures: Temperatures::new(&settings, &limits),
            meters: Meters::default(),
        }
    }

    /// Returns a meter that shows the same value for longer than its noise allows.
    pub fn stuck(&self) -> Option<Stuck> {
        self.meters.stuck()
    }

    /// Begins a step at `machine_s`.
    pub fn begin(&mut self, allowance: Allowance, machine_s: Seconds) {
        if !allowance.continues {
            self.charge = ChargeCount::default();
            self.meters.begin();
            self.ages.begin(machine_s);
        }
        if allowance.mean != self.allowance.mean || !allowance.continues {
            self.period.lose();
        }
        if allowance.swing_s != self.allowance.swing_s {
            self.meters.move_anew();
        }
        if allowance.tempering != self.allowance.tempering {
            self.temperatures.forget();
        }
        self.allowance = allowance;
    }

    /// Sets whether the signal of the step has ended on its own: after that no value changes any
    /// more, and the last period is incomplete.
    pub fn silent(&mut self, silent: bool) {
        if silent != self.silent {
            self.period.lose();
            self.meters.move_anew();
        }
        self.silent = silent;
    }

    /// Drops the readings of the period so far, because they do not belong to one signal or their
    /// times are unknown.
    pub fn lose_period(&mut self) {
        self.period.lose();
    }

    /// Drops the history after a change of the object in the jig: earlier readings do not apply to
    /// it.
    pub fn forget(&mut self) {
        self.temperatures.change_fixture();
        self.meters = Meters::default();
    }

    /// Sets the reading of the ammeter with the output off, A, which counts as no charge. A
    /// reading beyond a zero error is replaced by 0.
    pub fn zero(&mut self, zero_a: Amps) {
        self.charge.zero(zero_a);
    }

    /// Sets the direct current that is commanded from now on, A: the charge that it moves is
    /// expected.
    pub fn steady(&mut self, steady_a: Amps) {
        self.charge.steady(steady_a);
    }

    /// Returns the allowance of the present step.
    pub fn allowance(&self) -> &Allowance {
        &self.allowance
    }

    /// Returns the limits of each reading in the present step.
    pub fn limits(&self) -> &Limits {
        &self.allowance.limits
    }

    /// Checks whether a current may flow.
    pub fn is_live(&self) -> bool {
        self.allowance.live
    }

    /// Checks whether the temperature is to change.
    pub fn tempering(&self) -> bool {
        self.allowance.tempering
    }

    /// Returns the allowed mean of the current in the present step, or `None` while no reading is
    /// to be judged.
    pub fn allowed_mean(&self) -> Option<Mean> {
        self.allowance.mean.filter(|_| !self.silent)
    }

    /// Returns the effective value of the alternating current over the last period, A, if readings
    /// follow it.
    pub fn effective_a(&self) -> Option<Amps> {
        let mean = self.allowed_mean().filter(Mean::followed)?;
        let square = self
            .period
            .mean_of(&mean, |amps| (amps - mean.around_a).value().powi(2));
        square.map(f64::sqrt).map(Amps)
    }

    /// Checks whether the temperature is half as old as it may be, or has not changed for longer
    /// than usual.
    pub fn wants_temperature(&self, machine_s: Seconds) -> bool {
        let age_s = self.ages.temperature_age_s(machine_s);
        let old = age_s > 0.5 * self.settings.temperature_age_s;
        self.allowance.live && (old || self.meters.temperature_is_suspect())
    }

    /// Judges a reading that arrived at `machine_s`.
    pub fn judge(&mut self, reading: &Reading, machine_s: Seconds) -> Option<Trip> {
        let (settings, allowance) = (self.settings, self.allowance);
        self.meters.listen(reading, &allowance);
        let late = self
            .ages
            .judge(reading, machine_s, allowance.live, &settings);
        self.charge.count(reading);
        self.temperatures.take_reading(reading);
        judge(&allowance.limits, reading)
            .or(late)
            .or_else(|| {
                self.temperatures
                    .judge(reading, allowance.tempering, &settings)
            })
            .or_else(|| self.mean(reading))
            .or_else(|| self.charge.judge(&allowance, reading.time_s))
            .or_else(|| self.frozen(reading))
    }

    /// Judges the status of a chiller that was started.
    pub fn chiller(&self, status: &chiller::Status, time_s: Seconds) -> Option<Trip> {
        (!status.running || status.alarm.is_some()).then(|| Trip::Chiller {
            message: status.raw.clone(),
            time_s,
        })
    }

    /// Judges a reading of the bath's own sensor.
    pub fn judge_bath(&mut self, reading: BathReading, time_s: Seconds) -> Option<Trip> {
        self.temperatures.judge_bath(reading, time_s)
    }

    /// Judges a reading of all thermometers.
    pub fn judge_thermometers(
        &mut self,
        readings: ThermometerReadings,
        time_s: Seconds,
    ) -> Option<Trip> {
        self.temperatures
            .judge_thermometers(readings, self.allowance.cell, time_s)
    }

    /// Judges the mean over the last period, as soon as a complete one was read.
    fn mean(&mut self, reading: &Reading) -> Option<Trip> {
        let mean = self.allowed_mean().filter(Mean::followed)?;
        self.period.take(&mean, reading.time_s, reading.current_a?);
        let mean_a = self.period.mean_of(&mean, Amps::value).map(Amps)?;
        mean.judge(mean_a, reading.time_s)
    }

    /// Judges values that do not change. If the signal has ended, they need not change.
    fn frozen(&mut self, reading: &Reading) -> Option<Trip> {
        let allowance = Allowance {
            swing_s: self.allowance.swing_s.filter(|_| !self.silent),
            ..self.allowance
        };
        let moved_coulomb = self.charge.moved_coulomb();
        self.meters
            .judge(reading, moved_coulomb, &allowance, &self.settings)
    }
}

#[cfg(test)]
mod tests;
