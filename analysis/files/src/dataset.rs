//! Reads and writes the files of a run, and defines their columns with unit and meaning in one
//! place.
//!
//! Captures are Parquet: the raw ADC codes, and the scaling as metadata of the file, so that
//! nothing is lost. Spectra and time series are CSV, which grows by one row at a time during the
//! run, and Parquet. Whole files appear atomically (written to a temporary file, synced, renamed),
//! equal input gives equal bytes, and numbers round-trip exactly. Readers ignore a row that a crash
//! truncated, and the next append removes it.
//!
//! Does not depend on run folders and file names; [`crate::formats`] reads foreign formats.

mod capture;
mod columns;
mod disk;
mod error;
mod frame;
mod index;
mod rows;
pub(crate) mod shared;
mod stored;
mod trace;

use std::path::Path;

pub use capture::{
    CAPTURE_COLUMNS, Capture, CaptureMeta, ChannelMeta, read_capture, write_capture,
};
pub use disk::{write_atomically, write_private};
pub use index::{Commanded, CurrentPositive, PointConditions, RunIndex, SweepEntry, TraceEntry};
pub use stored::{CaptureFile, open_capture};
pub use trace::write_trace_parquet;

use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use columns::FLAGS_COLUMN;
pub use columns::{
    CONDITION_COLUMNS, ColumnSpec, FLAGS, LEG_COLUMNS, SERIES_COLUMNS, SPECTRUM_COLUMNS,
    TRACE_COLUMNS,
};
pub use error::DatasetError;
use num_complex::Complex64;

/// One reading of a leg of direct current or of rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LegRow {
    /// Time since the start of the first leg, s.
    pub time_s: f64,
    /// Current into the cell, charge positive, A.
    pub current_a: f64,
    /// Voltage at the load's sense terminals, V.
    pub voltage_v: f64,
    /// Temperature of the cell's surface, °C; NaN if not measured.
    pub temperature_degc: f64,
    /// Charge that has flowed into the cell since the start of the first leg, C.
    pub charge_coulomb: f64,
}

/// One row of a trace.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TraceRow {
    /// Time since the start of the trace, s.
    pub time_s: f64,
    /// Current into the cell, charge positive, A.
    pub current_a: f64,
    /// Voltage of the cell, V.
    pub voltage_v: f64,
    /// Temperature of the cell's surface, °C; NaN if not measured.
    pub temperature_degc: f64,
    /// Number of samples in the mean of current and voltage.
    pub samples: f64,
    /// Start and end of that mean, s; NaN if unknown. The last row before a step is closer to the
    /// step than the centre of its mean.
    pub averaged_s: (f64, f64),
}

/// One row of a time series.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SeriesRow {
    /// Bench time, s.
    pub time_s: f64,
    /// Voltage of the cell, V; NaN if not measured.
    pub voltage_v: f64,
    /// Current into the cell, charge positive, A; NaN if not measured.
    pub current_a: f64,
    /// Temperature of the cell's surface, °C; NaN if not measured.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: f64,
}

impl rows::Row for ImpedancePoint {
    const COLUMNS: &'static [ColumnSpec] = SPECTRUM_COLUMNS;

    fn values(&self) -> Vec<f64> {
        let Covariance2 {
            re_re,
            re_im,
            im_im,
        } = self.covariance;
        vec![
            self.freq_hz,
            self.z_ohm.re,
            self.z_ohm.im,
            re_re.sqrt(),
            im_im.sqrt(),
            re_im,
            self.amplitude_a,
        ]
    }

    fn from_values(values: &[f64]) -> Option<Self> {
        let [freq_hz, re, im, sigma_re, sigma_im, re_im, amplitude_a] = *values else {
            return None;
        };
        let covariance = Covariance2 {
            re_re: sigma_re * sigma_re,
            re_im,
            im_im: sigma_im * sigma_im,
        };
        Some(Self {
            freq_hz,
            z_ohm: Complex64::new(re, im),
            covariance,
            amplitude_a,
        })
    }
}

impl rows::Row for SeriesRow {
    const COLUMNS: &'static [ColumnSpec] = SERIES_COLUMNS;

    fn values(&self) -> Vec<f64> {
        vec![
            self.time_s,
            self.voltage_v,
            self.current_a,
            self.temperature_degc,
        ]
    }

    fn from_values(values: &[f64]) -> Option<Self> {
        let [time_s, voltage_v, current_a, temperature_degc] = *values else {
            return None;
        };
        Some(Self {
            time_s,
            voltage_v,
            current_a,
            temperature_degc,
        })
    }
}

impl rows::Row for TraceRow {
    const COLUMNS: &'static [ColumnSpec] = TRACE_COLUMNS;
    // Earlier runs do not store the windows.
    const NEEDED: usize = 5;

    fn values(&self) -> Vec<f64> {
        vec![
            self.time_s,
            self.current_a,
            self.voltage_v,
            self.temperature_degc,
            self.samples,
            self.averaged_s.0,
            self.averaged_s.1,
        ]
    }

    fn from_values(values: &[f64]) -> Option<Self> {
        let [
            time_s,
            current_a,
            voltage_v,
            temperature_degc,
            samples,
            from_s,
            to_s,
        ] = *values
        else {
            return None;
        };
        Some(Self {
            time_s,
            current_a,
            voltage_v,
            temperature_degc,
            samples,
            averaged_s: (from_s, to_s),
        })
    }
}

impl rows::Row for LegRow {
    const COLUMNS: &'static [ColumnSpec] = LEG_COLUMNS;

    fn values(&self) -> Vec<f64> {
        vec![
            self.time_s,
            self.current_a,
            self.voltage_v,
            self.temperature_degc,
            self.charge_coulomb,
        ]
    }

    fn from_values(values: &[f64]) -> Option<Self> {
        let [
            time_s,
            current_a,
            voltage_v,
            temperature_degc,
            charge_coulomb,
        ] = *values
        else {
            return None;
        };
        Some(Self {
            time_s,
            current_a,
            voltage_v,
            temperature_degc,
            charge_coulomb,
        })
    }
}

/// Writes legs of direct current as BDF CSV, [`LEG_COLUMNS`].
///
/// # Errors
/// [`DatasetError::Io`].
pub fn write_legs_csv(path: &Path, rows: &[LegRow]) -> Result<(), DatasetError> {
    rows::write_csv(path, rows)
}

/// Reads legs that [`write_legs_csv`] wrote.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Header`], [`DatasetError::Field`].
pub fn read_legs_csv(path: &Path) -> Result<Vec<LegRow>, DatasetError> {
    rows::read_csv(path)
}

/// Writes a trace as BDF CSV, [`TRACE_COLUMNS`].
///
/// # Errors
/// [`DatasetError::Io`].
pub fn write_trace_csv(path: &Path, trace: &[TraceRow]) -> Result<(), DatasetError> {
    rows::write_csv(path, trace)
}

/// Reads a trace that [`write_trace_csv`] wrote.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Header`], [`DatasetError::Field`].
pub fn read_trace_csv(path: &Path) -> Result<Vec<TraceRow>, DatasetError> {
    rows::read_csv(path)
}

/// Writes a spectrum as CSV, [`SPECTRUM_COLUMNS`].
///
/// The variances are stored as standard deviations and round-trip to within rounding; all other
/// numbers round-trip exactly. Reading a file and writing it again gives the same bytes.
///
/// # Errors
/// [`DatasetError::Io`].
pub fn write_spectrum_csv(path: &Path, points: &[ImpedancePoint]) -> Result<(), DatasetError> {
    rows::write_csv(path, points)
}

/// Writes a spectrum as CSV with the errors that its points share: behind [`SPECTRUM_COLUMNS`] two
/// columns per error, `shared_re_ohm[NAME]` and `shared_im_ohm[NAME]`, the deviation of the point
/// by one standard deviation of the error, Ω. The standard deviations of the points include them.
/// If a point was refused, `flags` follow as in [`write_flagged_spectrum_csv`]; a spectrum without
/// a gate has none.
///
/// # Errors
/// [`DatasetError::Io`].
pub fn write_whole_spectrum_csv(
    path: &Path,
    spectrum: &Spectrum,
    flags: &[String],
) -> Result<(), DatasetError> {
    let (mut header, mut rows) = shared::columns(spectrum);
    if is_flagged(flags) {
        header.push_str(FLAGS);
        rows.iter_mut()
            .zip(flags)
            .for_each(|(row, flag)| row.push_str(&flag_field(flag)));
    }
    rows::write_csv_with(path, &spectrum.points, &header, &rows)
}

/// Writes a spectrum that was measured under a direct current as CSV: behind [`SPECTRUM_COLUMNS`]
/// the conditions of each point, [`CONDITION_COLUMNS`], then as [`write_whole_spectrum_csv`].
///
/// # Errors
/// [`DatasetError::Io`].
pub fn write_biased_spectrum_csv(
    path: &Path,
    spectrum: &Spectrum,
    conditions: &[PointConditions],
    flags: &[String],
) -> Result<(), DatasetError> {
    let names = CONDITION_COLUMNS
        .iter()
        .map(|spec| format!(",{}", spec.name));
    let (shared_header, shared_rows) = shared::columns(spectrum);
    let mut header = names.collect::<String>() + &shared_header;
    let flagged = is_flagged(flags);
    if flagged {
        header.push_str(FLAGS);
    }
    // A point without conditions has empty fields, which no reader takes for a current of zero.
    let fields = |point: &PointConditions| -> String {
        let values = [
            point.bias_a,
            point.bias_measured_a,
            point.sigma_bias_a,
            point.charge_coulomb,
            point.temperature_degc.unwrap_or(f64::NAN),
        ];
        values.iter().map(|value| format!(",{value:?}")).collect()
    };
    let row = |k: usize| {
        let mut row = conditions
            .get(k)
            .map_or_else(|| ",".repeat(CONDITION_COLUMNS.len()), fields);
        row.push_str(shared_rows.get(k).map_or("", String::as_str));
        if flagged {
            row.push_str(&flag_field(flags.get(k).map_or("", String::as_str)));
        }
        row
    };
    let rows: Vec<String> = (0..spectrum.points.len()).map(row).collect();
    rows::write_csv_with(path, &spectrum.points, &header, &rows)
}

/// Returns whether any point was refused.
fn is_flagged(flags: &[String]) -> bool {
    flags.iter().any(|flag| !flag.is_empty())
}

/// Reasons as the last field of a line.
pub(crate) fn flag_field(flag: &str) -> String {
    format!(",{}", flag.replace([',', '"', '\n'], " "))
}

/// Writes a spectrum as CSV with a column `flags` behind [`SPECTRUM_COLUMNS`]: why a point was
/// refused, reasons separated by `; `; empty for the others.
///
/// # Errors
/// [`DatasetError::Io`].
pub fn write_flagged_spectrum_csv(
    path: &Path,
    points: &[ImpedancePoint],
    flags: &[String],
) -> Result<(), DatasetError> {
    let rows: Vec<String> = flags.iter().map(|flag| flag_field(flag)).collect();
    rows::write_csv_with(path, points, FLAGS, &rows)
}

/// Appends one point to a spectrum in CSV, or creates the file; syncs it to disk before returning.
/// Removes a truncated last line first.
///
/// # Errors
/// [`DatasetError::Io`]; [`DatasetError::Header`] if the file is something else.
pub fn append_spectrum_csv(path: &Path, point: &ImpedancePoint) -> Result<(), DatasetError> {
    rows::append_csv(path, point)
}

/// Reads a spectrum from CSV. Ignores a last line without a line end, which a crash truncated.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Header`], [`DatasetError::Field`].
pub fn read_spectrum_csv(path: &Path) -> Result<Vec<ImpedancePoint>, DatasetError> {
    rows::read_csv(path)
}

/// Writes a spectrum as Parquet, [`SPECTRUM_COLUMNS`].
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Parquet`].
pub fn write_spectrum_parquet(path: &Path, points: &[ImpedancePoint]) -> Result<(), DatasetError> {
    rows::write_parquet(path, points)
}

/// Writes a spectrum as Parquet with a column `flags` behind [`SPECTRUM_COLUMNS`], as
/// [`write_flagged_spectrum_csv`]; without it if no point was refused.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Parquet`].
pub fn write_flagged_spectrum_parquet(
    path: &Path,
    points: &[ImpedancePoint],
    flags: &[String],
) -> Result<(), DatasetError> {
    if !is_flagged(flags) || flags.len() != points.len() {
        return rows::write_parquet(path, points);
    }
    rows::write_parquet_with(path, points, FLAGS_COLUMN, flags)
}

/// Reads a spectrum from Parquet.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Checksum`], [`DatasetError::Parquet`],
/// [`DatasetError::Column`].
pub fn read_spectrum_parquet(path: &Path) -> Result<Vec<ImpedancePoint>, DatasetError> {
    rows::read_parquet(path)
}

/// Writes a time series as Parquet, [`SERIES_COLUMNS`].
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Parquet`].
pub fn write_series_parquet(path: &Path, series: &[SeriesRow]) -> Result<(), DatasetError> {
    rows::write_parquet(path, series)
}

/// Writes any columns as Parquet; all must have the same length.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Parquet`].
pub fn write_columns_parquet(
    path: &Path,
    columns: &[(ColumnSpec, &[f64])],
) -> Result<(), DatasetError> {
    rows::write_columns(path, columns)
}

/// Reads a time series from Parquet.
///
/// # Errors
/// [`DatasetError::Io`], [`DatasetError::Checksum`], [`DatasetError::Parquet`],
/// [`DatasetError::Column`].
pub fn read_series_parquet(path: &Path) -> Result<Vec<SeriesRow>, DatasetError> {
    rows::read_parquet(path)
}
