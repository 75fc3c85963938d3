//! Settings of the interlock, and what the step in work allows.

use super::{
    drives::Drives,
    limits::{Limits, Trip},
};

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
    /// Capacity of the cell, C.
    #[serde(skip)]
    pub capacity_c: f64,
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
    pub(super) fn followed(&self) -> bool {
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

/// Shortest period over which readings somewhat more than a second apart give a mean, s.
const FOLLOWED_S: f64 = 5.0;
/// Readings in a period that are aimed at, where it is followed: their own time taken,
/// [`FEWEST`](super::period::FEWEST) come.
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
    /// The drives that the step uses.
    pub drives: Drives,
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
            drives: Drives::default(),
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
