//! Records as tables of numbers: Siglent's, Rigol's and Rohde & Schwarz' (RTB, RTM) CSV, and any other
//! with one row per sample. The rows are converted once to a temporary file of numbers, so that the
//! length of a table is not limited by memory.
//!
//! The header is all text before the first row of numbers. The interval comes from it (`Sample
//! Interval`, `Sample Rate`, `Increment`) or from the first column, if its name is a time. A column
//! of sample numbers is skipped.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use super::raw::{self, Form, Layout, RawFile};
use super::{ScopeError, ScopeRecord};
use crate::formats::text;

const KIND: &str = "table";
/// Maximum number of lines of a header.
const HEADER: usize = 100;
/// Number of rows from which the step of the quantisation is determined.
const LOOKED_AT: usize = 20_000;
/// Names of a first column with times.
const TIMES: [&str; 7] = [
    "second",
    "time",
    "time(s)",
    "t",
    "time_s",
    "in s",
    "time in s",
];
/// Suffixes of the names of samples in volts and amperes in files of Rohde & Schwarz.
const UNITS: [&str; 2] = [" in V", " in A"];
const ONE_MARK: &str = "one decimal mark in all numbers, a comma or a point";

/// Values read from the lines before the numbers.
#[derive(Default)]
struct Header {
    interval_s: Option<f64>,
    names: Vec<String>,
    /// Columns of the header that are not samples, such as Rigol's `Start` and `Increment`.
    line: usize,
}

type Lines = std::io::Lines<BufReader<File>>;

/// Opens a table.
pub(super) fn open(path: &Path, interval_s: Option<f64>) -> Result<ScopeRecord, ScopeError> {
    let mut lines = BufReader::new(File::open(path).map_err(io(path, "open it"))?).lines();
    let (header, writing, first) = begin(path, &mut lines)?;
    let timed = header
        .names
        .first()
        .is_some_and(|name| TIMES.contains(&name.to_lowercase().as_str()));
    let counted = header.names.first().is_some_and(|name| {
        name.eq_ignore_ascii_case("x") || name.eq_ignore_ascii_case("sequence")
    });
    let skip = usize::from(timed || counted);
    let width = first.len();
    if width <= skip {
        return Err(row_error(
            path,
            header.line,
            "a row with at least one sample",
            &format!("{width} numbers"),
        ));
    }
    let spill = spill(path, header.line, lines, writing, &first)?;
    let from_times = spill.interval_s().filter(|_| timed);
    let Some(interval_s) = header
        .interval_s
        .or(from_times)
        .or(interval_s)
        .filter(|interval_s| *interval_s > 0.0 && interval_s.is_finite())
    else {
        let expected = "the time between two samples, in the header or a column of times; or given \
        as `interval`";
        return Err(row_error(path, header.line, expected, "none"));
    };
    let names = (skip..width)
        .map(|column| {
            header
                .names
                .get(column)
                .cloned()
                .unwrap_or_else(|| format!("column {}", column + 1))
        })
        .collect();
    let samples = spill.rows;
    let raw = spill
        .finish(path, skip)
        .map_err(io(path, "write a temporary file"))?;
    Ok(ScopeRecord {
        kind: KIND,
        interval_s,
        samples,
        names,
        raw,
    })
}

/// Returns the header, the first row of numbers, and its notation.
fn begin(path: &Path, lines: &mut Lines) -> Result<(Header, Writing, Vec<f64>), ScopeError> {
    let mut header = Header::default();
    for line in lines.take(HEADER) {
        let line = line.map_err(io(path, "read it as text"))?;
        header.line += 1;
        let mut writing = Writing::of(&line);
        match writing.numbers(&line) {
            Some(_) if !writing.one_mark(&line) => {
                return Err(row_error(path, header.line, ONE_MARK, &excerpt(&line)));
            }
            Some(row) => return Ok((header, writing, row)),
            None => header.read(&line),
        }
    }
    Err(row_error(
        path,
        header.line,
        &format!("a row of numbers within {HEADER} lines"),
        "none",
    ))
}

/// Copies all rows of numbers to a temporary file; the first is in line `number`.
fn spill(
    path: &Path,
    mut number: usize,
    lines: Lines,
    mut writing: Writing,
    first: &[f64],
) -> Result<Spill, ScopeError> {
    let mut spill = Spill::new(first.len()).map_err(io(path, "make a temporary file"))?;
    spill
        .row(first)
        .map_err(io(path, "write a temporary file"))?;
    for line in lines {
        let line = line.map_err(io(path, "read it as text"))?;
        number += 1;
        if line.trim().is_empty() {
            continue;
        }
        let Some(row) = writing
            .numbers(&line)
            .filter(|row| row.len() == first.len())
        else {
            return Err(row_error(
                path,
                number,
                &format!("{} numbers", first.len()),
                &excerpt(&line),
            ));
        };
        if !writing.one_mark(&line) {
            return Err(row_error(path, number, ONE_MARK, &excerpt(&line)));
        }
        spill
            .row(&row)
            .map_err(io(path, "write a temporary file"))?;
    }
    Ok(spill)
}

fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> ScopeError {
    move |source| ScopeError::Io {
        file: path.to_owned(),
        action,
        source,
    }
}

fn row_error(path: &Path, line: usize, expected: &str, met: &str) -> ScopeError {
    ScopeError::Row {
        file: path.to_owned(),
        line,
        expected: expected.to_owned(),
        met: met.to_owned(),
    }
}

fn excerpt(line: &str) -> String {
    format!("{:?}", line.chars().take(60).collect::<String>())
}

/// Notation of the rows of a file, from its first row: a file has one separator and one decimal
/// mark.
struct Writing {
    separator: char,
    /// `None` until a number has a decimal mark.
    mark: Option<char>,
}

impl Writing {
    /// A tab next to a comma is padding, like a blank.
    fn of(line: &str) -> Self {
        let line = bare(line);
        let parts = |at: usize| {
            let (before, behind) = line.split_at(at);
            !before.trim_end().ends_with(',') && !behind.trim_start().starts_with(',')
        };
        let separator = match line {
            line if line.contains(';') => ';',
            line if line.match_indices('\t').any(|(at, _)| parts(at)) => '\t',
            line if line.contains(',') => ',',
            _ => ' ',
        };
        Self {
            separator,
            mark: None,
        }
    }

    /// Parses a row of numbers; a trailing comma adds no field. With semicolons and tabs, a comma
    /// is a decimal point.
    fn numbers(&self, line: &str) -> Option<Vec<f64>> {
        let separator = self.separator;
        let fields: Option<Vec<f64>> = bare(line)
            .split(separator)
            .map(str::trim)
            .filter(|field| separator != ' ' || !field.is_empty())
            .map(|field| text::number(field, separator))
            .collect();
        fields.filter(|fields| {
            !fields.is_empty() && fields.iter().all(|value: &f64| value.is_finite())
        })
    }

    /// Returns false for a row of numbers with another decimal mark than a previous row, or with
    /// both marks, because one number would be wrong by a factor.
    fn one_mark(&mut self, line: &str) -> bool {
        let mut own = [',', '.']
            .into_iter()
            .filter(|mark| self.separator != ',' && bare(line).contains(*mark));
        own.all(|mark| *self.mark.get_or_insert(mark) == mark)
    }
}

fn bare(line: &str) -> &str {
    line.trim().trim_end_matches([',', ';'])
}

impl Header {
    fn read(&mut self, line: &str) {
        let fields: Vec<&str> = line
            .split([',', ';', '\t'])
            .map(|field| field.trim().trim_matches('"'))
            .collect();
        let after = |field: &str| {
            field
                .rsplit([':', '='])
                .next()
                .and_then(|text| text.trim().parse::<f64>().ok())
        };
        let key = fields
            .first()
            .map_or_else(String::new, |key| key.to_lowercase());
        let value = fields.iter().skip(1).find_map(|field| after(field));
        if key.starts_with("sample interval") {
            self.interval_s = value;
        } else if key.starts_with("sample rate") || key.starts_with("sampling frequency") {
            self.interval_s = value.map(f64::recip);
        } else if let Some(column) = self
            .names
            .iter()
            .position(|name| name.eq_ignore_ascii_case("increment"))
        {
            // Rigol's row of units: the last two fields are start and increment.
            self.interval_s = fields.get(column).and_then(|field| field.parse().ok());
            self.names.truncate(column.saturating_sub(1));
        } else if fields.len() > 1 && TIMES[5..].contains(&key.as_str()) {
            let plain = |name: &&str| {
                let named = UNITS.iter().find_map(|unit| name.strip_suffix(unit));
                named.unwrap_or(name).to_owned()
            };
            self.names = fields.iter().map(plain).collect();
        } else if fields.len() > 1 && !key.contains(' ') {
            // Siglent's last line contains the units; the previous line, `Source`, contains the
            // channels.
            let named =
                |name: &str| ["volt", "value", "ampere"].contains(&name.to_lowercase().as_str());
            if self.names.len() > 1
                && fields
                    .iter()
                    .skip(1)
                    .all(|name| name.is_empty() || named(name))
            {
                if let (Some(name), Some(first)) = (self.names.first_mut(), fields.first()) {
                    *name = (*first).to_owned();
                }
            } else {
                self.names = fields
                    .iter()
                    .map(|name| (*name).to_owned())
                    .filter(|name| !name.is_empty())
                    .collect();
            }
        }
    }
}

/// A temporary file of rows of numbers.
struct Spill {
    writer: BufWriter<File>,
    width: usize,
    rows: usize,
    first: Vec<f64>,
    last: Vec<f64>,
    /// First values of each column, from which the step of the quantisation is determined.
    seen: Vec<Vec<f64>>,
}

impl Spill {
    fn new(width: usize) -> std::io::Result<Self> {
        let file = raw::unnamed_file()?;
        Ok(Self {
            writer: BufWriter::new(file),
            width,
            rows: 0,
            first: Vec::new(),
            last: Vec::new(),
            seen: vec![Vec::new(); width],
        })
    }

    fn row(&mut self, row: &[f64]) -> std::io::Result<()> {
        if self.rows < LOOKED_AT {
            self.seen
                .iter_mut()
                .zip(row)
                .for_each(|(seen, value)| seen.push(*value));
        }
        if self.rows == 0 {
            self.first = row.to_vec();
        }
        self.last = row.to_vec();
        self.rows += 1;
        row.iter()
            .try_for_each(|value| self.writer.write_all(&value.to_le_bytes()))
    }

    /// Returns the time between two rows from a first column of times.
    fn interval_s(&self) -> Option<f64> {
        let (first, last) = (self.first.first()?, self.last.first()?);
        (self.rows > 1).then(|| (last - first) / (self.rows - 1) as f64)
    }

    fn finish(self, path: &Path, skip: usize) -> std::io::Result<RawFile> {
        let stride = 8 * self.width;
        let channel = |column: usize| Layout {
            at: 8 * column as u64,
            stride,
            form: Form::Double,
            scale: None,
            lsb_v: self.seen.get(column).and_then(|seen| step(seen)),
            level_v: self.first.get(column).copied().unwrap_or(0.0),
        };
        let channels = (skip..self.width).map(channel).collect();
        let file = self
            .writer
            .into_inner()
            .map_err(std::io::IntoInnerError::into_error)?;
        Ok(RawFile {
            path: path.to_owned(),
            file,
            channels,
        })
    }
}

/// Returns the smallest difference of any two values. The difference of neighbours in time would be
/// the slope of a steep signal, not the quantisation.
pub(super) fn step(seen: &[f64]) -> Option<f64> {
    let mut sorted = seen.to_vec();
    sorted.sort_by(f64::total_cmp);
    let changes = sorted
        .iter()
        .zip(sorted.iter().skip(1))
        .map(|(low, high)| (high - low, high.abs()));
    // Smaller changes are rounding of the printed digits.
    changes
        .filter(|(change, of)| *change > 1.0e-9 * of)
        .map(|(change, _)| change)
        .min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_semicolons_a_comma_is_a_decimal_point() {
        let numbers = |line: &str| Writing::of(line).numbers(line);
        assert_eq!(numbers("-1,5E-3;0,25;"), Some(vec![-1.5e-3, 0.25]));
        assert_eq!(numbers("0.001\t0.25"), Some(vec![0.001, 0.25]));
        assert_eq!(numbers("1,0.25,"), Some(vec![1.0, 0.25]));
        // Blanks and tabs next to a comma are padding.
        for line in ["1.0,\t2.0", "1.0\t,2.0", "1.0, \t 2.0", "1.0 ,\t2.0,"] {
            assert_eq!(numbers(line), Some(vec![1.0, 2.0]), "{line:?}");
        }
        assert_eq!(numbers("1,5\t2,5"), Some(vec![1.5, 2.5]));
    }

    #[test]
    fn one_file_has_one_decimal_mark_and_one_separator() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        let opened = |text: &str| {
            std::fs::write(&path, text).unwrap();
            open(&path, Some(1.0e-3))
                .map(|record| record.samples)
                .map_err(|error| error.to_string())
        };
        assert_eq!(opened("a;b\n1;2\n1,000;2\n1,5;2\n"), Ok(3));
        assert_eq!(opened("a;b\n1;2\n1.000;2\n1.5;2\n"), Ok(3));
        for (text, line, what) in [
            ("a;b\n1,000;2\n1.5;2\n", 3, ONE_MARK),
            ("a;b\n1.5;2\n1;2\n1;2,0\n", 4, ONE_MARK),
            ("a;b\n1;2\n1,000;0.25\n", 3, ONE_MARK),
            ("a;b\n1,000;0.25\n", 2, ONE_MARK),
            ("a\tb\n1,5\t2\n1.5\t2\n", 3, ONE_MARK),
            // A row that is truncated at its decimal comma.
            ("a;b\n1,5;2,5\n1,5\n", 3, "2 numbers"),
        ] {
            let error = opened(text).unwrap_err();
            assert!(
                error.contains(&format!("line {line}: expected {what}, met \"")),
                "{text:?}: {error}"
            );
        }
    }

    #[test]
    fn the_step_is_that_of_the_codes_and_not_of_the_signal() {
        let sine = |round: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..4000)
                .map(|k| round(0.02 * (std::f64::consts::TAU * f64::from(k) / 100.3).sin()))
                .collect()
        };
        // Neighbours in time are up to 1.25 mV apart.
        let coarse = step(&sine(&|value| (value / 1.0e-4).round() * 1.0e-4)).unwrap();
        assert!((coarse / 1.0e-4 - 1.0).abs() < 1.0e-6, "{coarse}");
        let fine = step(&sine(&|value| value)).unwrap();
        assert!(fine < 1.0e-6, "{fine}");
        assert_eq!(step(&[0.1, 0.1, 0.1]), None);
    }
}
