//! Vendor formats that are not tables with named columns:
//!
//! * Autolab FRA `.dfr`: `VERSION8.0`, the number of points, then nine numbers for each point, one
//!   per line: frequency, Re Z, −Im Z and six more
//! * Elchemea Analytical `.i2b`: any head, a line with the number of points, then frequency, Re Z and
//!   Im Z in each line
//! * Ivium `.ids` and `.idf`: binary marks between lines of text; a block `Method=Impedance` holds
//!   after `primary_data` the number of columns, that of rows, and Re Z, Im Z and frequency in each
//! * PalmSens `.pssession`: JSON in UTF-16; the arrays `Frequency`, `ZRe` and `ZIm` (−Im Z) of each
//!   measurement
//!
//! Frequencies are in Hz, impedances in Ω.

use super::FileSpectra;
use super::error::FormatError;
use super::sweeps::{self, Key, MeasuredRow, Rows};
use super::text::shorten;
use analysis_numeric::Covariance2;
use analysis_signal::spectrum::{ImpedancePoint, Origin};
use num_complex::Complex64;
use serde_json::Value;
use std::path::Path;

/// First bytes of an Ivium file.
const IVIUM: &[u8] = b"\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\x48\0\0\0";
/// First line of an Autolab FRA file.
const AUTOLAB: &str = "VERSION8.0";
/// Numbers of one point in an Autolab FRA file.
const AUTOLAB_NUMBERS: usize = 9;

type Read = Result<FileSpectra, FormatError>;

/// Reads a file in one of these formats; returns `None` for any other file.
pub(super) fn parse(path: &Path, bytes: &[u8]) -> Option<Read> {
    if bytes.starts_with(IVIUM) {
        let text: String = bytes.iter().map(|byte| char::from(*byte)).collect();
        return Some(ivium(path, &text));
    }
    let text = std::str::from_utf8(bytes)
        .ok()?
        .trim_start_matches('\u{feff}');
    if text.starts_with(AUTOLAB) {
        return Some(autolab(path, text));
    }
    if text.starts_with('{')
        && text
            .to_lowercase()
            .contains("\"palmsens.datafiles.sessionfile\"")
    {
        return Some(palmsens(path, text));
    }
    elchemea(path, text)
}

fn row(line: usize, key: Vec<String>, freq_hz: f64, z_ohm: Complex64) -> MeasuredRow {
    MeasuredRow {
        line,
        origin: Origin::default(),
        key,
        point: ImpedancePoint {
            freq_hz,
            z_ohm,
            covariance: Covariance2::UNKNOWN,
            amplitude_a: f64::NAN,
        },
    }
}

/// Groups rows into spectra by `keys`.
fn sorted(path: &Path, rows: Vec<MeasuredRow>, keys: Vec<Key>) -> Read {
    if rows.is_empty() {
        return Err(FormatError::Empty {
            file: path.to_owned(),
            met: "no points",
        });
    }
    for row in &rows {
        let point = &row.point;
        let frequency = point.freq_hz.is_finite() && point.freq_hz > 0.0;
        if !frequency || !point.z_ohm.is_finite() {
            return Err(FormatError::Header {
                file: path.to_owned(),
                line: row.line,
                expected: "a frequency above 0 Hz and a finite impedance".to_owned(),
                met: format!("{} Hz and {} Ω", point.freq_hz, point.z_ohm),
            });
        }
    }
    let stem = path.file_stem().map_or_else(
        || "spectrum".to_owned(),
        |stem| stem.to_string_lossy().into_owned(),
    );
    sweeps::sort(path, Rows { rows, keys }, |_, _| stem.clone())
}

/// Numbered lines from which values are taken in order.
struct Lines<'a> {
    path: &'a Path,
    rest: std::iter::Enumerate<std::str::Lines<'a>>,
}

impl<'a> Lines<'a> {
    fn new(path: &'a Path, text: &'a str) -> Self {
        let rest = text.lines().enumerate();
        Self { path, rest }
    }

    fn next(&mut self, expected: &str) -> Result<(usize, &'a str), FormatError> {
        let (at, line) = self.rest.next().ok_or_else(|| FormatError::Header {
            file: self.path.to_owned(),
            line: 0,
            expected: expected.to_owned(),
            met: "the end of the file".to_owned(),
        })?;
        Ok((at + 1, line.trim()))
    }

    /// Returns the numbers of a line, separated by blanks.
    fn numbers<const N: usize>(
        &mut self,
        expected: &str,
    ) -> Result<(usize, [f64; N]), FormatError> {
        let (at, line) = self.next(expected)?;
        let mut numbers = [f64::NAN; N];
        let mut fields = line.split_whitespace();
        for number in &mut numbers {
            let field = fields.next().and_then(|field| field.parse().ok());
            *number = field.ok_or_else(|| self.wrong(at, expected, line))?;
        }
        match fields.next() {
            None => Ok((at, numbers)),
            Some(_) => Err(self.wrong(at, expected, line)),
        }
    }

    fn count(&mut self, expected: &str) -> Result<usize, FormatError> {
        let (at, line) = self.next(expected)?;
        line.parse().map_err(|_| self.wrong(at, expected, line))
    }

    fn wrong(&self, line: usize, expected: &str, met: &str) -> FormatError {
        FormatError::Header {
            file: self.path.to_owned(),
            line,
            expected: expected.to_owned(),
            met: shorten(met),
        }
    }
}

fn autolab(path: &Path, text: &str) -> Read {
    let mut lines = Lines::new(path, text);
    lines.next("the version")?;
    let count = lines.count("the number of points")?;
    lines.next("a number")?;
    let mut rows = Vec::new();
    for _ in 0..count {
        let (at, [freq_hz]) = lines.numbers("a frequency in Hz")?;
        let (_, [re_ohm]) = lines.numbers("Re Z in Ω")?;
        let (_, [minus_im_ohm]) = lines.numbers("−Im Z in Ω")?;
        for _ in 3..AUTOLAB_NUMBERS {
            lines.numbers::<1>("a number")?;
        }
        rows.push(row(
            at,
            Vec::new(),
            freq_hz,
            Complex64::new(re_ohm, -minus_im_ohm),
        ));
    }
    sorted(path, rows, Vec::new())
}

/// An `.i2b` file has no magic number: it is recognised by a line with the number of points, followed
/// by that number of lines with three numbers up to the end of the file.
fn elchemea(path: &Path, text: &str) -> Option<Read> {
    let filled: Vec<(usize, &str)> = super::text::lines(text).collect();
    let is_row = |line: &str| {
        let mut fields = line.split_whitespace().map(str::parse::<f64>);
        (0..3).all(|_| matches!(fields.next(), Some(Ok(_)))) && fields.next().is_none()
    };
    let points = filled
        .iter()
        .rev()
        .take_while(|(_, line)| is_row(line))
        .count();
    let head = filled.len().checked_sub(points + 1)?;
    let stated: usize = filled.get(head)?.1.trim().parse().ok()?;
    if points == 0 || stated != points {
        return None;
    }
    let rows = filled[head + 1..].iter().filter_map(|(at, line)| {
        let mut fields = line.split_whitespace().map(str::parse::<f64>);
        let mut next = || fields.next()?.ok();
        let (freq_hz, re, im) = (next()?, next()?, next()?);
        Some(row(*at, Vec::new(), freq_hz, Complex64::new(re, im)))
    });
    Some(sorted(path, rows.collect(), Vec::new()))
}

fn ivium(path: &Path, text: &str) -> Read {
    let mut lines = Lines::new(path, text);
    let (mut rows, mut impedance, mut table) = (Vec::new(), false, 0_usize);
    while let Some((_, line)) = lines.rest.next() {
        let line = line.trim();
        if let Some(method) = line.strip_prefix("Method=") {
            impedance = method == "Impedance";
        }
        if line != "primary_data" || !impedance {
            continue;
        }
        impedance = false;
        let columns = lines.count("the number of columns")?;
        let count = lines.count("the number of rows")?;
        if columns != 3 {
            return Err(FormatError::Header {
                file: path.to_owned(),
                line: 0,
                expected: "three columns of an impedance: Re Z, Im Z, frequency".to_owned(),
                met: format!("{columns} columns"),
            });
        }
        table += 1;
        for _ in 0..count {
            let (at, [re, im, freq_hz]) = lines.numbers("Re Z, Im Z and a frequency")?;
            rows.push(row(
                at,
                vec![table.to_string()],
                freq_hz,
                Complex64::new(re, im),
            ));
        }
    }
    sorted(path, rows, vec![Key::Table])
}

fn palmsens(path: &Path, text: &str) -> Read {
    let wrong = |expected: &str, met: String| FormatError::Header {
        file: path.to_owned(),
        line: 1,
        expected: expected.to_owned(),
        met,
    };
    // The file ends with a byte order mark.
    let text = text.trim_end_matches(['\u{feff}', '\0']).trim_end();
    let session: Value =
        serde_json::from_str(text).map_err(|error| wrong("JSON", error.to_string()))?;
    let session = with_small_keys(session);
    let none = Vec::new();
    let measurements = session["measurements"].as_array().unwrap_or(&none);
    let mut rows = Vec::new();
    for (nth, measurement) in measurements.iter().enumerate() {
        // Each channel has scans; the arrays of the measurement itself repeat the last channel.
        let mut sets = Vec::new();
        scans(&measurement["eisdatalist"], "", &mut sets);
        if sets.len() < 2 {
            sets.clear();
            sets.push((nth.to_string(), &measurement["dataset"]));
        }
        for (count, (title, set)) in sets.iter().enumerate() {
            let arrays = set["values"].as_array().unwrap_or(&none);
            let values = |name: &str| -> Option<Vec<f64>> {
                let array = arrays.iter().find(|array| is_named(array, name))?;
                let values = array["datavalues"].as_array()?.iter();
                values.map(|value| value["v"].as_f64()).collect()
            };
            // Other techniques have no impedance.
            let (Some(freq), Some(re), Some(minus_im)) =
                (values("Frequency"), values("ZRe"), values("ZIm"))
            else {
                continue;
            };
            if freq.len() != re.len() || re.len() != minus_im.len() {
                return Err(wrong(
                    "as many frequencies as impedances",
                    format!("{}, {} and {}", freq.len(), re.len(), minus_im.len()),
                ));
            }
            // Titles may repeat.
            let key = if sets.len() > 1 {
                format!("{}.{} {title}", nth + 1, count + 1)
            } else {
                title.clone()
            };
            let points = freq.into_iter().zip(re).zip(minus_im);
            rows.extend(points.map(|((freq_hz, re), minus_im)| {
                row(1, vec![key.clone()], freq_hz, Complex64::new(re, -minus_im))
            }));
        }
    }
    sorted(path, rows, vec![Key::Table])
}

/// Returns the sets of arrays of a list of channels, with their titles: for a channel with scans,
/// the arrays of the scans.
fn scans<'a>(list: &'a Value, before: &str, found: &mut Vec<(String, &'a Value)>) {
    for one in list.as_array().into_iter().flatten() {
        let title = one["title"].as_str().unwrap_or_default();
        let short = title.split(':').next().unwrap_or_default();
        let title = format!("{before} {short}").trim().to_owned();
        let known = found.len();
        scans(&one["subscans"], &title, found);
        let has_set = one["dataset"]["values"]
            .as_array()
            .is_some_and(|all| !all.is_empty());
        if found.len() == known && has_set {
            found.push((title, &one["dataset"]));
        }
    }
}

fn is_named(array: &Value, name: &str) -> bool {
    let description = array["description"].as_str();
    description.is_some_and(|met| met.eq_ignore_ascii_case(name))
}

/// Converts the keys of a JSON value to lower case, because versions differ in case.
fn with_small_keys(value: Value) -> Value {
    match value {
        Value::Object(fields) => {
            let small = fields
                .into_iter()
                .map(|(key, value)| (key.to_lowercase(), with_small_keys(value)));
            Value::Object(small.collect())
        }
        Value::Array(all) => all.into_iter().map(with_small_keys).collect(),
        other => other,
    }
}
