//! `dataset.toml` as it is typed; nothing else reads these structures than `resolve`.

use analysis::{
    augmented::Between,
    calibration::CommonError,
    dataset::CurrentPositive,
    diagnosis::{BenchHistory, FindingKind, Role},
    formats::CurrentSign,
};
use serde::Deserialize;

/// The whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct File {
    /// Name of the data set.
    pub(super) name: String,
    /// Path of the cell's model, from the folder of this file. Left out: `--model` or `--erm` must
    /// be given.
    pub(super) model: Option<String>,
    /// Path of the cell's OCV curve, from the folder of this file. `--ocv` and the curve of a model
    /// given by `--model` take its place. Left out: the model must hold one, or `--ocv` be given.
    pub(super) ocv: Option<String>,
    /// Errors of the bench as its past shows them. Left out: they are assumed.
    pub(super) bench: Option<StatedBench>,
    /// Error that the correction leaves in all spectra alike, if the standard deviations of the
    /// spectra are without it. Left out: none.
    pub(super) calibration: Option<CommonError>,
    /// Findings on the data whose correction is used in the place of the raw data, as `--accept`
    /// does. Left out: none.
    pub(super) accept: Option<Vec<Accept>>,
    /// Runs, at least one.
    pub(super) runs: Vec<Run>,
}

/// Standard deviations of a bench's errors, from its own past: repeats of earlier campaigns, data
/// sheets, zero checks. An error that is left out is assumed.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StatedBench {
    /// White noise of one voltage sample, V. Left out: 5e-4.
    pub(super) voltage_noise_v: Option<f64>,
    /// Step of the voltage channel's codes, V; 0 where unknown. Left out: 0.
    pub(super) voltage_resolution_v: Option<f64>,
    /// Level of a run's voltage, V. Left out: 1e-3.
    pub(super) voltage_offset_v: Option<f64>,
    /// Slow drift of the voltage, V. Left out: 2e-4.
    pub(super) voltage_drift_v: Option<f64>,
    /// Its correlation time, s. Left out: 2.
    pub(super) voltage_drift_s: Option<f64>,
    /// Run-to-run spread of all resistances, as a fraction. Left out: 0.01.
    pub(super) resistance_rel: Option<f64>,
    /// Gain of the current channel from run to run, as a fraction. Left out: 2e-3.
    pub(super) current_gain_rel: Option<f64>,
    /// Zero of the current channel from run to run, A. Left out: 1e-3 of the greatest current.
    pub(super) current_offset_a: Option<f64>,
    /// White noise of one current sample, A. Left out: 2e-4 of the greatest current.
    pub(super) current_noise_a: Option<f64>,
    /// Step of the current channel's codes, A; 0 where unknown. Left out: 0.
    pub(super) current_resolution_a: Option<f64>,
    /// Noise of one part of a spectrum's point, as a fraction of |Z|. Left out: 3e-3.
    pub(super) eis_noise_rel: Option<f64>,
    /// Error of the meter that start voltages are read with, V: the state of charge at the start is
    /// off by as much over the curve's slope. Left out: 0.
    pub(super) start_voltage_v: Option<f64>,
    /// Error that the calibration of the current channel leaves, as a fraction: the same in all
    /// runs, so that repeats do not show it. Left out: 0.
    pub(super) calibration_rel: Option<f64>,
    /// Gain that the channels of current and voltage have in common, as a fraction: an impedance
    /// does not show it, a record that moves along the curve does. Left out: 0.
    pub(super) channel_gain_rel: Option<f64>,
}

impl StatedBench {
    /// The errors that are stated, and the others as they are assumed for a greatest current in A.
    pub(super) fn completed(&self, greatest_a: f64) -> BenchHistory {
        let assumed = analysis::diagnosis::assumed_history(greatest_a);
        BenchHistory {
            voltage_noise_v: self.voltage_noise_v.unwrap_or(assumed.voltage_noise_v),
            voltage_resolution_v: self
                .voltage_resolution_v
                .unwrap_or(assumed.voltage_resolution_v),
            voltage_offset_v: self.voltage_offset_v.unwrap_or(assumed.voltage_offset_v),
            voltage_drift_v: self.voltage_drift_v.unwrap_or(assumed.voltage_drift_v),
            voltage_drift_s: self.voltage_drift_s.unwrap_or(assumed.voltage_drift_s),
            resistance_rel: self.resistance_rel.unwrap_or(assumed.resistance_rel),
            current_gain_rel: self.current_gain_rel.unwrap_or(assumed.current_gain_rel),
            current_offset_a: self.current_offset_a.unwrap_or(assumed.current_offset_a),
            current_noise_a: self.current_noise_a.unwrap_or(assumed.current_noise_a),
            current_resolution_a: self
                .current_resolution_a
                .unwrap_or(assumed.current_resolution_a),
            eis_noise_rel: self.eis_noise_rel.unwrap_or(assumed.eis_noise_rel),
            start_voltage_v: self.start_voltage_v.unwrap_or(assumed.start_voltage_v),
            calibration_rel: self.calibration_rel.unwrap_or(assumed.calibration_rel),
            channel_gain_rel: self.channel_gain_rel.unwrap_or(assumed.channel_gain_rel),
        }
    }

    /// Keys of errors that are assumed. The last three of the table are 0 where they are left out.
    pub(super) fn assumed_keys(&self) -> Vec<&'static str> {
        let stated = [
            ("voltage_noise_v", self.voltage_noise_v),
            ("voltage_resolution_v", self.voltage_resolution_v),
            ("voltage_offset_v", self.voltage_offset_v),
            ("voltage_drift_v", self.voltage_drift_v),
            ("voltage_drift_s", self.voltage_drift_s),
            ("resistance_rel", self.resistance_rel),
            ("current_gain_rel", self.current_gain_rel),
            ("current_offset_a", self.current_offset_a),
            ("current_noise_a", self.current_noise_a),
            ("current_resolution_a", self.current_resolution_a),
            ("eis_noise_rel", self.eis_noise_rel),
        ];
        stated
            .iter()
            .filter(|(_, value)| value.is_none())
            .map(|(key, _)| *key)
            .collect()
    }
}

/// One run: a file, or a part of it, and what is known of its measurement.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Run {
    /// Unique name. Left out: that of the file, without extension.
    pub(super) name: Option<String>,
    /// Path of the file, from the folder of this file.
    pub(super) file: String,
    /// Kind of the run.
    pub(super) kind: Kind,
    /// Measured object.
    #[serde(default)]
    pub(super) fixture: Fixture,
    /// Name of the cell; a control has none. Left out: `cell`.
    pub(super) cell: Option<String>,
    /// Resistance of a shunt or a fake cell, Ω, above 0. Left out: the run must be of a cell.
    pub(super) fixture_ohm: Option<f64>,
    /// Temperature at the start, −60 °C to 120 °C. Left out: the first of the file, which must hold
    /// one.
    #[serde(rename = "temperature_c")]
    pub(super) temperature_degc: Option<f64>,
    /// State of charge at the start, 0 to 1. Left out: `ocv_v` must be given, unless the run is of
    /// a control.
    pub(super) soc: Option<f64>,
    /// Open-circuit voltage at the start, V, above 0, in the place of `soc`. Left out: `soc` must
    /// be given, unless the run is of a control.
    pub(super) ocv_v: Option<f64>,
    /// Name of the group of runs that repeat each other. Left out: `name`.
    pub(super) repeat_group: Option<String>,
    /// Place in the campaign. Left out: as listed, from 0.
    pub(super) order: Option<u32>,
    /// Time of the start in the campaign, s. Left out: when the run before ends.
    pub(super) start_s: Option<f64>,
    /// Purpose of the run. Left out: `train`.
    pub(super) role: Option<Role>,
    /// Positive direction of the current in the file and of `bias_a`. Left out: as the format
    /// counts, for BDF `charge`.
    pub(super) current_positive: Option<CurrentPositive>,
    /// Course of the current between two samples of a record. Left out: `linear`.
    pub(super) current_between_samples: Option<Between>,
    /// Start of the used part of a record, s in its own time, at rest. Left out: its first sample.
    pub(super) from_s: Option<f64>,
    /// End of the used part of a record, s in its own time. Left out: its last sample.
    pub(super) to_s: Option<f64>,
    /// Time in the file before which samples are simulated but not compared, s, for a record that
    /// begins under current. Left out: all are compared.
    pub(super) compare_from_s: Option<f64>,
    /// Standard deviation of the open-circuit voltage at the start, V, above 0; gaps are then taken
    /// about their mean. Left out: 0.
    pub(super) level_sigma_v: Option<f64>,
    /// Lowest used frequency of a sweep, Hz, above 0. Left out: its lowest.
    pub(super) from_hz: Option<f64>,
    /// Highest used frequency of a sweep, Hz, above 0. Left out: its highest.
    pub(super) to_hz: Option<f64>,
    /// Direct current of a sweep, A. Left out: from the file, otherwise 0.
    pub(super) bias_a: Option<f64>,
    /// Resistance between the lower tap and the ground of the channels, Ω, where each tap has a
    /// channel of its own. Left out: 0.
    pub(super) below_ohm: Option<f64>,
    /// Inductance between the lower tap and the ground of the channels, H, where each tap has a
    /// channel of its own. Left out: 0.
    pub(super) below_h: Option<f64>,
    /// Time of each point of the sweep since its start, s, 0 or more, in the order of the
    /// frequencies. Left out: not known.
    pub(super) elapsed_s: Option<Vec<f64>>,
    /// Charge put into the cell from the start of the run to each point of the sweep, C, in the
    /// order of the frequencies. Left out: none.
    #[serde(rename = "charge_c")]
    pub(super) charge_coulomb: Option<Vec<f64>>,
    /// Path of a table of harmonics as runs write it, `harmonics.csv`, from the folder of this
    /// file. Left out: none.
    pub(super) harmonics_file: Option<String>,
    /// Number of the sweep in the table of harmonics. Left out: 1.
    pub(super) harmonics_sweep: Option<usize>,
    /// Amplitude of a sweep, A, above 0. Left out: from the file, otherwise unknown.
    pub(super) amplitude_a: Option<f64>,
    /// Name of the spectrum if the file contains several. Left out: the one at `bias_a`.
    pub(super) spectrum: Option<String>,
    /// Whether points are used that the quality gate of the measurement refused, as the column
    /// `flags` of the file says.
    #[serde(default)]
    pub(super) refused_points: bool,
}

/// A finding with a correction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Accept {
    /// The steps of the current in the place of what the logger has filtered.
    CurrentFilter,
}

impl Accept {
    /// The finding.
    pub fn kind(self) -> FindingKind {
        match self {
            Self::CurrentFilter => FindingKind::CurrentFilter,
        }
    }
}

/// Kind of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Kind {
    /// A sweep; it has no keys of a record.
    Eis,
    /// A record in time; it has no keys of a sweep.
    Time,
}

/// Measured object.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Fixture {
    /// A cell.
    #[default]
    Cell,
    /// The current shunt.
    Shunt,
    /// The fake cell.
    FakeCell,
}

/// Returns the sign convention of a file whose current is positive in this direction.
pub(super) fn sign(positive: CurrentPositive) -> CurrentSign {
    match positive {
        CurrentPositive::Charge => CurrentSign::Charge,
        CurrentPositive::Discharge => CurrentSign::Discharge,
    }
}
