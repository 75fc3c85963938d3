//! Reads the files of a data set's runs; errors contain their location.

use std::{
    collections::HashMap,
    ops::Range,
    path::{Path, PathBuf},
};

use analysis::{
    contract::CommonModeImpedance,
    dataset::TRACE_COLUMNS,
    diagnosis::{Harmonic, Sweep, SweepPoint},
    formats::{
        CurrentSign, FormatError, LeftOut, ReadSeries, SeriesOptions, SeriesReadError, read_record,
        read_sourced,
    },
    run_folder::SweepHarmonic,
    series::TimeSeries,
    spectrum::{SourcedSpectrum, Spectrum},
    table::{Hash, Row, Table},
};

/// A run whose file exists but cannot be a measurement.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("run {run:?}: {text}")]
pub struct DataSetProblem {
    /// Name of the run.
    pub run: String,
    /// Error in the file, with its name and the place in it.
    pub text: String,
}

/// Why a file gave nothing.
#[derive(Debug)]
pub(super) enum FileError {
    /// The user can mend it in `dataset.toml`: no such file, no known format, no direction.
    Usage(String),
    /// The content is damaged.
    Damaged(String),
}

/// Reads files and caches each series, because a long one may serve many runs.
#[derive(Debug, Default)]
pub(super) struct Files {
    series: HashMap<(PathBuf, Option<Sign>), (TimeSeries, Vec<LeftOut>)>,
    /// Remarks on how they were read.
    pub(super) notes: Vec<String>,
}

/// A hashable [`CurrentSign`]: true for discharge.
type Sign = bool;

impl Files {
    /// The series of a file, discharge positive, and its rows without a number.
    pub(super) fn series(
        &mut self,
        path: &Path,
        sign: Option<CurrentSign>,
    ) -> Result<&(TimeSeries, Vec<LeftOut>), FileError> {
        let key = (
            path.to_owned(),
            sign.map(|sign| sign == CurrentSign::Discharge),
        );
        match self.series.entry(key) {
            std::collections::hash_map::Entry::Occupied(known) => Ok(known.into_mut()),
            std::collections::hash_map::Entry::Vacant(place) => {
                let read = read_record(path, &SeriesOptions { sign });
                let ReadSeries {
                    series,
                    left_out,
                    notes,
                    ..
                } = read.map_err(|error| series_error(&error))?;
                self.notes.extend(notes);
                Ok(place.insert((series, left_out)))
            }
        }
    }
}

/// All spectra of a file.
pub(super) fn spectra(path: &Path) -> Result<Vec<SourcedSpectrum>, FileError> {
    let spectra = read_sourced(path).map_err(|error| match error {
        FormatError::Read { .. }
        | FormatError::UnknownFormat { .. }
        | FormatError::Header { .. }
        | FormatError::Foreign { .. }
        | FormatError::Unit { .. } => FileError::Usage(error.to_string()),
        // Invalid rows, and errors that a later version may add.
        _ => FileError::Damaged(error.to_string()),
    })?;
    for one in &spectra {
        one.spectrum
            .validate()
            .map_err(|error| FileError::Damaged(format!("{}: {error}", path.display())))?;
    }
    Ok(spectra)
}

/// A spectrum as a sweep at this bias, A, discharge positive.
pub(super) fn sweep(spectrum: &Spectrum, bias_a: f64, amplitude_a: Option<f64>) -> Sweep {
    let points = spectrum.points.iter().map(|point| {
        let sigma = (point.covariance.re_re.sqrt(), point.covariance.im_im.sqrt());
        SweepPoint {
            freq_hz: point.freq_hz,
            z_ohm: point.z_ohm,
            // A sigma of zero would give infinite weight, so it counts as missing.
            sigma_ohm: Some(sigma).filter(|(re, im)| *re > 0.0 && *im > 0.0),
            amplitude_a: Some(point.amplitude_a)
                .filter(|a| a.is_finite())
                .or(amplitude_a),
        }
    });
    Sweep {
        bias_a,
        common_mode: CommonModeImpedance::default(),
        elapsed_s: Vec::new(),
        charge_coulomb: Vec::new(),
        harmonics: Vec::new(),
        points: points.collect(),
    }
}

/// Returns the second and third harmonics of a sweep, by its number; without those that state no
/// uncertainty or no amplitude. `bias_a` is its direct current, charge positive.
///
/// # Errors
/// Text if the sweep of this number has another direct current.
pub(super) fn harmonics(
    rows: &[SweepHarmonic],
    number: usize,
    bias_a: f64,
) -> Result<Vec<Harmonic>, String> {
    let own = || rows.iter().filter(|row| row.sweep == number);
    if let Some(odd) = own().find(|row| (row.bias_a - bias_a).abs() > SAME_BIAS_A) {
        return Err(format!(
            "sweep {number}: expected harmonics under a direct current of {bias_a} A, found {} A",
            odd.bias_a
        ));
    }
    let harmonic = |row: &SweepHarmonic| {
        let point = &row.point;
        // V/Aᵏ → Ω.
        let scale = point.amplitude_a.powi(point.order as i32 - 1);
        Harmonic {
            freq_hz: point.freq_hz,
            order: point.order,
            z_ohm: point.z * scale,
            sigma_ohm: (
                scale * point.covariance.re_re.sqrt(),
                scale * point.covariance.im_im.sqrt(),
            ),
            amplitude_a: point.amplitude_a,
        }
    };
    let is_known = |h: &Harmonic| h.amplitude_a > 0.0 && h.sigma_ohm.0 > 0.0 && h.sigma_ohm.1 > 0.0;
    Ok(own()
        .filter(|row| matches!(row.point.order, 2 | 3))
        .map(harmonic)
        .filter(is_known)
        .collect())
}

/// Greatest difference of two direct currents that count as one, A.
const SAME_BIAS_A: f64 = 1e-6;

/// Column of a record in time that states the standard deviation of each voltage.
pub(super) const SIGMA_COLUMN: &str = "Voltage Standard Deviation / V";

/// Columns of a record in time that state from when to when each sample is a mean.
pub(super) const WINDOW_COLUMNS: [&str; 2] = [TRACE_COLUMNS[5].name, TRACE_COLUMNS[6].name];

/// Returns the numbers of an additional column of a table with this number of samples, or `None`
/// if the table does not have the column.
pub(super) fn column(
    path: &Path,
    name: &str,
    samples: usize,
    fits: fn(&f64) -> bool,
) -> Result<Option<Vec<f64>>, FileError> {
    if path.extension().is_none_or(|extension| extension != "csv") {
        return Ok(None);
    }
    let table =
        Table::read(path, Hash::Comment).map_err(|error| FileError::Usage(error.to_string()))?;
    let Some(place) = table.column(name) else {
        return Ok(None);
    };
    let value = |row: &Row| row.number(place).filter(fits);
    let values: Option<Vec<f64>> = table.rows.iter().map(value).collect();
    let expected = || {
        format!(
            "{}: expected a number that can be in column {name:?} of each of {samples} samples",
            path.display()
        )
    };
    values
        .filter(|values| values.len() == samples)
        .map(Some)
        .ok_or_else(|| FileError::Damaged(expected()))
}

/// Returns the samples of a series between two times, s, or `None` if there are fewer than two.
pub(super) fn window(series: &TimeSeries, from_s: f64, to_s: f64) -> Option<Range<usize>> {
    let first = series.time_s.partition_point(|t| *t < from_s);
    let last = series.time_s.partition_point(|t| *t <= to_s);
    (last >= first + 2).then_some(first..last)
}

/// A part of a series, with its first sample at time zero.
pub(super) fn part(series: &TimeSeries, window: Range<usize>) -> TimeSeries {
    let start_s = series.time_s[window.start];
    let part = |all: &[f64]| all[window.clone()].to_vec();
    TimeSeries {
        name: series.name.clone(),
        time_s: series.time_s[window.clone()]
            .iter()
            .map(|t| t - start_s)
            .collect(),
        current_a: part(&series.current_a),
        voltage_v: part(&series.voltage_v),
        temperature_degc: series.temperature_degc.as_deref().map(part),
    }
}

fn series_error(error: &SeriesReadError) -> FileError {
    let text = error.to_string();
    match error {
        SeriesReadError::Read { .. }
        | SeriesReadError::Sign { .. }
        | SeriesReadError::Contradiction { .. } => FileError::Usage(text),
        // No line at all is a file that was cut off; a line of other columns is the wrong file.
        SeriesReadError::UnknownFormat { place, .. } if !place.is_empty() => FileError::Usage(text),
        SeriesReadError::Text(FormatError::Read { .. }) => FileError::Usage(text),
        SeriesReadError::Order { .. } => FileError::Damaged(format!("its times go back: {text}")),
        _ => FileError::Damaged(text),
    }
}
