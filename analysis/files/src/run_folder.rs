//! Names of the files of a run folder, their columns and the versions of their schemas. All other
//! modules take them from here.
//!
//! The tables of numbers have their columns in [`crate::dataset`], which reads and writes them.

pub mod archive_status;
mod archived;
mod bath;
mod envelope;
mod events;
mod harmonics;
mod map_points;
mod readings;
pub mod sums;

use std::path::Path;

pub use analysis_fit::fit::{MODEL_SCHEMA, MODEL_SCHEMA_VERSION, PROGRAM};
pub use archived::{
    ARCHIVED_SCHEMA, ARCHIVED_SCHEMA_VERSION, Archived, ArchivedFile, moved_captures,
};
pub use bath::{BATH_COLUMNS, BathRow};
pub use envelope::{Between, ENVELOPE_COLUMNS, EnvelopeRow};
pub use events::{EVENT_COLUMNS, Event, EventRow, OUTPUT_ON};
pub use harmonics::{HARMONIC_COLUMNS, SweepHarmonic, harmonics_csv, read_harmonics};
pub use map_points::{
    MAP_POINT_COLUMNS, MapPoint, MapPointsError, map_points_csv, read_map_points,
};
pub use readings::{READING_COLUMNS, ReadingRow};

/// Intentions and actions of the run, line by line.
pub const JOURNAL: &str = "journal.jsonl";
/// Where a torn last line of the journal is kept.
pub const TORN_JOURNAL: &str = "journal.torn";
/// Version, hashes, seed, and the instruments that answered.
pub const MANIFEST: &str = "manifest.json";
/// Events of the run, [`EVENT_COLUMNS`].
pub const EVENTS: &str = "events.csv";
/// Raw readings of the instruments, [`READING_COLUMNS`].
pub const READINGS: &str = "readings.csv";
/// The same at the end of the run, with all digits.
pub const READINGS_PARQUET: &str = "readings.parquet";
/// Readings of the chiller and its setpoints, [`BATH_COLUMNS`].
pub const BATH: &str = "bath.csv";
/// Bounds of the readings in each step, [`ENVELOPE_COLUMNS`].
pub const ENVELOPE: &str = "envelope.csv";
/// The log.
pub const LOG: &str = "log.txt";
/// Run control request of a person for a run in progress.
pub const RUN_CONTROL: &str = "wishes.json";
/// Answer of a person to a question of a run in progress.
pub const ANSWER: &str = "answer.json";
/// Which sweeps and traces there are ([`crate::dataset::RunIndex`]).
pub const INDEX: &str = "traces.json";
/// The hashes of all other files.
pub const SUMS: &str = "SHA256SUMS";
/// Captures that were moved to an archive ([`Archived`]).
pub const ARCHIVED: &str = "archived.json";
/// The report.
pub const REPORT: &str = "report.html";
/// Verdict and numbers of a diagnosis, in a folder of its own.
pub const DIAGNOSIS: &str = "diagnosis.json";
/// The correction by the controls.
pub const CORRECTION: &str = "correction.json";
/// Results of the controls.
pub const CONTROLS: &str = "controls.json";
/// The faults that were injected into simulated instruments.
pub const FAULTS: &str = "faults.json";
/// The first spectrum of the cell, corrected.
pub const SPECTRUM: &str = "spectrum.csv";
/// The same as Parquet.
pub const SPECTRUM_PARQUET: &str = "spectrum.parquet";
/// Where the uncertainty comes from.
pub const BUDGET: &str = "budget.csv";
/// The same as JSON.
pub const BUDGET_JSON: &str = "budget.json";
/// Mean and spread of a campaign's cells, [`SPREAD_COLUMNS`].
pub const SPREAD: &str = "spread.csv";
/// The runs and models of a campaign.
pub const CAMPAIGN: &str = "campaign.json";
/// The open-circuit voltage over the state of charge, [`OCV_COLUMNS`].
pub const OCV: &str = "ocv.csv";
/// The same as a curve that other commands read.
pub const OCV_CURVE: &str = "ocv.json";
/// How the open-circuit voltage was found.
pub const OCV_FOUND: &str = "ocv_found.json";
/// The readings of the discharge.
pub const OCV_DISCHARGE: &str = "ocv_discharge.bdf.csv";
/// The readings of the charge.
pub const OCV_CHARGE: &str = "ocv_charge.bdf.csv";
/// The points of a map, [`MAP_POINT_COLUMNS`].
pub const MAP_POINTS: &str = "map_points.csv";
/// The map of a cell, a model.
pub const MAP: &str = "map.json";
/// Its errors on logs, [`MAP_LOG_COLUMNS`].
pub const MAP_LOGS: &str = "map_logs.csv";
/// Its errors on spectra, [`MAP_SPECTRUM_COLUMNS`].
pub const MAP_SPECTRA: &str = "map_spectra.csv";
/// The choice of the order of the models.
pub const ORDER: &str = "order.json";
/// The one model of a command that fits one order.
pub const MODEL: &str = "model.json";

/// Prefix of the end in the journal of a run that did not finish.
pub const ENDED_EARLY: &str = "ended early: ";

/// Returns whether a person stopped a run that ended in this way, by its journal or the message of
/// its process.
///
/// ```
/// use analysis_files::run_folder::is_stopped;
/// assert!(is_stopped("ended early: ended on request; `eis-bench resume` goes on"));
/// assert!(!is_stopped("ended early: interlock: cell voltage 4.3 V"));
/// ```
pub fn is_stopped(how: &str) -> bool {
    let cause = how.strip_prefix(ENDED_EARLY).unwrap_or(how);
    ["stopped on request", "ended on request"]
        .iter()
        .any(|words| cause.starts_with(words))
}

/// Folder of the copies of the files that were read.
pub const CONFIG: &str = "config";
/// Folder of raw ADC codes.
pub const CAPTURES: &str = "captures";
/// Folder of figures.
pub const PLOTS: &str = "plots";
/// Folder of the conversations with the instruments.
pub const TRANSCRIPTS: &str = "transcripts";
/// Folder of the spectra of a campaign.
pub const SPECTRA: &str = "spectra";
/// Folder of spectra with the errors that points share.
pub const SHARED: &str = "shared";

/// Frame of the zeros among the captures of a trace.
pub const ZERO_FRAME: &str = "zero";
/// Prefix of the names of files and folders that were recorded beside the sweeps.
pub const RECORDED: [&str; 4] = ["series_", "ocv_", "map_", CAPTURES];

/// Impedance, second and third harmonic of the cell in each sweep, [`HARMONIC_COLUMNS`].
pub const HARMONICS: &str = "harmonics.csv";
/// Their picture.
pub const HARMONICS_FIGURE: &str = "harmonics";
/// The impedance over frequency and charge along a charge or discharge, [`OPERANDO_COLUMNS`].
pub const OPERANDO: &str = "operando.csv";
/// Its picture.
pub const OPERANDO_FIGURE: &str = "operando";
/// Columns of [`OPERANDO`].
pub const OPERANDO_COLUMNS: &str = "number,charge_c,soc,bias_measured_a,temperature_c,freq_hz,\
    z_re_ohm,z_im_ohm,sigma_re_ohm,sigma_im_ohm,cov_re_im_ohm2";
/// Columns of the lines of a multisine.
pub const LINE_COLUMNS: &str = "freq_hz,noise,even,odd,sigma,images";
/// Columns of [`OCV`].
pub const OCV_COLUMNS: &str = "soc,ocv_v,docv_dsoc_v";
/// Columns of [`MAP_LOGS`].
pub const MAP_LOG_COLUMNS: &str = "log,role,temperature_degc,rms_mv,bias_mv,worst_soc,worst_mv,\
    left_out_rms_mv,in_band_percent";
/// Columns of [`MAP_SPECTRA`].
pub const MAP_SPECTRUM_COLUMNS: &str =
    "spectrum,role,soc,temperature_degc,error_percent,left_out_percent,expected_percent";
/// Columns of [`SPREAD`].
pub const SPREAD_COLUMNS: &str = "freq_hz,spectra,mean_re_ohm,mean_im_ohm,cells_re_ohm,\
    cells_im_ohm,repeats_re_ohm,repeats_im_ohm,cells_magnitude_rel,repeats_magnitude_rel,\
    stated_re_ohm,stated_im_ohm";

/// Name of the schema of [`CAMPAIGN`].
pub const CAMPAIGN_SCHEMA: &str = "eis-bench/campaign";

/// Unix time at bench time 0, s, from [`MANIFEST`]; absent in virtual time.
pub fn started_unix_s(folder: &Path) -> Option<f64> {
    manifest(folder)?.get("started_unix_s")?.as_f64()
}

/// The instruments of a run from [`MANIFEST`]: the identification of each, by role.
pub fn instruments(folder: &Path) -> Option<serde_json::Value> {
    manifest(folder)?.get("instruments").cloned()
}

fn manifest(folder: &Path) -> Option<serde_json::Value> {
    let text = std::fs::read_to_string(folder.join(MANIFEST)).ok()?;
    serde_json::from_str(&text).ok()
}

/// Returns the file name of the model with this number of RC pairs.
pub fn model(rc: usize) -> String {
    format!("model_{rc}rc.json")
}

/// Whether a file of this name is a model.
pub fn is_model(name: &str) -> bool {
    name.starts_with("model") && name.ends_with(".json")
}

/// The copy of a file that was read.
pub fn config_copy(name: &str) -> String {
    format!("{CONFIG}/{name}")
}

/// The conversation with the instrument of a role.
pub fn transcript(role: &str) -> String {
    format!("{TRANSCRIPTS}/{role}.txt")
}

/// The impedances of a sweep as read.
pub fn raw(sweep: &str) -> String {
    format!("raw_{sweep}.csv")
}

/// The same as Parquet.
pub fn raw_parquet(sweep: &str) -> String {
    format!("raw_{sweep}.parquet")
}

/// Whether a spectrum of this name is as read.
pub fn is_raw(name: &str) -> bool {
    name.contains("raw_")
}

/// Whether a file of this name, beside the journal, is a spectrum: corrected or as read.
pub fn is_spectrum(name: &str) -> bool {
    name.starts_with("spectrum") || name.starts_with("raw_")
}

/// The corrected spectrum of a repeat of the cell's sweep, by its number.
pub fn spectrum(repeat: usize) -> String {
    match repeat {
        0 | 1 => SPECTRUM.to_owned(),
        _ => format!("spectrum_{repeat}.csv"),
    }
}

/// The corrected spectrum of a control.
pub fn control_spectrum(sweep: &str) -> String {
    format!("spectrum_{sweep}.csv")
}

/// The corrected spectrum of a run of a campaign.
pub fn campaign_spectrum(run: &str) -> String {
    format!("{SPECTRA}/{run}.csv")
}

/// A spectrum with the errors that its points share, by the file of the spectrum.
pub fn shared_spectrum(file: &str) -> String {
    let own = file
        .strip_prefix(SPECTRA)
        .and_then(|rest| rest.strip_prefix('/'));
    format!("{SHARED}/{}", own.unwrap_or(file))
}

/// The files of a multisine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Multisine {
    /// The corrected spectrum.
    Spectrum,
    /// The same as Parquet.
    SpectrumParquet,
    /// The impedances as read.
    Raw,
    /// Noise and distortion at the lines, [`LINE_COLUMNS`].
    Lines,
    /// The full result as JSON.
    Whole,
}

impl Multisine {
    /// The file of a repeat, by its number from 1; the first has no number in its name.
    pub fn file(self, repeat: usize) -> String {
        let (name, ending) = match self {
            Self::Spectrum => ("multisine", "csv"),
            Self::SpectrumParquet => ("multisine", "parquet"),
            Self::Raw => ("raw_multisine", "csv"),
            Self::Lines => ("multisine_lines", "csv"),
            Self::Whole => ("multisine", "json"),
        };
        format!("{}.{ending}", numbered(name, repeat))
    }
}

/// Name of the figure of a repeat of a multisine.
pub fn multisine_figure(repeat: usize) -> String {
    numbered("multisine", repeat)
}

/// A name with the number of a repeat from the second on.
fn numbered(name: &str, repeat: usize) -> String {
    match repeat {
        1 => name.to_owned(),
        _ => format!("{name}_{repeat}"),
    }
}

/// The rows of a repeat of a trace.
pub fn series(trace: &str, repeat: usize) -> String {
    format!("series_{trace}_{repeat}.bdf.csv")
}

/// The readings of the full charge before a point of a map, by the number of the point.
pub fn map_charge(point: usize) -> String {
    format!("map_charge_{point}.bdf.csv")
}

/// The readings of the discharge to a point of a map, by its number.
pub fn map_discharge(point: usize) -> String {
    format!("map_discharge_{point}.bdf.csv")
}

/// Whether a file of this name holds the rows of a trace.
pub fn is_series(name: &str) -> bool {
    name.starts_with(RECORDED[0]) && name.ends_with(".bdf.csv")
}

/// A file of [`CAPTURES`], by its folder there and its name.
pub fn capture(folder: &str, name: &str) -> String {
    format!("{CAPTURES}/{folder}/{name}.parquet")
}

/// Folder of the captures of a repeat of a trace, and name of its figure.
pub fn trace_name(trace: &str, repeat: usize) -> String {
    format!("trace_{trace}_{repeat}")
}

/// Folder of the captures of a repeat of a multisine.
pub fn multisine_captures(repeat: usize) -> String {
    format!("multisine_{repeat}")
}

/// Name of the capture of a point, by its number in the sweep from 1 and the number of the attempt
/// from 0.
pub fn point_capture(number: usize, freq_hz: f64, attempt: usize) -> String {
    format!("point{number:02}_{freq_hz:.6}Hz{}", again(attempt))
}

/// Name of the capture of a band of a multisine, by the number of the attempt from 0.
pub fn band_capture(band: usize, attempt: usize) -> String {
    format!("band{band}{}", again(attempt))
}

/// Suffix of a name from the second attempt on.
fn again(attempt: usize) -> String {
    match attempt {
        0 => String::new(),
        _ => format!("_again{attempt}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_of_several_has_no_number() {
        let files = [1, 2].map(|repeat| Multisine::Lines.file(repeat));
        assert_eq!(files, ["multisine_lines.csv", "multisine_lines_2.csv"]);
        assert_eq!(
            [0, 1, 2].map(spectrum),
            ["spectrum.csv", "spectrum.csv", "spectrum_2.csv"]
        );
        let points = [0, 2].map(|attempt| point_capture(3, 0.5, attempt));
        assert_eq!(points, ["point03_0.500000Hz", "point03_0.500000Hz_again2"]);
    }

    #[test]
    fn shared_errors_stand_under_the_name_of_the_spectrum() {
        assert_eq!(
            ["spectra/a_1.csv", "spectrum.csv"].map(shared_spectrum),
            ["shared/a_1.csv", "shared/spectrum.csv"]
        );
    }
}
