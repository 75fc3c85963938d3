//! Profiles from text: two columns, time and demand, with or without a header.
//!
//! Columns are separated by commas, semicolons, tabs or blanks. A header names the columns, with
//! the unit after an underscore, in brackets or after a slash: `time_s,power_w`, `time [s] power
//! [W]`, `Time / s, Current / A`. Lines that begin with `#` are comments. The names charge and
//! discharge define the sign of a column. A column beside a cycler's test time in seconds (`Test
//! Time / s`, `test_time_second`) is positive for charge, as in all such files. `load` is a
//! resistance only with a unit of resistance.

use super::{SeriesOptions, SeriesReadError, read_series};
use analysis_forward::forward::{Demand, Interpolation, Profile, ProfileError};
use std::path::{Path, PathBuf};

/// Suffix of the names of measured series.
const MEASURED: &str = ".bdf.csv";

/// Error of reading a profile.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileReadError {
    /// The file cannot be read.
    #[error("{}: expected to read a profile: {source}", file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The measured series is invalid.
    #[error(transparent)]
    Series(#[from] SeriesReadError),
    /// A line is malformed.
    #[error("{}, line {line}: expected {expected}, met {met}", file.display())]
    Line {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Allowed values, in words.
        expected: String,
        /// Value found.
        met: String,
    },
    /// The rows do not form a profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
}

/// Options for facts that a file may not state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReadOptions {
    /// Kind of the demand; `None`: from the header, or power without a header.
    pub demand: Option<Demand>,
    /// Interpolation between the rows.
    pub interpolation: Interpolation,
    /// Whether the file counts charge as positive: power and current then change their sign.
    pub charge_positive: bool,
}

/// Units and kind of demand, read from a header.
struct Header {
    time_factor: f64,
    demand: Demand,
    factor: f64,
    direction: Option<Direction>,
}

/// The sign convention from a header.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Direction {
    Charge,
    Discharge,
}

/// Reads a profile; its name is that of the file without the extension. For a measured series
/// (`.bdf.csv`), the profile is its current, or its power if requested.
///
/// # Errors
/// [`ProfileReadError`] with file and line.
pub fn read_profile(path: &Path, options: &ReadOptions) -> Result<Profile, ProfileReadError> {
    if path.to_string_lossy().ends_with(MEASURED) {
        return measured(path, options);
    }
    let bytes = std::fs::read(path).map_err(|source| ProfileReadError::Io {
        file: path.to_owned(),
        source,
    })?;
    let text = String::from_utf8_lossy(&bytes);
    let stem = path.file_stem().map_or_else(
        || "profile".to_owned(),
        |s| s.to_string_lossy().into_owned(),
    );
    parse_profile(path, &stem, text.trim_start_matches('\u{feff}'), options)
}

/// Returns the first row of a text without a header, with its line from 1; `parse` uses it as the
/// first row of the profile.
pub fn first_bare_row(text: &str) -> Option<(usize, &str)> {
    lines(text).next().filter(|(_, line)| is_row(line))
}

/// Returns the profile of the current or the power of a measured series.
fn measured(path: &Path, options: &ReadOptions) -> Result<Profile, ProfileReadError> {
    let series = read_series(path, &SeriesOptions::default())?;
    let demand = match options.demand {
        Some(Demand::Power) => Demand::Power,
        _ => Demand::Current,
    };
    let value = |(amps, volts): (&f64, &f64)| {
        if demand == Demand::Power {
            amps * volts
        } else {
            *amps
        }
    };
    let values = series.current_a.iter().zip(&series.voltage_v).map(value);
    let rows: Vec<(f64, f64)> = series.time_s.iter().copied().zip(values).collect();
    Ok(Profile::new(
        &series.name,
        demand,
        options.interpolation,
        &rows,
    )?)
}

/// Parses a profile from the text of a file; `path` is used in error messages.
///
/// ```
/// use analysis_files::formats::{ReadOptions, parse_profile};
/// use analysis_forward::forward::{Demand, Interpolation};
/// use std::path::Path;
///
/// // Half a minute at 200 W, then ten seconds of charging with 50 W.
/// let text = "time_s,power_w\n0,200\n30,-50\n40,0\n";
/// let (demand, interpolation, charge_positive) = (None, Interpolation::Hold, false);
/// let options = ReadOptions { demand, interpolation, charge_positive };
/// let profile = parse_profile(Path::new("drive.csv"), "drive", text, &options)?;
/// assert_eq!(profile.demand, Demand::Power);
/// assert_eq!(profile.duration_s(), 40.0);
/// assert_eq!(profile.peak(), Some(200.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`ProfileReadError`] with file and line.
pub fn parse_profile(
    path: &Path,
    name: &str,
    text: &str,
    options: &ReadOptions,
) -> Result<Profile, ProfileReadError> {
    let bad = |line: usize, expected: &str, met: &str| ProfileReadError::Line {
        file: path.to_owned(),
        line,
        expected: expected.to_owned(),
        met: if met.is_empty() {
            "nothing".to_owned()
        } else {
            format!("{:?}", met.chars().take(80).collect::<String>())
        },
    };
    let mut header = Header {
        time_factor: 1.0,
        demand: options.demand.unwrap_or(Demand::Power),
        factor: 1.0,
        direction: None,
    };
    let mut rows: Vec<(f64, f64)> = Vec::new();
    for (index, (line, content)) in lines(text).enumerate() {
        if index == 0 && !is_row(content) {
            header = Header::of(content, options.demand)
                .map_err(|expected| bad(line, &expected, content))?;
            if options.charge_positive && header.direction == Some(Direction::Discharge) {
                return Err(bad(
                    line,
                    "a column that counts charge as positive, as was asked for",
                    content,
                ));
            }
            continue;
        }
        let fields = split(content);
        let [time, value] = fields[..] else {
            return Err(bad(line, "two columns, time and demand", content));
        };
        let number = |field: &str, what: &str| -> Result<f64, ProfileReadError> {
            field
                .parse()
                .ok()
                .filter(|v: &f64| v.is_finite())
                .ok_or_else(|| bad(line, what, field))
        };
        let time_s = number(time, "a finite time")? * header.time_factor;
        let value = number(value, "a finite demand")? * header.factor;
        if rows.last().is_some_and(|(before, _)| time_s <= *before) {
            return Err(bad(line, "a time later than the row before", time));
        }
        if header.demand == Demand::Resistance && value <= 0.0 {
            return Err(bad(line, "a load resistance above 0 Ω", fields[1]));
        }
        rows.push((time_s, value));
    }
    if rows.len() < 2 {
        return Err(ProfileReadError::from(ProfileError::TooShort {
            name: path.display().to_string(),
            met: rows.len(),
        }));
    }
    let profile = Profile::new(name, header.demand, options.interpolation, &rows)?;
    let charge = options.charge_positive || header.direction == Some(Direction::Charge);
    Ok(if charge && header.demand != Demand::Resistance {
        Profile {
            negated: true,
            ..profile.scaled(-1.0)
        }
    } else {
        profile
    })
}

/// Returns the lines that are neither empty nor comments, with their numbers from 1.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(k, l)| (k + 1, l.trim()))
        .filter(|(_, l)| !l.is_empty() && !l.starts_with('#'))
}

/// A row begins with a number, a header does not.
fn is_row(line: &str) -> bool {
    line.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c))
}

/// Splits a line into fields without quotes, by the first separator that it contains; blanks are
/// tried last.
fn split(line: &str) -> Vec<&str> {
    let by = [',', ';', '\t'].into_iter().find(|c| line.contains(*c));
    let fields: Vec<&str> = match by {
        Some(by) => line.split(by).collect(),
        None => line.split_whitespace().collect(),
    };
    let mut fields: Vec<&str> = fields
        .into_iter()
        .map(|f| f.trim().trim_matches('"').trim())
        .collect();
    while fields.len() > 2 && fields.last().is_some_and(|f| f.is_empty()) {
        fields.pop();
    }
    fields
}

impl Header {
    fn of(line: &str, wanted: Option<Demand>) -> Result<Self, String> {
        let words = words(line);
        let [time, value] = &words[..] else {
            return Err(
                "a header of two columns, time and power, current or resistance".to_owned(),
            );
        };
        let time_factor = match time.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            ["time" | "t"]
            | [.., "time" | "t", "s" | "sec" | "seconds"]
            | ["test", "time", "second"] => 1.0,
            [.., "time" | "t", "ms"] => 1e-3,
            [.., "time" | "t", "min"] => 60.0,
            [.., "time" | "t", "h"] => 3600.0,
            _ => return Err("first a column of time in s, ms, min or h".to_owned()),
        };
        let direction = direction(value)?.or_else(|| of_cycler(time).then_some(Direction::Charge));
        let (demand, factor) = match (kind(value), wanted) {
            (Some(known), _) => known,
            (None, Some(wanted)) if value.last().is_some_and(|w| vague(w)) => (wanted, 1.0),
            (None, None) if value.last().is_some_and(|w| vague(w)) => {
                return Err(
                    "a unit (W, A or Ω) in the second column's name, or --kind with power, \
                current or resistance"
                        .to_owned(),
                );
            }
            _ => {
                return Err(
                    "second a column of power in W, current in A or resistance in Ω".to_owned(),
                );
            }
        };
        match wanted {
            Some(wanted) if wanted != demand => {
                Err(format!("a column of the kind asked for, {wanted:?}"))
            }
            _ => Ok(Self {
                time_factor,
                demand,
                factor,
                direction,
            }),
        }
    }
}

/// Returns the names of the columns, each as lower-case words.
fn words(line: &str) -> Vec<Vec<String>> {
    let parts = |field: &str| -> Vec<String> {
        let lower = field.to_lowercase();
        let cut = lower.split(|c: char| c.is_whitespace() || "_[]()/".contains(c));
        cut.filter(|w| !w.is_empty()).map(str::to_owned).collect()
    };
    if line.contains([',', ';', '\t']) {
        return split(line).into_iter().map(parts).collect();
    }
    // Blanks separate words and columns: the second column begins at the word of its quantity.
    let all = parts(line);
    match all
        .iter()
        .skip(1)
        .position(|w| quantity(w).is_some() || vague(w))
    {
        Some(at) => vec![all[..=at].to_vec(), all[at + 1..].to_vec()],
        None => vec![all],
    }
}

fn quantity(word: &str) -> Option<Demand> {
    match word {
        "power" | "p" => Some(Demand::Power),
        "current" | "i" => Some(Demand::Current),
        "resistance" => Some(Demand::Resistance),
        _ => None,
    }
}

/// Words that do not distinguish power, current and resistance.
fn vague(word: &str) -> bool {
    matches!(
        word,
        "load" | "charge" | "charging" | "discharge" | "discharging"
    )
}

fn direction(words: &[String]) -> Result<Option<Direction>, String> {
    let says = |word: &str, other: &str| words.iter().any(|w| w == word || w == other);
    match (says("charge", "charging"), says("discharge", "discharging")) {
        (true, true) => Err("second a column of either charge or discharge".to_owned()),
        (true, false) => Ok(Some(Direction::Charge)),
        (false, true) => Ok(Some(Direction::Discharge)),
        (false, false) => Ok(None),
    }
}

/// Returns whether a name is that of the time in BDF (label or machine name) or Arbin: in such
/// files charge is positive.
fn of_cycler(time: &[String]) -> bool {
    matches!(
        time.iter().map(String::as_str).collect::<Vec<_>>()[..],
        ["test", "time", "s" | "second"]
    )
}

/// Returns the kind of a column and its unit in W, A or Ω. If no word determines the kind, the unit
/// after an ambiguous word does.
fn kind(words: &[String]) -> Option<(Demand, f64)> {
    let named = words.iter().find_map(|w| quantity(w));
    let last = words.last()?.as_str();
    if quantity(last).is_some() || (named.is_some() && vague(last)) {
        return named.map(|demand| (demand, 1.0));
    }
    let (demand, factor) = match last {
        "w" | "watt" => (Demand::Power, 1.0),
        "kw" => (Demand::Power, 1e3),
        "a" | "ampere" => (Demand::Current, 1.0),
        "ma" => (Demand::Current, 1e-3),
        "ohm" | "ohms" | "ω" | "Ω" => (Demand::Resistance, 1.0),
        "mohm" | "mω" => (Demand::Resistance, 1e-3),
        _ => return None,
    };
    let meant = named.map_or_else(|| words.iter().any(|w| vague(w)), |named| named == demand);
    meant.then_some((demand, factor))
}

#[cfg(test)]
mod tests;
