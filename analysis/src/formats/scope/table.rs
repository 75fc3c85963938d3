//! Records as tables of numbers: Siglent's and Rigol's CSV, and any other with one row per sample. The rows go once through a temporary file of
//! numbers, so that the length of a table does not matter.
//!
//! What stands before the first row of numbers is the header. The interval comes from it (`Sample Interval`, `Sample Rate`, `Increment`) or from the
//! first column, where that is called a time; a column of numbers of samples is passed over.

use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

use super::raw::{Form, Layout, RawFile};
use super::{ScopeError, ScopeRecord};
use crate::formats::text;

const KIND: &str = "table";
/// Lines of a header, at most.
const HEADER: usize = 100;
/// Rows in which the step of the quantisation is looked for.
const LOOKED_AT: usize = 20_000;
/// Names of a first column that holds times.
const TIMES: [&str; 5] = ["second", "time", "time(s)", "t", "time_s"];

/// What the lines before the numbers say.
#[derive(Default)]
struct Header {
    interval_s: Option<f64>,
    names: Vec<String>,
    /// Columns of the header that are no samples, as `Start` and `Increment` of Rigol's.
    line: usize,
}

/// Opens a table.
pub(super) fn open(path: &Path, interval_s: Option<f64>) -> Result<ScopeRecord, ScopeError> {
    let io = |action| move |source| ScopeError::Io { file: path.to_owned(), action, source };
    let mut lines = BufReader::new(File::open(path).map_err(io("open it"))?).lines();
    let mut header = Header::default();
    let mut first: Option<Vec<f64>> = None;
    for line in lines.by_ref().take(HEADER) {
        let line = line.map_err(io("read it as text"))?;
        header.line += 1;
        match numbers(&line) {
            Some(row) => {
                first = Some(row);
                break;
            }
            None => header.read(&line),
        }
    }
    let row_error = |line: usize, expected: String, met: String| ScopeError::Row { file: path.to_owned(), line, expected, met };
    let Some(first) = first else {
        return Err(row_error(header.line, format!("a row of numbers within {HEADER} lines"), "none".to_owned()));
    };
    let timed = header.names.first().is_some_and(|name| TIMES.contains(&name.to_lowercase().as_str()));
    let counted = header.names.first().is_some_and(|name| name.eq_ignore_ascii_case("x") || name.eq_ignore_ascii_case("sequence"));
    let skip = usize::from(timed || counted);
    let width = first.len();
    if width <= skip {
        return Err(row_error(header.line, "a row with at least one sample".to_owned(), format!("{width} numbers")));
    }
    let mut spill = Spill::new(width).map_err(io("make a temporary file"))?;
    spill.row(&first).map_err(io("write a temporary file"))?;
    let mut number = header.line;
    for line in lines {
        let line = line.map_err(io("read it as text"))?;
        number += 1;
        if line.trim().is_empty() {
            continue;
        }
        let row = numbers(&line).filter(|row| row.len() == width);
        let Some(row) = row else {
            return Err(row_error(number, format!("{width} numbers"), format!("{:?}", line.chars().take(60).collect::<String>())));
        };
        spill.row(&row).map_err(io("write a temporary file"))?;
    }
    let told = spill.interval_s().filter(|_| timed);
    let Some(interval_s) = header.interval_s.or(told).or(interval_s).filter(|interval_s| *interval_s > 0.0 && interval_s.is_finite())
    else {
        let expected = "the time between two samples, in the header or a column of times; or given as `interval`".to_owned();
        return Err(row_error(header.line, expected, "none".to_owned()));
    };
    let names = (skip..width).map(|column| header.names.get(column).cloned().unwrap_or_else(|| format!("column {}", column + 1))).collect();
    let samples = spill.rows;
    let raw = spill.finish(path, skip).map_err(io("write a temporary file"))?;
    Ok(ScopeRecord { kind: KIND, interval_s, samples, names, raw })
}

/// A row of numbers; a comma at its end is no further field. Between semicolons and tabulators a comma is a decimal point, as long as no number of the row
/// has a point.
fn numbers(line: &str) -> Option<Vec<f64>> {
    let line = line.trim().trim_end_matches([',', ';']);
    let separator = [';', '\t', ','].into_iter().find(|separator| line.contains(*separator)).unwrap_or(' ');
    let fields: Option<Vec<f64>> = line
        .split(separator)
        .map(str::trim)
        .filter(|field| separator != ' ' || !field.is_empty())
        .map(|field| text::number(field, separator))
        .collect();
    if separator != ',' && line.contains(',') && line.contains('.') {
        return None;
    }
    fields.filter(|fields| !fields.is_empty() && fields.iter().all(|value: &f64| value.is_finite()))
}

impl Header {
    fn read(&mut self, line: &str) {
        let fields: Vec<&str> = line.split([',', ';', '\t']).map(|field| field.trim().trim_matches('"')).collect();
        let after = |field: &str| field.rsplit([':', '=']).next().and_then(|text| text.trim().parse::<f64>().ok());
        let key = fields.first().map_or_else(String::new, |key| key.to_lowercase());
        let value = fields.iter().skip(1).find_map(|field| after(field));
        if key.starts_with("sample interval") {
            self.interval_s = value;
        } else if key.starts_with("sample rate") || key.starts_with("sampling frequency") {
            self.interval_s = value.map(f64::recip);
        } else if let Some(column) = self.names.iter().position(|name| name.eq_ignore_ascii_case("increment")) {
            // The units' row of Rigol's: the last two fields are start and increment.
            self.interval_s = fields.get(column).and_then(|field| field.parse().ok());
            self.names.truncate(column.saturating_sub(1));
        } else if fields.len() > 1 && !key.contains(' ') {
            // Siglent's last line names the units; the line before, `Source`, the channels.
            let named = |name: &str| ["volt", "value", "ampere"].contains(&name.to_lowercase().as_str());
            if self.names.len() > 1 && fields.iter().skip(1).all(|name| name.is_empty() || named(name)) {
                if let (Some(name), Some(first)) = (self.names.first_mut(), fields.first()) {
                    *name = (*first).to_owned();
                }
            } else {
                self.names = fields.iter().map(|name| (*name).to_owned()).filter(|name| !name.is_empty()).collect();
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
    /// First values of each column, in which the step of the quantisation is looked for.
    seen: Vec<Vec<f64>>,
}

impl Spill {
    fn new(width: usize) -> std::io::Result<Self> {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!("eis-bench-table-{}-{}", std::process::id(), NEXT.fetch_add(1, Ordering::Relaxed));
        let path = std::env::temp_dir().join(name);
        let file = OpenOptions::new().read(true).write(true).create_new(true).open(&path)?;
        // Without a name it is gone as soon as it is closed, however the process ends.
        std::fs::remove_file(&path)?;
        Ok(Self { writer: BufWriter::new(file), width, rows: 0, first: Vec::new(), last: Vec::new(), seen: vec![Vec::new(); width] })
    }

    fn row(&mut self, row: &[f64]) -> std::io::Result<()> {
        if self.rows < LOOKED_AT {
            self.seen.iter_mut().zip(row).for_each(|(seen, value)| seen.push(*value));
        }
        if self.rows == 0 {
            self.first = row.to_vec();
        }
        self.last = row.to_vec();
        self.rows += 1;
        row.iter().try_for_each(|value| self.writer.write_all(&value.to_le_bytes()))
    }

    /// Time between two rows, by a first column of times.
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
        let file = self.writer.into_inner().map_err(std::io::IntoInnerError::into_error)?;
        Ok(RawFile { path: path.to_owned(), file, channels })
    }
}

/// The least difference of two values, wherever they stand. That of two neighbours in time would be the slope of a steep signal, however finely it was
/// quantised.
fn step(seen: &[f64]) -> Option<f64> {
    let mut sorted = seen.to_vec();
    sorted.sort_by(f64::total_cmp);
    let changes = sorted.iter().zip(sorted.iter().skip(1)).map(|(low, high)| (high - low, high.abs()));
    // Below, it is the rounding of the digits.
    changes.filter(|(change, of)| *change > 1.0e-9 * of).map(|(change, _)| change).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_semicolons_a_comma_is_a_decimal_point() {
        assert_eq!(numbers("-1,5E-3;0,25;"), Some(vec![-1.5e-3, 0.25]));
        assert_eq!(numbers("0.001\t0.25"), Some(vec![0.001, 0.25]));
        assert_eq!(numbers("1,000;0.25"), None);
        assert_eq!(numbers("1,0.25,"), Some(vec![1.0, 0.25]));
    }

    #[test]
    fn the_step_is_that_of_the_codes_and_not_of_the_signal() {
        let sine = |round: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..4000).map(|k| round(0.02 * (std::f64::consts::TAU * f64::from(k) / 100.3).sin())).collect()
        };
        // Neighbours in time are up to 1.25 mV apart.
        let coarse = step(&sine(&|value| (value / 1.0e-4).round() * 1.0e-4)).unwrap();
        assert!((coarse / 1.0e-4 - 1.0).abs() < 1.0e-6, "{coarse}");
        let fine = step(&sine(&|value| value)).unwrap();
        assert!(fine < 1.0e-6, "{fine}");
        assert_eq!(step(&[0.1, 0.1, 0.1]), None);
    }
}
