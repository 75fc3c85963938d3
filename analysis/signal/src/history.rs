//! Errors of a bench by its own past.

use serde::{Deserialize, Serialize};

/// Standard deviations of a bench's errors, from its own past: repeats of earlier campaigns, data
/// sheets, zero checks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BenchHistory {
    /// White noise of one voltage sample, V.
    pub voltage_noise_v: f64,
    /// Step of the voltage channel's codes, V; 0 where unknown.
    pub voltage_resolution_v: f64,
    /// Level of a run's voltage, V.
    pub voltage_offset_v: f64,
    /// Slow drift of the voltage, V.
    pub voltage_drift_v: f64,
    /// Its correlation time, s.
    pub voltage_drift_s: f64,
    /// Run-to-run spread of all resistances, as a fraction.
    pub resistance_rel: f64,
    /// Gain of the current channel from run to run, as a fraction.
    pub current_gain_rel: f64,
    /// Zero of the current channel from run to run, A.
    pub current_offset_a: f64,
    /// White noise of one current sample, A.
    pub current_noise_a: f64,
    /// Step of the current channel's codes, A; 0 where unknown.
    pub current_resolution_a: f64,
    /// Noise of one part of a spectrum's point, as a fraction of |Z|.
    pub eis_noise_rel: f64,
    /// Error of the meter that start voltages are read with, V: the state of charge at the start is
    /// off by as much over the curve's slope.
    #[serde(default)]
    pub start_voltage_v: f64,
    /// Error that the calibration of the current channel leaves, as a fraction: the same in all
    /// runs, so that repeats do not show it.
    #[serde(default)]
    pub calibration_rel: f64,
    /// Gain that the channels of current and voltage have in common, as a fraction: an impedance
    /// does not show it, a record that moves along the curve does.
    #[serde(default)]
    pub channel_gain_rel: f64,
}
