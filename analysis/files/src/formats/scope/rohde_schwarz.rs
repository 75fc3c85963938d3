//! Rohde & Schwarz RTO and RTE in CSV: a pair of `X.csv` with settings, `Name:Value:` in each line,
//! and `X.Wfm.csv` with a row of numbers for each sample. RTB and RTM write one table with names (`in
//! s,C1 in V`), which the table reader reads.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use super::table;
use super::{ScopeError, ScopeRecord};

const KIND: &str = "Rohde & Schwarz CSV";
/// Suffix of the name of the file with the samples.
const SAMPLES: &str = ".wfm.csv";
/// Maximum size of the settings file.
const MOST_SETTINGS: u64 = 1 << 20;

/// Both files of a record.
#[derive(Debug, PartialEq)]
pub(super) struct Pair {
    settings: PathBuf,
    samples: PathBuf,
}

/// Returns both files from the name of either; `None` if only one exists.
pub(super) fn pair(path: &Path) -> Option<Pair> {
    let name = path.file_name()?.to_str()?;
    // The compared part of the names is ASCII, so that the lengths agree.
    let lower = name.to_ascii_lowercase();
    let found = match lower.strip_suffix(SAMPLES) {
        Some(stem) => {
            let stem = name.get(..stem.len())?;
            let settings = [".csv", ".CSV"].map(|end| path.with_file_name(format!("{stem}{end}")));
            Pair {
                settings: settings.into_iter().find(|file| file.is_file())?,
                samples: path.to_owned(),
            }
        }
        None => {
            let stem = name.get(..lower.strip_suffix(".csv")?.len())?;
            let ends = [".Wfm.csv", ".wfm.csv", ".WFM.CSV"];
            let samples = ends.map(|end| path.with_file_name(format!("{stem}{end}")));
            Pair {
                settings: path.to_owned(),
                samples: samples.into_iter().find(|file| file.is_file())?,
            }
        }
    };
    Some(found)
}

/// Settings by name, with their values.
struct Settings {
    path: PathBuf,
    lines: Vec<Vec<String>>,
}

impl Settings {
    fn read(path: &Path) -> Result<Self, ScopeError> {
        let io = |source| ScopeError::Io {
            file: path.to_owned(),
            action: "read it as text",
            source,
        };
        let mut bytes = Vec::new();
        let file = File::open(path).map_err(io)?;
        file.take(MOST_SETTINGS)
            .read_to_end(&mut bytes)
            .map_err(io)?;
        let text = String::from_utf8_lossy(&bytes);
        let fields = |line: &str| {
            let line = line.trim().trim_end_matches(':');
            line.split(':')
                .map(|field| field.trim().to_owned())
                .collect()
        };
        Ok(Self {
            path: path.to_owned(),
            lines: text
                .trim_start_matches('\u{feff}')
                .lines()
                .map(fields)
                .collect(),
        })
    }

    fn all(&self, name: &str) -> &[String] {
        let found = self
            .lines
            .iter()
            .find(|line| line.first().is_some_and(|first| first == name));
        found.map_or(&[], |line| &line[1..])
    }

    fn one(&self, name: &str) -> Option<&str> {
        self.all(name).first().map(String::as_str)
    }

    fn wrong(&self, field: &'static str, expected: &str, met: &str) -> ScopeError {
        ScopeError::about(&self.path, KIND)(field, expected, met.to_owned())
    }

    /// Names and units of the channels in the file.
    fn sources(&self) -> Vec<(String, String)> {
        let on = |state: &String| state.eq_ignore_ascii_case("on");
        if !self.all("MultiChannelExport").first().is_some_and(on) {
            let name = self.one("Source").unwrap_or("Ch1");
            let unit = self.one("ViewUnit").or(self.one("BaseUnit")).unwrap_or("V");
            return vec![(name.to_owned(), unit.to_owned())];
        }
        let units = self.all("MultiChannelViewUnit");
        let states = self.all("MultiChannelExportState").iter().enumerate();
        states
            .filter(|(_, state)| on(state))
            .filter_map(|(k, _)| {
                let name = self.all("MultiChannelSource").get(k)?.clone();
                let unit = units.get(k).map_or("V", String::as_str);
                Some((name, unit.to_owned()))
            })
            .collect()
    }
}

/// Opens a pair.
pub(super) fn open(pair: &Pair) -> Result<ScopeRecord, ScopeError> {
    let settings = Settings::read(&pair.settings)?;
    let interval_s = settings
        .one("Resolution")
        .and_then(|field| field.parse().ok());
    let interval_s =
        interval_s.filter(|interval_s: &f64| *interval_s > 0.0 && interval_s.is_finite());
    let Some(interval_s) = interval_s else {
        let met = settings.one("Resolution").unwrap_or("none");
        return Err(settings.wrong("Resolution", "the time between two samples, s", met));
    };
    if let Some(count) = settings
        .one("NumberOfAcquisitions")
        .filter(|count| *count != "1")
    {
        return Err(settings.wrong("NumberOfAcquisitions", "1", count));
    }
    let sources = settings.sources();
    if let Some((name, unit)) = sources.iter().find(|(_, unit)| unit != "V" && unit != "A") {
        return Err(settings.wrong("unit", "V or A", &format!("{unit} of {name}")));
    }
    let mut record = table::open(&pair.samples, Some(interval_s))?;
    let width = record.names.len();
    // With times, a row has one more number.
    if width == sources.len() + 1 {
        record.raw.channels.remove(0);
    } else if width != sources.len() {
        let met = format!("{width} in a row of {}", pair.samples.display());
        return Err(settings.wrong("channels", &sources.len().to_string(), &met));
    }
    let announced = settings
        .one("SignalRecordLength")
        .or(settings.one("RecordLength"));
    if let Some(announced) = announced.filter(|count| count.parse() != Ok(record.samples)) {
        let met = format!("{} rows of {}", record.samples, pair.samples.display());
        return Err(settings.wrong("RecordLength", announced, &met));
    }
    record.kind = KIND;
    record.names = sources.into_iter().map(|(name, _)| name).collect();
    Ok(record)
}
