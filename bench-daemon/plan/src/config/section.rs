//! Sections of an experiment, complete and checked.

use analysis_fit::fit::Objective;
use analysis_model::ocv::OcvCurve;
use analysis_signal::calibration::ControlTolerance;
use instruments::{
    fixture::Fixture,
    units::{Amps, Celsius, Coulombs, Hertz, Kelvins, Ohms, Seconds, Volts},
};

use crate::{measure::quality::Quality, plan::Missed};

/// A cell and what may be done to it.
#[derive(Debug, Clone, serde::Serialize)]
pub struct Cell {
    /// Its name.
    pub name: String,
    /// Its identity.
    #[serde(skip_serializing_if = "super::Identity::is_empty")]
    pub identity: super::Identity,
    /// Capacity, C.
    #[serde(rename = "capacity_c")]
    pub capacity_coulomb: Coulombs,
    /// Limits of the cell.
    pub limits: crate::interlock::Limits,
    /// Settings of the interlock beside the limits.
    pub interlock: crate::interlock::Settings,
    /// Cells in series in the pack that the model is mapped to.
    pub series: u32,
    /// Cells in parallel.
    pub parallel: u32,
    /// Open-circuit voltage as the data sheet or an earlier cell shows it.
    #[serde(skip)]
    pub ocv: Option<OcvCurve>,
    /// Limits that lie beyond its data or common values, in words.
    #[serde(skip)]
    pub wide: Vec<String>,
}

/// A temperature to hold.
#[derive(Debug, Clone, Copy)]
pub struct Temperature {
    /// Set-point, °C.
    pub setpoint_degc: Celsius,
    /// Accepted deviation of the cell, K.
    pub within_k: Kelvins,
    /// Longest wait, s.
    pub timeout_s: Seconds,
}

/// The check of the bench.
#[derive(Debug, Clone)]
pub struct FixtureCheck {
    /// The controls to measure and how far their raw reading may be off.
    pub controls: Vec<(Fixture, Tolerance)>,
    /// How far a control may be off after the correction, as a share.
    pub corrected_tolerance: f64,
    /// Frequencies beyond those of the sweep at which the controls are measured, Hz. No check
    /// uses them; they show the usable range of the bench.
    pub beyond_hz: Vec<Hertz>,
}

/// How far a control may be off as read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Tolerance {
    /// Of an impedance: by magnitude and phase.
    Relative(ControlTolerance),
    /// Of a short: by this much in any direction, Ω.
    Absolute(f64),
}

/// The reset of the state of charge (thesis 3.3.1).
#[derive(Debug, Clone, Copy)]
pub struct SocReset {
    /// Discharge current, A, positive.
    pub discharge_a: Amps,
    /// End of the discharge, V under load.
    pub discharge_until_v: Volts,
    /// Charge current, A.
    pub charge_a: Amps,
    /// Voltage limit of the supply, V.
    pub charge_limit_v: Volts,
    /// End of the charge, V under load.
    pub charge_until_v: Volts,
    /// Shortest rest, s.
    pub rest_min_s: Seconds,
    /// Longest rest, s.
    pub rest_max_s: Seconds,
    /// The rest ends when the voltage changes more slowly, V/s.
    pub rest_slope_v_per_s: f64,
    /// Longest discharge and longest charge, s.
    pub max_s: Seconds,
    /// Where the voltage must come to rest, where that is asked for.
    pub acceptance: Option<Acceptance>,
}

/// When a reset of the state of charge has succeeded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Acceptance {
    /// The band of the voltage at rest, V.
    pub band_v: (Volts, Volts),
    /// Resets at most.
    pub attempts: usize,
    /// Treatment of a cell that misses it to the end.
    pub missed: Missed,
}

/// The sweeps.
#[derive(Debug, Clone)]
pub struct Eis {
    /// Fixture that is swept, beside the controls.
    pub fixture: Fixture,
    /// How often; 0 where only the controls are.
    pub repeat: usize,
    /// Rest of the cell before each, s.
    pub rest_s: Seconds,
    /// Frequencies, rising, Hz.
    pub freqs_hz: Vec<Hertz>,
    /// Amplitude of the current, A.
    pub amplitude_a: Amps,
    /// Periods waited at least.
    pub periods: f64,
    /// Waited on top, s.
    pub extra_wait_s: Seconds,
    /// Periods on the screen at least.
    pub periods_on_screen: f64,
    /// Points downloaded per channel.
    pub record_points: u64,
    /// Points in the scope's memory per channel.
    pub memory_points: u64,
    /// Frequency of the mains whose pick-up is fitted besides the sinusoid, Hz; `None` if no
    /// pick-up is expected.
    pub mains_hz: Option<Hertz>,
    /// In which order the frequencies come.
    pub order: Order,
    /// Amplitudes of the sweeps of a round, A; the largest is `amplitude_a`.
    pub steps_a: Vec<Amps>,
    /// Each sweep goes there and back, and every point counts at the time in between.
    pub compensate_drift: bool,
    /// The next point settles while the record of this one is fetched and analysed; where it is not
    /// said, in real time only.
    pub overlap: Option<bool>,
    /// Limits that a point must keep to be stored without a flag, where they are asked for.
    pub quality: Option<Quality>,
    /// Direct currents under the sinusoids; `None` if there is none.
    pub bias: Option<EisBias>,
}

/// Direct currents under the sinusoids of the sweeps.
#[derive(Debug, Clone, PartialEq)]
pub struct EisBias {
    /// The currents, A, charge positive; each round has a sweep at each, at rest first.
    pub levels_a: Vec<Amps>,
    /// Charge that a group of points may move before it is brought back, C.
    pub most_coulomb: Coulombs,
    /// Greatest resistance of the cell, leads included, Ω.
    pub resistance_ohm: Ohms,
    /// Wait after a ramp, s.
    pub settle_s: Seconds,
    /// Capacity of the cell, C.
    pub capacity_coulomb: Coulombs,
}

impl EisBias {
    /// Charge that a group of points may move if it is not stated, as a share of the capacity.
    pub const CHARGE: f64 = 0.05;
    /// Wait after a ramp if it is not stated, s.
    pub const SETTLE_S: Seconds = Seconds(30.0);
}

/// In which order the frequencies of a sweep come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Order {
    /// The slowest first.
    #[default]
    Ascending,
    /// The fastest first.
    Descending,
    /// Drawn from the seed, again for each sweep: a drift of the cell becomes noise.
    Random,
    /// The slowest, the fastest, the second slowest …
    Alternating,
}

/// The fits.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Orders.
    pub rc: Vec<usize>,
    /// Objective that is minimised.
    pub objective: Objective,
    /// Points that the quality gate has refused are fitted, too.
    pub refused_points: bool,
}
