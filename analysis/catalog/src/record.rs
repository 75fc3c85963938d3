//! Facts of a run folder, as the catalogue holds it.

use serde::{Deserialize, Serialize};

/// Reliability of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum CatalogVerdict {
    /// Finished; no point was refused.
    Good,
    /// Finished, with refused points or a missed state of charge.
    Doubtful,
    /// A person stopped it before it finished.
    Stopped,
    /// Ended early for another reason.
    Failed,
    /// Its journal has no end entry: the run is in progress, or its process has died.
    Unfinished,
    /// A file of its folder cannot be read.
    Damaged,
}

impl CatalogVerdict {
    /// Every verdict.
    pub const ALL: [Self; 6] = [
        Self::Good,
        Self::Doubtful,
        Self::Stopped,
        Self::Failed,
        Self::Unfinished,
        Self::Damaged,
    ];

    /// Returns its keyword in tables and replies.
    pub fn label(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Doubtful => "doubtful",
            Self::Stopped => "stopped",
            Self::Failed => "failed",
            Self::Unfinished => "unfinished",
            Self::Damaged => "damaged",
        }
    }

    /// Returns the verdict of a keyword.
    pub fn of_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|one| one.label() == word)
    }
}

/// Source of the time of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TimeSource {
    /// The manifest states when the run began.
    Clock,
    /// The run was in virtual time, which has no calendar; the time of its file is used instead.
    File,
}

impl TimeSource {
    /// Returns its keyword in tables.
    pub(crate) fn label(self) -> &'static str {
        match self {
            Self::Clock => "clock",
            Self::File => "file",
        }
    }

    /// Returns the source of a keyword.
    pub(crate) fn of_word(word: &str) -> Self {
        match word {
            "clock" => Self::Clock,
            _ => Self::File,
        }
    }
}

/// A cell of a run.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CatalogCell {
    /// Its name: that of the specimen in a campaign, otherwise that of the file of the cell.
    pub name: String,
    /// Its serial number, if the experiment states it.
    pub serial: Option<String>,
    /// Serial number that a person read from the cell when it was put into the jig.
    pub scanned_serial: Option<String>,
    /// Name of the file of the cell, which is the type if specimens have names of their own.
    pub model: Option<String>,
    /// Batch that it was made in.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<String>,
    /// Barcode on the cell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub barcode: Option<String>,
    /// Maker.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub maker: Option<String>,
    /// Chemistry, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chemistry: Option<String>,
    /// Term of a vocabulary, such as BattINFO, for its kind.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub term: Option<String>,
}

impl CatalogCell {
    /// Returns its serial number, from the experiment or otherwise as a person read it. The barcode
    /// printed on it, which a person may read instead, does not count.
    pub(crate) fn any_serial(&self) -> Option<String> {
        let scanned = self.scanned_serial.as_ref();
        let scanned = scanned.filter(|scanned| self.barcode.as_ref() != Some(scanned));
        self.serial.clone().or_else(|| scanned.cloned())
    }
}

/// A run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CatalogRun {
    /// Its identity: the first 16 digits of the SHA-256 of its folder's absolute path.
    pub run: String,
    /// Name of its folder.
    pub name: String,
    /// The folder.
    pub folder: String,
    /// True if the last scan did not find the folder.
    pub missing: bool,
    /// Version of the program that measured.
    pub version: String,
    /// The experiment.
    pub experiment: String,
    /// The bench.
    pub bench: String,
    /// The cells.
    pub cells: Vec<CatalogCell>,
    /// Person who submitted it or answered its questions; null if unnamed.
    pub operator: Option<String>,
    /// Tags that people gave it on a server.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub tags: Vec<String>,
    /// Number of notes that people wrote about it on a server.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub notes: u32,
    /// Seed of simulation and searches.
    pub seed: u64,
    /// Course of bench time.
    pub time: String,
    /// True if the bench was simulated.
    pub simulated: bool,
    /// Time of its start, s since 1970.
    pub started_unix_s: f64,
    /// Source of that time.
    pub time_source: TimeSource,
    /// Bench time of its last manifest, s.
    pub bench_time_s: f64,
    /// How it ended, in words; null if its journal has no end entry.
    pub how: Option<String>,
    /// The same as a keyword.
    pub verdict: CatalogVerdict,
    /// Message of the interlock that ended it; null if it did not trip.
    pub trip: Option<String>,
    /// Number of times it was resumed.
    pub resumed: u32,
    /// Number of its corrected spectra of a cell.
    pub spectra: u32,
    /// Number of points that its quality gate refused.
    pub refused_points: u32,
    /// Number of its fitted models.
    pub fits: u32,
    /// Map that it has fitted, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<CatalogMap>,
    /// SHA-256 of its configuration.
    pub config_sha256: Option<String>,
    /// SHA-256 of its list of hashes, which identifies the content of the folder; null before the
    /// list is written.
    pub content_sha256: Option<String>,
    /// Files that cannot be read, with the reason.
    pub damage: Vec<String>,
}

#[expect(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_zero(number: &u32) -> bool {
    *number == 0
}

/// A map of a cell that a run has fitted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CatalogMap {
    /// Lowest state of charge, 0 to 1.
    pub soc_low: f64,
    /// Highest state of charge, 0 to 1.
    pub soc_high: f64,
    /// Lowest temperature, °C.
    #[serde(rename = "temperature_low_c")]
    pub temperature_low_degc: f64,
    /// Highest temperature, °C.
    #[serde(rename = "temperature_high_c")]
    pub temperature_high_degc: f64,
    /// Largest error of the voltage on a log, rms, on pieces that are left out of the fit, mV; null
    /// without logs.
    pub left_out_mv: Option<f64>,
}

/// A spectrum of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CatalogSpectrum {
    /// Identity of the run.
    pub run: String,
    /// Name of its folder.
    pub name: String,
    /// File in the run folder.
    pub file: String,
    /// The bench.
    pub bench: String,
    /// The cell.
    pub cell: String,
    /// Serial number of the cell, if known.
    pub serial: Option<String>,
    /// Batch of the cell, if known.
    pub batch: Option<String>,
    /// Chemistry of the cell, in words, if known.
    pub chemistry: Option<String>,
    /// Fixture in the jig: `cell`, or the control.
    pub fixture: String,
    /// True if the harness is corrected.
    pub corrected: bool,
    /// Number of the repeat, from 1.
    pub repeat: u32,
    /// Time of its start, s since 1970.
    pub started_unix_s: f64,
    /// Source of that time.
    pub time_source: TimeSource,
    /// Amplitude of the current as commanded, A.
    pub amplitude_a: f64,
    /// Direct current under the sinusoids as commanded, A; 0 at rest.
    pub bias_a: f64,
    /// Voltage at rest before it, V.
    pub ocv_v: Option<f64>,
    /// Temperature of the cell's surface, °C.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
    /// Number of its points.
    pub points: u32,
    /// Number of points that the quality gate refused.
    pub refused_points: u32,
    /// Lowest frequency, Hz.
    pub low_hz: Option<f64>,
    /// Highest frequency, Hz.
    pub high_hz: Option<f64>,
    /// Real part where the imaginary part changes its sign, otherwise at the highest frequency, Ω.
    pub r_high_ohm: Option<f64>,
    /// Frequency at which that holds, Hz.
    pub r_high_hz: Option<f64>,
    /// Its standard uncertainty, Ω.
    pub r_high_sigma_ohm: Option<f64>,
    /// Real part at the lowest frequency, Ω.
    pub r_low_ohm: Option<f64>,
    /// Its standard uncertainty, Ω.
    pub r_low_sigma_ohm: Option<f64>,
}

/// A fitted model of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CatalogFit {
    /// Identity of the run.
    pub run: String,
    /// Name of its folder.
    pub name: String,
    /// File in the run folder.
    pub file: String,
    /// The bench.
    pub bench: String,
    /// The cell; the type of the cells if the model is that of several.
    pub cell: String,
    /// Serial number of the cell, if known.
    pub serial: Option<String>,
    /// Batch of the cell, if known.
    pub batch: Option<String>,
    /// Number of cells whose spectra were fitted together; a model of several does not belong to
    /// one.
    pub cells: u32,
    /// Number of RC pairs.
    pub rc: u32,
    /// Time of the run's start, s since 1970.
    pub started_unix_s: f64,
    /// Source of that time.
    pub time_source: TimeSource,
    /// Temperature of the cell's surface before its first spectrum, °C.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
    /// Voltage at rest before its first spectrum, V.
    pub ocv_v: Option<f64>,
    /// Series resistance, Ω.
    pub r_ohm: f64,
    /// Its standard uncertainty, Ω.
    pub r_sigma_ohm: Option<f64>,
    /// Resistance at zero frequency, Ω.
    pub dc_resistance_ohm: f64,
    /// Its standard uncertainty, Ω.
    pub dc_resistance_sigma_ohm: Option<f64>,
    /// Resistance of the slowest RC pair, in which diffusion shows first, Ω.
    pub slow_r_ohm: Option<f64>,
    /// Its standard uncertainty, Ω.
    pub slow_r_sigma_ohm: Option<f64>,
    /// Time constant of that pair, s.
    pub slow_tau_s: Option<f64>,
    /// Its standard uncertainty, s.
    pub slow_tau_sigma_s: Option<f64>,
    /// Time constants of all pairs, s.
    pub time_constants_s: Vec<f64>,
    /// Root mean square of the residual of the model, Ω.
    pub rms_ohm: f64,
    /// χ² per degree of freedom.
    pub reduced_chi2: Option<f64>,
    /// Number of points fitted.
    pub points: u32,
}

/// Kind of an event that the catalogue keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "kebab-case")]
pub enum CatalogEventKind {
    /// The interlock ended the run.
    Trip,
    /// The run continued after its process had ended.
    Resumed,
    /// A person confirmed a change of the fixture.
    Answered,
    /// The run ended.
    Ended,
}

impl CatalogEventKind {
    /// Returns its keyword in tables and replies.
    pub fn label(self) -> &'static str {
        match self {
            Self::Trip => "trip",
            Self::Resumed => "resumed",
            Self::Answered => "answered",
            Self::Ended => "ended",
        }
    }

    /// Returns the kind of a keyword.
    pub(crate) fn of_word(word: &str) -> Self {
        match word {
            "trip" => Self::Trip,
            "resumed" => Self::Resumed,
            "answered" => Self::Answered,
            _ => Self::Ended,
        }
    }
}

/// An event of a run: an action of a person, or its end.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CatalogEvent {
    /// Number of its line in the journal.
    pub line: u64,
    /// Bench time, s.
    pub time_s: f64,
    /// Its kind.
    pub kind: CatalogEventKind,
    /// Text of the event.
    pub text: String,
    /// Person who acted; null if unnamed.
    pub by: Option<String>,
}

/// A diagnosis of a run or of a data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CatalogDiagnosis {
    /// Its folder.
    pub folder: String,
    /// Identity of the run that it belongs to; null if it is unknown.
    pub run: Option<String>,
    /// Cell of that run; null if the run has several cells and the diagnosis belongs to none of
    /// them.
    pub cell: Option<String>,
    /// Name of the data set.
    pub data_set: String,
    /// Name of the model.
    pub model: String,
    /// The verdict, as the file has it.
    pub verdict: String,
    /// The verdict in words.
    pub summary: String,
    /// Parameters of the effects that it names.
    pub parameters: Vec<CatalogParameter>,
    /// Reason why it cannot be read; null if it can.
    pub damage: Option<String>,
}

/// A parameter of an effect that a diagnosis names.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct CatalogParameter {
    /// Name of the effect.
    pub effect: String,
    /// Name of the parameter, with its unit.
    pub name: String,
    /// Its value, in its unit.
    pub value: f64,
    /// Its standard uncertainty, in the same unit.
    pub sigma: Option<f64>,
    /// The unit.
    pub unit: String,
}

/// Everything that is read from a run folder.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Folder {
    /// The run.
    pub(crate) run: CatalogRun,
    /// State of its files, for the next scan.
    pub(crate) stamp: String,
    /// Texts of the notes about the run.
    pub(crate) notes: Vec<String>,
    /// Identities of the instruments, as the manifest has them.
    pub(crate) instruments: serde_json::Value,
    /// Its spectra.
    pub(crate) spectra: Vec<CatalogSpectrum>,
    /// Its fits.
    pub(crate) fits: Vec<CatalogFit>,
    /// Its events.
    pub(crate) events: Vec<CatalogEvent>,
}
