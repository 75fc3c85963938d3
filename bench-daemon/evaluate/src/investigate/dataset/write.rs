//! A data set back into a folder: `dataset.toml` and a file per run, as the reader wants them.

use std::{fmt::Write, path::Path};

use analysis::{
    dataset::{self, DatasetError},
    diagnosis::{DataSet, Fixture, Run, RunData, Start, Sweep, TimeRecord},
    nonlinear::HarmonicPoint,
    numeric::Covariance2,
    run_folder::{SweepHarmonic, harmonics_csv},
};
use serde_json::{Value, json};

use super::{
    DATASET_FILE,
    files::{SIGMA_COLUMN, WINDOW_COLUMNS},
};

/// Why a data set could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The folder cannot be made.
    #[error("{path}: cannot be made: {source}", path = path.display())]
    Folder {
        /// The folder.
        path: std::path::PathBuf,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// A file cannot be written.
    #[error(transparent)]
    File(#[from] DatasetError),
}

/// Writes a data set into a folder, which is made if need be: time series as BDF CSV, spectra as
/// CSV, current positive for charge.
///
/// # Errors
/// `WriteError`.
pub fn write_dataset(folder: &Path, set: &DataSet) -> Result<(), WriteError> {
    std::fs::create_dir_all(folder).map_err(|source| WriteError::Folder {
        path: folder.to_owned(),
        source,
    })?;
    let mut listed = format!("name = {}\n", json!(set.name));
    listed.extend(
        set.history
            .as_ref()
            .and_then(|history| section("[bench]", &json!(history))),
    );
    listed.extend(
        set.calibration
            .as_ref()
            .and_then(|calibration| section("[calibration]", &json!(calibration))),
    );
    for (index, run) in set.runs.iter().enumerate() {
        let text = match &run.data {
            RunData::Time(record) => series_csv(record),
            RunData::Eis(sweep) => spectrum_csv(sweep),
        };
        let file = file_name(index, run);
        dataset::write_atomically(&folder.join(&file), text.as_bytes())?;
        let mut harmonics = None;
        if let RunData::Eis(sweep) = &run.data
            && !sweep.harmonics.is_empty()
        {
            let file = file.replace(".csv", "_harmonics.csv");
            let text = harmonics_csv(swept_harmonics(sweep));
            dataset::write_atomically(&folder.join(&file), text.as_bytes())?;
            harmonics = Some(file);
        }
        listed += &entry(run, &file, harmonics.as_deref());
    }
    Ok(dataset::write_atomically(
        &folder.join(DATASET_FILE),
        listed.as_bytes(),
    )?)
}

/// One `[[runs]]`. A JSON string or number is a TOML one too.
fn entry(run: &Run, file: &str, harmonics: Option<&str>) -> String {
    let (fixture, resistance) = match &run.fixture {
        Fixture::Cell(name) => ("cell", ("cell", json!(name))),
        Fixture::Shunt(ohm) => ("shunt", ("fixture_ohm", json!(ohm))),
        Fixture::FakeCell(ohm) => ("fake_cell", ("fixture_ohm", json!(ohm))),
    };
    let start = match run.start {
        Start::Soc(soc) => ("soc", json!(soc)),
        Start::Ocv(ocv_v) => ("ocv_v", json!(ocv_v)),
    };
    let (kind, of_kind) = match &run.data {
        RunData::Time(record) => {
            let mut fields = vec![
                ("current_between_samples", json!(record.between)),
                ("compare_from_s", json!(record.compared_from_s)),
            ];
            // None is said by leaving it out.
            fields.extend(
                (record.level_sigma_v > 0.0)
                    .then(|| ("level_sigma_v", json!(record.level_sigma_v))),
            );
            ("time", fields)
        }
        // −0 and 0 are one bias.
        RunData::Eis(sweep) => {
            let mut fields = vec![
                ("bias_a", json!(0.0 - sweep.bias_a)),
                ("below_ohm", json!(sweep.common_mode.r_ohm)),
                ("below_h", json!(sweep.common_mode.l_h)),
                ("elapsed_s", json!(sweep.elapsed_s)),
            ];
            let moved = &sweep.charge_coulomb;
            fields.extend((!moved.is_empty()).then(|| ("charge_c", json!(moved))));
            fields.extend(harmonics.map(|file| ("harmonics_file", json!(file))));
            ("eis", fields)
        }
    };
    let fields = [
        ("name", json!(run.name)),
        ("file", json!(file)),
        ("kind", json!(kind)),
        ("fixture", json!(fixture)),
        resistance,
        ("temperature_c", json!(run.temperature_degc)),
        start,
        ("repeat_group", json!(run.repeat_group)),
        ("order", json!(run.order)),
        ("start_s", json!(run.start_s)),
        ("role", json!(run.role)),
        ("current_positive", json!("charge")),
    ];
    table(
        "[[runs]]",
        fields
            .iter()
            .chain(&of_kind)
            .map(|(name, value)| (*name, value)),
    )
}

fn section(header: &str, fields: &Value) -> Option<String> {
    Some(table(
        header,
        fields
            .as_object()?
            .iter()
            .map(|(name, value)| (name.as_str(), value)),
    ))
}

fn table<'a>(header: &str, fields: impl Iterator<Item = (&'a str, &'a Value)>) -> String {
    let lines: String = fields
        .map(|(name, value)| format!("{name} = {value}\n"))
        .collect();
    format!("\n{header}\n{lines}")
}

/// A number makes it unique, the run's name readable.
fn file_name(index: usize, run: &Run) -> String {
    let plain: String = run
        .name
        .chars()
        .map(|c| {
            if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') {
                c
            } else {
                '_'
            }
        })
        .collect();
    let extension = match run.data {
        RunData::Time(_) => "bdf.csv",
        RunData::Eis(_) => "csv",
    };
    format!("{:02}_{plain}.{extension}", index + 1)
}

fn series_csv(record: &TimeRecord) -> String {
    let series = &record.series;
    let mut text = "Test Time / s,Current / A,Voltage / V".to_owned();
    if series.temperature_degc.is_some() {
        text += ",Surface Temperature T1 / degC";
    }
    if record.sigma_v.is_some() {
        let _ = write!(text, ",{SIGMA_COLUMN}");
    }
    if record.averaged_s.is_some() {
        let _ = write!(text, ",{},{}", WINDOW_COLUMNS[0], WINDOW_COLUMNS[1]);
    }
    text.push('\n');
    for k in 0..series.len() {
        // Writing into a string cannot fail.
        let _ = write!(
            text,
            "{},{},{}",
            series.time_s[k],
            0.0 - series.current_a[k],
            series.voltage_v[k]
        );
        if let Some(all) = &series.temperature_degc {
            let _ = write!(text, ",{}", all[k]);
        }
        if let Some(all) = &record.sigma_v {
            let _ = write!(text, ",{}", all[k]);
        }
        if let Some(all) = &record.averaged_s {
            let _ = write!(text, ",{},{}", all[k].0, all[k].1);
        }
        text.push('\n');
    }
    text
}

/// Harmonics in the units of their table, V/Aᵏ.
fn swept_harmonics(sweep: &Sweep) -> impl Iterator<Item = SweepHarmonic> {
    sweep.harmonics.iter().map(|h| {
        let scale = h.amplitude_a.powi(1 - h.order as i32);
        let (re, im) = h.sigma_ohm;
        SweepHarmonic {
            sweep: 1,
            bias_a: 0.0 - sweep.bias_a,
            point: HarmonicPoint {
                freq_hz: h.freq_hz,
                order: h.order,
                z: h.z_ohm * scale,
                covariance: Covariance2 {
                    re_re: (scale * re).powi(2),
                    im_im: (scale * im).powi(2),
                    re_im: 0.0,
                },
                amplitude_a: h.amplitude_a,
            },
        }
    })
}

fn spectrum_csv(sweep: &Sweep) -> String {
    let mut text = "freq_hz,z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,amplitude_a\n".to_owned();
    for point in &sweep.points {
        let (sigma_re, sigma_im) = point.sigma_ohm.unwrap_or((f64::NAN, f64::NAN));
        let amplitude_a = point.amplitude_a.unwrap_or(f64::NAN);
        let _ = writeln!(
            text,
            "{},{},{},{sigma_re},{sigma_im},{amplitude_a}",
            point.freq_hz, point.z_ohm.re, point.z_ohm.im
        );
    }
    text
}
