//! The index of a run folder, `traces.json`: the file of each sweep and each trace of the cell and
//! the conditions of its measurement, so that the folder can be read as a data set. Controls are
//! not runs of it.

use analysis_effects::augmented::Between;
use analysis_signal::{calibration::CommonError, series::Role, spectrum::FlaggedPoint};
use serde::{Deserialize, Serialize};

/// Contents of a run folder, in chronological order.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RunIndex {
    /// Name of the cell.
    pub cell: String,
    /// Capacity of the cell as stated, C.
    #[serde(rename = "capacity_c")]
    pub capacity_coulomb: f64,
    /// Spectra.
    pub sweeps: Vec<SweepEntry>,
    /// Time series.
    pub traces: Vec<TraceEntry>,
}

/// Conditions of one point of a sweep under a direct current.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PointConditions {
    /// Commanded direct current, A, charge positive.
    pub bias_a: f64,
    /// Measured direct current, A.
    pub bias_measured_a: f64,
    /// Standard deviation of the measured direct current, A.
    pub sigma_bias_a: f64,
    /// Charge that the direct current has moved since the rest before the sweep, C, at the middle of
    /// the point's record.
    #[serde(rename = "charge_c")]
    pub charge_coulomb: f64,
    /// Temperature of the cell's surface, °C; `None` if it was not measured.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
}

/// One spectrum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SweepEntry {
    /// File in the run folder, [`super::SPECTRUM_COLUMNS`].
    pub file: String,
    /// Object in the jig: `cell` or `shunt`.
    pub fixture: String,
    /// Name of the cell in a campaign of several cells; if absent, the name in the index applies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cell: Option<String>,
    /// Known resistance of the fixture, Ω; `None` for a cell.
    pub fixture_ohm: Option<f64>,
    /// Whether control impedances correct the harness.
    pub corrected: bool,
    /// Commanded amplitude of the current, A.
    pub amplitude_a: f64,
    /// Commanded direct current under the sinusoids, A, charge positive.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub bias_a: f64,
    /// Number of the repeat, from 1.
    pub repeat: usize,
    /// Place among all sweeps and traces of the run, from 0.
    pub order: usize,
    /// Bench time of the start, s.
    pub start_time_s: f64,
    /// Voltage at rest before it, V; `None` if it was not measured.
    pub start_ocv_v: Option<f64>,
    /// Temperature of the cell's surface at the start, °C; `None` if it was not measured.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
    /// Purpose of the run.
    pub role: Role,
    /// Runs of one group repeat each other.
    pub repeat_group: String,
    /// Points that a quality gate refused in all attempts; empty for a run without a gate.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub flagged: Vec<FlaggedPoint>,
    /// Standard deviations of real and imaginary part from each point's own records, in the order
    /// of the file, Ω. Those in the file also include the uncertainty of the correction.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub own_sigma_ohm: Vec<[f64; 2]>,
    /// Common error of the correction in all spectra of the cell; `None` without a correction, and
    /// for a control.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub common_error: Option<CommonError>,
    /// Resistance between the lower tap of the object under test and the ground of the channels, Ω:
    /// the voltage of that tap's channel divided by the current.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub below_ohm: Option<f64>,
    /// Inductance of the same path, H.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub below_h: Option<f64>,
    /// Time of each point's record since the start of the sweep, in the order of the file, s.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub elapsed_s: Vec<f64>,
    /// Conditions of each point, in the order of the file; empty without a direct current.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<PointConditions>,
}

fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// One time series.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TraceEntry {
    /// File in the run folder, [`super::TRACE_COLUMNS`].
    pub file: String,
    /// Name of the trace in the experiment.
    pub name: String,
    /// Name of the cell in a campaign of several cells; if absent, the name in the index applies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cell: Option<String>,
    /// Number of the repeat, from 1.
    pub repeat: usize,
    /// Place among all sweeps and traces of the run, from 0.
    pub order: usize,
    /// Bench time of test time 0, s.
    pub start_time_s: f64,
    /// Voltage at rest before it, V.
    pub start_ocv_v: f64,
    /// Charge that the traces before it have left in the cell, C; charge positive.
    #[serde(rename = "charge_before_c")]
    pub charge_before_coulomb: f64,
    /// Temperature of the cell's surface at the start, °C; `None` if it was not measured.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
    /// Purpose of the run.
    pub role: Role,
    /// Runs of one group repeat each other.
    pub repeat_group: String,
    /// Direction of the positive current.
    pub current_positive: CurrentPositive,
    /// Course of the current between two rows.
    pub current_between_samples: Between,
    /// Test times of the steps of the current, s.
    pub steps_s: Vec<f64>,
    /// Scatter of one sample of the current, A rms.
    pub sample_sigma_a: f64,
    /// Scatter of one sample of the voltage, V rms.
    pub sample_sigma_v: f64,
    /// Commanded current over time; `None` if the instruments' own meters recorded the trace.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub commanded: Option<Commanded>,
}

/// Commanded current over time. Captures do not contain it; steps are searched near the commanded
/// times.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Commanded {
    /// Bench times, s, and the current from each of them on, A, charge positive.
    Steps(Vec<(f64, f64)>),
    /// One wave of many steps.
    Wave {
        /// Bench time after the message that started it, s.
        sent_s: f64,
        /// Length of a step by the generator's clock, s.
        step_s: f64,
    },
}

/// Direction of the current that is positive in a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CurrentPositive {
    /// Into the cell.
    Charge,
    /// Out of the cell.
    Discharge,
}
