//! Settings of the interlock, and the allowance of a step.

use instruments::units::{Amps, Coulombs, KelvinsPerSecond, Seconds, Volts};

use super::{
    drives::Drives,
    limits::{Limits, Trip},
};

/// Settings of the interlock beside the limits of the cell.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Greatest rate of the surface temperature, rising or falling, K/s.
    pub rate_k_per_s: KelvinsPerSecond,
    /// Time over which the rate is taken, s.
    pub window_s: Seconds,
    /// Greatest charge that one discharge or charge may move, C.
    #[serde(rename = "charge_c")]
    pub charge_coulomb: Coulombs,
    /// Greatest difference between the charge and what a step without a net charge, or with a
    /// known one, should have moved, C.
    #[serde(rename = "drift_c")]
    pub drift_coulomb: Coulombs,
    /// Greatest time between two readings while current may flow, seconds of the machine.
    pub reading_age_s: Seconds,
    /// Greatest time between two temperatures, seconds of the machine, on a bench with a logger.
    pub temperature_age_s: Seconds,
    /// Charge after which a value that has not changed in any digit counts as frozen, C.
    #[serde(rename = "frozen_c")]
    pub frozen_coulomb: Coulombs,
    /// Time after which a voltage and a current count as frozen under a slow sinusoid, s; at least
    /// two of its periods.
    pub frozen_s: Seconds,
    /// Capacity of the cell, C.
    #[serde(skip)]
    pub capacity_coulomb: Coulombs,
}

/// The mean of a periodic current.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mean {
    /// Its period, s.
    pub period_s: Seconds,
    /// Direct current under it, A, as the meter shows it.
    pub around_a: Amps,
    /// Greatest distance of the mean over a period from the direct current, A.
    pub greatest_a: Amps,
    /// Amplitude of the sinusoid, A; `None` for a current of several sinusoids.
    pub amplitude_a: Option<Amps>,
}

impl Mean {
    /// Checks whether readings a second apart are enough for a mean over one period.
    pub(super) fn followed(&self) -> bool {
        self.period_s >= FOLLOWED_S
    }

    /// Checks whether readings a second apart meet the current at phases that nothing spreads.
    pub fn is_aliased(&self) -> bool {
        !self.followed() && self.amplitude_a.is_none()
    }

    /// Returns half of the period, if two readings that far apart give the mean. Slower currents
    /// are followed reading by reading; faster ones change too much during a reading.
    pub fn pair_s(&self) -> Option<Seconds> {
        (!self.followed() && self.period_s >= PAIR_S && self.amplitude_a.is_some())
            .then_some(0.5 * self.period_s)
    }

    /// Returns the time between two readings while the current is followed, s: short enough for a
    /// mean of each period.
    pub fn poll_s(&self) -> Seconds {
        if self.followed() {
            self.period_s / POLLS
        } else {
            Seconds::INFINITY
        }
    }

    /// Judges a mean.
    pub fn judge(&self, mean_a: Amps, time_s: Seconds) -> Option<Trip> {
        self.judge_pair(mean_a, Seconds::ZERO, time_s)
    }

    /// Judges the mean of two readings that are half a period apart, with an error of `unsure_s`.
    /// This error may shift the mean by the amplitude times sin(π·f·unsure), A.
    pub fn judge_pair(&self, mean_a: Amps, unsure_s: Seconds, time_s: Seconds) -> Option<Trip> {
        let phase =
            (std::f64::consts::PI * unsure_s / self.period_s).min(std::f64::consts::FRAC_PI_2);
        let greatest = self.greatest_a + self.amplitude_a.unwrap_or_default() * phase.sin();
        let allowed = self.around_a - greatest..=self.around_a + greatest;
        Trip::outside("mean of the cell current", mean_a, &allowed, time_s)
    }
}

/// Shortest period over which readings somewhat more than a second apart give a mean, s.
const FOLLOWED_S: Seconds = Seconds(5.0);
/// Target number of readings in a period, if it is followed. Because readings take time
/// themselves, at least [`FEWEST`](super::period::FEWEST) arrive.
const POLLS: f64 = 8.0;
/// Shortest period whose mean follows from two readings half a period apart, s. A record of a
/// faster current is available 2 s after its beginning; a reading that is late by 20 ms adds 0.6
/// of the amplitude to the limit there.
const PAIR_S: Seconds = Seconds(0.1);

/// Allowance of the present step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Allowance {
    /// Limits of each reading.
    pub limits: Limits,
    /// Whether outputs are on, so that readings must arrive.
    pub live: bool,
    /// The drives that the step uses.
    pub drives: Drives,
    /// Whether the step continues the previous one: its charge is added.
    pub continues: bool,
    /// Least and greatest net charge, C, charge positive.
    pub charge_coulomb: (Coulombs, Coulombs),
    /// Voltage from which a supply holds the voltage, V: a constant voltage is then no fault.
    pub held_v: Volts,
    /// The period of a sinusoid that is slow enough to be followed reading by reading, s. The
    /// current and, for a cell, the voltage must change with it.
    pub swing_s: Option<Seconds>,
    /// Allowed mean of the current.
    pub mean: Option<Mean>,
    /// Whether the cell is in the jig, so that its voltage changes with the charge.
    pub cell: bool,
    /// Whether the chiller is to change the temperature, so that its rate is not judged.
    pub tempering: bool,
}

impl Allowance {
    /// Returns an allowance in which nothing may flow.
    pub fn idle(limits: Limits) -> Self {
        let charge_coulomb = (Coulombs::NEG_INFINITY, Coulombs::INFINITY);
        let held_v = Volts::INFINITY;
        Self {
            limits,
            live: false,
            drives: Drives::default(),
            continues: false,
            charge_coulomb,
            held_v,
            swing_s: None,
            mean: None,
            cell: true,
            tempering: false,
        }
    }
}
