//! Reads current and voltage over time from files of cyclers and of the bench. The format is
//! recognised by the content. The sign of the current is that of the file.
//!
//! * the bench's own, CSV or Parquet: `time_s,voltage_v,current_a`, perhaps `temperature_c`; charge
//!   positive
//! * BDF, CSV or Parquet: `Test Time / s`, `Voltage / V`, `Current / A`, perhaps
//!   `Surface Temperature T1 / degC`; charge positive (BDF fixes none; cyclers use it)
//! * the same for machines: `test_time_second`, `voltage_volt`, `current_ampere`, perhaps
//!   `temperature_t1_celsius`; charge positive
//! * Arbin's CSV: `Test_Time(s)`, `Voltage(V)`, `Current(A)`, perhaps `Aux_Temperature_1(C)`;
//!   charge positive
//! * Basytec, EC-Lab text, Digatron, Maccor, Neware, Novonix, PEC, and these names with other units
//!   (`cyclers`): charge positive; magnitudes alone need a direction
//! * the thesis' cycler, CSV: `Time,Voltage,Current`, perhaps `Temperature`; magnitudes: discharge
//!   when the file name has `discharge` in it, charge when it has `charge`
//!
//! [`SeriesOptions::sign`] overrules these. What is read is positive for discharge. Rows whose
//! voltage or current is empty or NaN were not measured and are left out. Of rows at one time, as
//! cyclers write them where a step ends, the last is kept. Columns may stand in any order; others are
//! passed over.

mod cyclers;
#[cfg(test)]
#[path = "timeseries/tests.rs"]
mod cyclers_tests;

use self::cyclers::{Columns, Found, clock_s};
use super::error::FormatError;
use super::spreadsheet::{self, Sheet};
use super::text::{self, Row, Text, shorten};
use super::{mat, mpr};
use crate::dataset::{self, DatasetError};
use analysis_signal::series::{SeriesError, TimeSeries};
use polars::prelude::{Column, DataFrame, DataType, ParquetReader, SerReader};
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Direction of the current that a file counts positive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CurrentSign {
    /// Discharging is positive.
    Discharge,
    /// Charging is positive.
    Charge,
}

impl FromStr for CurrentSign {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "discharge" => Ok(Self::Discharge),
            "charge" => Ok(Self::Charge),
            met => Err(format!(
                "expected which direction is positive, `discharge` or `charge`, met {met:?}"
            )),
        }
    }
}

/// Options of reading a time series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SeriesOptions {
    /// Direction that the file counts positive, where the table of the module is not to be
    /// followed.
    pub sign: Option<CurrentSign>,
}

/// Reason why a time series could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SeriesReadError {
    /// The file could not be read.
    #[error("{}: expected a readable file of current and voltage over time: {source}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// Error of the operating system.
        #[source]
        source: std::io::Error,
    },
    /// Bytes that are no text.
    #[error(transparent)]
    Text(#[from] FormatError),
    /// Columns of no known format.
    #[error(
        "{}{place}: expected the columns \"time_s,voltage_v,current_a\", \"Test Time / s,Voltage / \
        V,Current / A\", \"Test_Time(s),Voltage(V),Current(A)\" or \"Time,Voltage,Current\", met \
        {met}",
        file.display()
    )]
    UnknownFormat {
        /// The file.
        file: PathBuf,
        /// `, line N`, or nothing for a file without lines.
        place: String,
        /// The header, shortened.
        met: String,
    },
    /// Magnitudes without a direction in the file.
    #[error("{}: its currents have no sign; expected `discharge` or `charge` in the file name, or \
    the direction given", file.display())]
    Sign {
        /// The file.
        file: PathBuf,
    },
    /// A field that is not what its column holds.
    #[error("{}, line {line}, column {column} ({name}): expected a finite number, met {met}", file.display())]
    Field {
        /// The file.
        file: PathBuf,
        /// Line, from 1; in Parquet the row.
        line: usize,
        /// Field, from 1.
        column: usize,
        /// The column's name.
        name: &'static str,
        /// Value found.
        met: String,
    },
    /// Parquet that cannot be decoded.
    #[error("{}: expected Parquet with columns of numbers: {reason}", file.display())]
    Parquet {
        /// The file.
        file: PathBuf,
        /// Message of the decoder.
        reason: String,
    },
    /// A Parquet file of the bench that is damaged.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Numbers that are no series.
    #[error("{}: {source}", file.display())]
    Series {
        /// The file.
        file: PathBuf,
        /// Fault of the samples.
        #[source]
        source: SeriesError,
    },
}

/// Names of time, voltage, current and temperature, and the direction counted positive.
struct ColumnNames {
    names: [&'static str; 4],
    sign: Option<CurrentSign>,
}

const KNOWN: [ColumnNames; 5] = [
    ColumnNames {
        names: ["time_s", "voltage_v", "current_a", "temperature_c"],
        sign: Some(CurrentSign::Charge),
    },
    ColumnNames {
        names: [
            "Test Time / s",
            "Voltage / V",
            "Current / A",
            "Surface Temperature T1 / degC",
        ],
        sign: Some(CurrentSign::Charge),
    },
    // The names of the same columns for machines.
    ColumnNames {
        names: [
            "test_time_second",
            "voltage_volt",
            "current_ampere",
            "temperature_t1_celsius",
        ],
        sign: Some(CurrentSign::Charge),
    },
    ColumnNames {
        names: [
            "Test_Time(s)",
            "Voltage(V)",
            "Current(A)",
            "Aux_Temperature_1(C)",
        ],
        sign: Some(CurrentSign::Charge),
    },
    ColumnNames {
        names: ["Time", "Voltage", "Current", "Temperature"],
        sign: None,
    },
];

/// Reads a time series; its name is the file's without folder.
///
/// # Errors
/// [`SeriesReadError`] when the file cannot be read, is of no known format, holds what cannot be a
/// measurement, or does not tell its direction.
pub fn read_series(path: &Path, options: &SeriesOptions) -> Result<TimeSeries, SeriesReadError> {
    read_series_with_left_out(path, options).map(|(series, _)| series)
}

/// A row that was left out, because it holds no voltage or no current, or because another one at the
/// same time follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeftOut {
    /// Its line, from 1; in Parquet the row.
    pub line: usize,
    /// Its time, s.
    pub time_s: f64,
    /// It was measured, and another row at the same time was kept in its place.
    pub replaced: bool,
}

/// As [`read_series`], with the rows that were left out.
///
/// # Errors
/// As [`read_series`].
pub fn read_series_with_left_out(
    path: &Path,
    options: &SeriesOptions,
) -> Result<(TimeSeries, Vec<LeftOut>), SeriesReadError> {
    let bytes = std::fs::read(path).map_err(|source| SeriesReadError::Read {
        file: path.to_owned(),
        source,
    })?;
    let (mut raw, sign) = if bytes.starts_with(b"PAR1") {
        parquet(path, bytes)?
    } else {
        match spreadsheet::sheets(path, &bytes) {
            Some(sheets) => of_sheets(path, &sheets?)?,
            None => match mpr::text(path, &bytes).or_else(|| mat::text(path, &bytes)) {
                Some(text) => csv(path, text?.as_bytes())?,
                None => csv(path, &bytes)?,
            },
        }
    };
    let sign = options
        .sign
        .or(sign)
        .or_else(|| sign_of_name(path))
        .ok_or_else(|| SeriesReadError::Sign {
            file: path.to_owned(),
        })?;
    let left_out = std::mem::take(&mut raw.left_out);
    let series = raw.finish(
        path,
        if sign == CurrentSign::Discharge {
            1.0
        } else {
            -1.0
        },
    );
    series
        .validate()
        .map_err(|source| SeriesReadError::Series {
            file: path.to_owned(),
            source,
        })?;
    Ok((series, left_out))
}

fn sign_of_name(path: &Path) -> Option<CurrentSign> {
    let name = path.file_name()?.to_string_lossy().to_lowercase();
    if name.contains("discharge") {
        return Some(CurrentSign::Discharge);
    }
    name.contains("charge").then_some(CurrentSign::Charge)
}

/// Columns as they stand in the file.
#[derive(Default)]
struct Raw {
    /// Time, voltage, current.
    rows: Vec<[f64; 3]>,
    /// Beside the rows, where there is such a column.
    temperature_c: Option<Vec<f64>>,
    /// Rows without a voltage or a current, and those that another one replaced.
    left_out: Vec<LeftOut>,
    /// Line of the last row.
    last_line: usize,
}

impl Raw {
    /// Adds a row of this line.
    fn push(&mut self, line: usize, row: [f64; 3], temperature_c: Option<f64>) {
        if row[1].is_nan() || row[2].is_nan() {
            self.left_out.push(LeftOut {
                line,
                time_s: row[0],
                replaced: false,
            });
            return;
        }
        let again = self.rows.last().is_some_and(|last| last[0] == row[0]);
        if again {
            self.left_out.push(LeftOut {
                line: self.last_line,
                time_s: row[0],
                replaced: true,
            });
            self.rows.pop();
            if let Some(all) = &mut self.temperature_c {
                all.pop();
            }
        }
        self.last_line = line;
        self.rows.push(row);
        if let (Some(all), Some(t)) = (&mut self.temperature_c, temperature_c) {
            all.push(t);
        }
    }

    /// Goes on with the rows of another sheet.
    fn append(&mut self, mut other: Self) {
        self.rows.append(&mut other.rows);
        self.left_out.append(&mut other.left_out);
        self.last_line = other.last_line;
        match (&mut self.temperature_c, other.temperature_c) {
            (Some(all), Some(mut more)) => all.append(&mut more),
            (all, more) => *all = more,
        }
    }

    fn finish(self, path: &Path, factor: f64) -> TimeSeries {
        let name = path
            .file_name()
            .map_or_else(|| "series".to_owned(), |n| n.to_string_lossy().into_owned());
        let column = |k: usize, factor: f64| self.rows.iter().map(|r| factor * r[k]).collect();
        TimeSeries {
            name,
            time_s: column(0, 1.0),
            voltage_v: column(1, 1.0),
            current_a: column(2, factor),
            temperature_c: self.temperature_c,
        }
    }
}

/// The record of the sheets that hold one; a record goes on in sheets with the same columns.
fn of_sheets(path: &Path, sheets: &[Sheet]) -> Result<(Raw, Option<CurrentSign>), SeriesReadError> {
    let header = |sheet: &Sheet| {
        let lines: Vec<&str> = sheet.text.lines().collect();
        let at = names_a_series(&lines)?;
        Some(lines[at].to_owned())
    };
    let named: Vec<(&Sheet, String)> = sheets
        .iter()
        .filter_map(|sheet| Some((sheet, header(sheet)?)))
        .collect();
    let unknown = |met: String| SeriesReadError::UnknownFormat {
        file: path.to_owned(),
        place: String::new(),
        met,
    };
    let names = || sheets.iter().map(|sheet| sheet.name.as_str());
    let Some((_, first)) = named.first() else {
        let met = names().collect::<Vec<_>>().join(", ");
        return Err(unknown(format!("the sheets {met}, and no such columns")));
    };
    if let Some((other, _)) = named.iter().find(|(_, header)| header != first) {
        let (one, other) = (&named[0].0.name, &other.name);
        return Err(unknown(format!(
            "the sheets {one} and {other}, both with such columns, but not the same"
        )));
    }
    let mut all = Raw::default();
    let mut sign = None;
    for (sheet, _) in &named {
        let (raw, met) = csv(&sheet.path, sheet.text.as_bytes())?;
        all.append(raw);
        sign = sign.or(met);
    }
    Ok((all, sign))
}

/// The line, from 0, that names the columns of a record over time.
pub(super) fn names_a_series(lines: &[&str]) -> Option<usize> {
    cyclers::header(lines).map(|(at, _)| at)
}

fn csv(path: &Path, bytes: &[u8]) -> Result<(Raw, Option<CurrentSign>), SeriesReadError> {
    let decoded = text::utf_16(bytes);
    let bytes = decoded.as_deref().map_or(bytes, str::as_bytes);
    if let Some(error) = super::foreign::binary(path, bytes) {
        return Err(error.into());
    }
    if let Some(read) = of_cycler(path, bytes) {
        return read;
    }
    let text = Text::new(path, bytes)?;
    let unknown = |place: String, met: String| SeriesReadError::UnknownFormat {
        file: path.to_owned(),
        place,
        met,
    };
    let Some((header, rows)) = text.rows.split_first() else {
        return Err(unknown(String::new(), "no line with data".to_owned()));
    };
    let find = |name: &str| {
        header
            .fields
            .iter()
            .position(|f| f.eq_ignore_ascii_case(name))
    };
    let known = KNOWN
        .iter()
        .find_map(|k| Some((k, [find(k.names[0])?, find(k.names[1])?, find(k.names[2])?])));
    let Some((known, columns)) = known else {
        return Err(unknown(format!(", line {}", header.line), header.excerpt()));
    };
    text.one_mark()?;
    let temperature = find(known.names[3]);
    let mut raw = Raw {
        temperature_c: temperature.map(|_| Vec::with_capacity(rows.len())),
        ..Raw::default()
    };
    for row in rows {
        // A comma for a decimal point between commas moves all that follows.
        if let Some(more) =
            (header.fields.len()..row.fields.len()).find(|k| !row.fields[*k].is_empty())
        {
            let (expected, met) = (header.fields.len(), row.fields.len());
            return Err(FormatError::FieldCount {
                file: path.to_owned(),
                line: row.line,
                column: more + 1,
                expected,
                met,
            }
            .into());
        }
        let field = |column: usize, name: &'static str, may_lack: bool| {
            number(&text, row, column, name, may_lack)
        };
        let [t, v, i] = columns;
        let values = [
            field(t, known.names[0], false)?,
            field(v, known.names[1], true)?,
            field(i, known.names[2], true)?,
        ];
        let temperature_c = temperature
            .map(|column| field(column, known.names[3], true))
            .transpose()?;
        raw.push(row.line, values, temperature_c);
    }
    Ok((raw, known.sign))
}

/// Reads a table of a cycler that [`KNOWN`] does not name; nothing where it is none.
fn of_cycler(
    path: &Path,
    bytes: &[u8],
) -> Option<Result<(Raw, Option<CurrentSign>), SeriesReadError>> {
    // Degrees come in code pages of one byte, whose first half is ASCII.
    let content = std::str::from_utf8(bytes).map_or_else(
        |_| bytes.iter().map(|byte| char::from(*byte)).collect(),
        str::to_owned,
    );
    let content = content.trim_start_matches('\u{feff}');
    let lines: Vec<&str> = content.lines().collect();
    let (at, columns) = cyclers::header(&lines)?;
    let names: Vec<&str> = text::fields(lines.get(at)?, text::separator(lines.get(at)?)).collect();
    let known = |name: &str| names.iter().any(|met| met.eq_ignore_ascii_case(name));
    if KNOWN
        .iter()
        .any(|k| k.names[..3].iter().all(|name| known(name)))
    {
        return None;
    }
    let table = lines.get(at..)?.join("\n");
    Some(
        Text::new(path, table.as_bytes())
            .map_err(SeriesReadError::from)
            .and_then(|mut text| {
                text.rows.iter_mut().for_each(|row| row.line += at);
                text.one_mark()?;
                rows_of_cycler(&text, &columns)
            }),
    )
}

fn rows_of_cycler(
    text: &Text<'_>,
    columns: &Columns,
) -> Result<(Raw, Option<CurrentSign>), SeriesReadError> {
    let mut raw = Raw {
        temperature_c: columns.temperature.map(|_| Vec::new()),
        ..Raw::default()
    };
    let rows = text.rows.get(1..).unwrap_or_default();
    for (nth, row) in rows.iter().enumerate() {
        let value = |found: &Found, name: &'static str, may_lack: bool| {
            let field = row.fields.get(found.index).copied().unwrap_or_default();
            match clock_s(field).filter(|_| found.clock) {
                Some(seconds) => Ok(seconds),
                // Without a unit only a clock is a time.
                None if found.clock => Err(SeriesReadError::Field {
                    file: text.file(),
                    line: row.line,
                    column: found.index + 1,
                    name: "time as h:mm:ss",
                    met: shorten(field),
                }),
                None => {
                    number(text, row, found.index, name, may_lack).map(|value| value * found.factor)
                }
            }
        };
        // Units, or nothing, in a row of their own.
        let unread = |found: &Found| value(found, "", false).is_err();
        if nth == 0
            && [&columns.time, &columns.voltage, &columns.current]
                .into_iter()
                .all(unread)
        {
            continue;
        }
        let current_a = value(&columns.current, "current", true)?;
        let state = columns.state.and_then(|state| row.fields.get(state));
        let directed_a = match state.and_then(|state| state.chars().next()) {
            Some('D' | 'd') => -current_a.abs(),
            Some('C' | 'c') => current_a.abs(),
            _ => current_a,
        };
        let temperature = columns.temperature.as_ref();
        let temperature_c = temperature
            .map(|found| value(found, "temperature", true))
            .transpose()?;
        let values = [
            value(&columns.time, "time", false)?,
            value(&columns.voltage, "voltage", true)?,
            directed_a,
        ];
        raw.push(row.line, values, temperature_c);
    }
    let directed = columns.state.is_some() || raw.rows.iter().any(|row| row[2] < 0.0);
    Ok((raw, directed.then_some(CurrentSign::Charge)))
}

/// NaN for what may lack and does.
fn number(
    of: &Text<'_>,
    row: &Row<'_>,
    column: usize,
    name: &'static str,
    may_lack: bool,
) -> Result<f64, SeriesReadError> {
    let text = row.fields.get(column).copied();
    if may_lack && text.is_some_and(|t| t.is_empty() || t.eq_ignore_ascii_case("nan")) {
        return Ok(f64::NAN);
    }
    let met = || text.map_or_else(|| "the end of the line".to_owned(), shorten);
    let fail = || SeriesReadError::Field {
        file: of.file(),
        line: row.line,
        column: column + 1,
        name,
        met: met(),
    };
    text.and_then(|t| text::number(t, of.separator))
        .filter(|v| v.is_finite())
        .ok_or_else(fail)
}

fn parquet(path: &Path, bytes: Vec<u8>) -> Result<(Raw, Option<CurrentSign>), SeriesReadError> {
    let fail = |reason: polars::prelude::PolarsError| SeriesReadError::Parquet {
        file: path.to_owned(),
        reason: reason.to_string(),
    };
    let frame = ParquetReader::new(std::io::Cursor::new(bytes))
        .finish()
        .map_err(fail)?;
    let names: Vec<String> = frame
        .get_column_names()
        .iter()
        .map(|n| n.to_string())
        .collect();
    let find = |name: &str| names.iter().position(|n| n.eq_ignore_ascii_case(name));
    let known = KNOWN
        .iter()
        .find(|k| k.names[..3].iter().all(|name| find(name).is_some()));
    let Some(known) = known else {
        let told: Vec<&str> = names.iter().map(String::as_str).collect();
        return match cyclers::columns(&told) {
            Some(columns) => frame_of_cycler(path, &frame, &columns),
            None => Err(SeriesReadError::UnknownFormat {
                file: path.to_owned(),
                place: String::new(),
                met: shorten(&names.join(",")),
            }),
        };
    };
    if known.names[0] == KNOWN[0].names[0] {
        return Ok((bench(path)?, known.sign));
    }
    let column = |name: &'static str| values(path, &frame, find(name), name);
    let [time, voltage, current] = [
        column(known.names[0])?,
        column(known.names[1])?,
        column(known.names[2])?,
    ];
    let temperature = if find(known.names[3]).is_some() {
        Some(column(known.names[3])?)
    } else {
        None
    };
    let mut raw = Raw {
        temperature_c: temperature.as_ref().map(|_| Vec::new()),
        ..Raw::default()
    };
    for (k, ((t, v), i)) in time.iter().zip(&voltage).zip(&current).enumerate() {
        raw.push(k + 1, [*t, *v, *i], temperature.as_ref().map(|all| all[k]));
    }
    Ok((raw, known.sign))
}

/// A Parquet table of a cycler that [`KNOWN`] does not name.
fn frame_of_cycler(
    path: &Path,
    frame: &DataFrame,
    columns: &Columns,
) -> Result<(Raw, Option<CurrentSign>), SeriesReadError> {
    let column = |found: &Found, name: &'static str| {
        let values = values(path, frame, Some(found.index), name)?;
        Ok::<Vec<f64>, SeriesReadError>(values.iter().map(|value| value * found.factor).collect())
    };
    let (time_s, voltage_v, current_a) = (
        column(&columns.time, "time")?,
        column(&columns.voltage, "voltage")?,
        column(&columns.current, "current")?,
    );
    let temperature = columns.temperature.as_ref();
    let temperature_c = temperature
        .map(|found| column(found, "temperature"))
        .transpose()?;
    let mut raw = Raw {
        temperature_c: temperature_c.as_ref().map(|_| Vec::new()),
        ..Raw::default()
    };
    for (k, ((t, v), i)) in time_s.iter().zip(&voltage_v).zip(&current_a).enumerate() {
        let temperature_c = temperature_c.as_ref().and_then(|all| all.get(k).copied());
        raw.push(k + 1, [*t, *v, *i], temperature_c);
    }
    let directed = raw.rows.iter().any(|row| row[2] < 0.0);
    Ok((raw, directed.then_some(CurrentSign::Charge)))
}

/// A file of the bench has a checksum, which its own reader looks at.
fn bench(path: &Path) -> Result<Raw, SeriesReadError> {
    let mut raw = Raw {
        temperature_c: Some(Vec::new()),
        ..Raw::default()
    };
    for (k, row) in dataset::read_series_parquet(path)?.into_iter().enumerate() {
        raw.push(
            k + 1,
            [row.time_s, row.voltage_v, row.current_a],
            Some(row.temperature_c),
        );
    }
    Ok(raw)
}

/// A column as floats; what is null is not a number.
fn values(
    path: &Path,
    frame: &DataFrame,
    index: Option<usize>,
    name: &'static str,
) -> Result<Vec<f64>, SeriesReadError> {
    let fail = |reason: String| SeriesReadError::Parquet {
        file: path.to_owned(),
        reason,
    };
    let column: &Column = index
        .and_then(|k| frame.columns().get(k))
        .ok_or_else(|| fail(format!("column {name} is not there")))?;
    let floats = column
        .cast(&DataType::Float64)
        .map_err(|e| fail(format!("column {name}: {e}")))?;
    let floats = floats
        .f64()
        .map_err(|e| fail(format!("column {name}: {e}")))?;
    Ok(floats.iter().map(|v| v.unwrap_or(f64::NAN)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::SeriesRow;
    use polars::prelude::{NamedFrom, ParquetWriter, Series};

    fn read(
        name: &str,
        bytes: &[u8],
        options: SeriesOptions,
    ) -> (String, Result<TimeSeries, SeriesReadError>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        (path.display().to_string(), read_series(&path, &options))
    }

    const CYCLER: &str =
        "Time,Voltage,Current,Total mAh,Temperature\n0.1,4.1,1.0,0.1,25.0\n0.6,4.0,1.5,0.2,\n";

    #[test]
    fn the_cycler_counts_by_its_file_name_or_by_order() {
        let charge = SeriesOptions {
            sign: Some(CurrentSign::Charge),
        };
        for (name, options, expected) in [
            ("x_discharge_1A.csv", SeriesOptions::default(), [1.0, 1.5]),
            ("x_Charge_6A.csv", SeriesOptions::default(), [-1.0, -1.5]),
            ("x_discharge_1A.csv", charge, [-1.0, -1.5]),
        ] {
            let series = read(name, CYCLER.as_bytes(), options).1.unwrap();
            assert_eq!(
                (series.current_a.as_slice(), series.voltage_v.as_slice()),
                (expected.as_slice(), [4.1, 4.0].as_slice())
            );
            let temperature = series.temperature_c.unwrap();
            assert!(temperature[0] == 25.0 && temperature[1].is_nan());
        }
        let (path, result) = read("x.csv", CYCLER.as_bytes(), SeriesOptions::default());
        let text = format!(
            "{path}: its currents have no sign; expected `discharge` or `charge` in the file name, \
            or the direction given"
        );
        assert_eq!(result.unwrap_err().to_string(), text);
    }

    #[test]
    fn bdf_counts_charge_positive_in_csv_and_parquet() {
        let text = "Voltage / V,Test Time / s,Current / A\n4.1,0,-2\n4.0,1,0.5\n3.9,2,\n";
        let series = read("x.bdf.csv", text.as_bytes(), SeriesOptions::default())
            .1
            .unwrap();
        assert_eq!(
            (series.current_a.as_slice(), series.time_s.as_slice()),
            ([2.0, -0.5].as_slice(), [0.0, 1.0].as_slice())
        );
        assert_eq!(series.temperature_c, None);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.bdf.csv");
        std::fs::write(&path, text).unwrap();
        let (_, left_out) = read_series_with_left_out(&path, &SeriesOptions::default()).unwrap();
        assert_eq!(
            left_out,
            [LeftOut {
                line: 4,
                time_s: 2.0,
                replaced: false
            }]
        );
        let arbin = "Data_Point,Test_Time(s),Current(A),Voltage(V)\n1,0,-2,4.1\n2,1,0.5,4.0\n";
        assert_eq!(
            read("x.csv", arbin.as_bytes(), SeriesOptions::default())
                .1
                .unwrap()
                .current_a,
            series.current_a
        );
        let mut frame = DataFrame::new_infer_height(vec![
            Series::new("Test Time / s".into(), [0i64, 1, 2]).into(),
            Series::new("Voltage / V".into(), [Some(4.1), Some(4.0), None]).into(),
            Series::new("Current / A".into(), [-2.0f32, 0.5, 0.0]).into(),
            Series::new("Surface Temperature T1 / degC".into(), [25.0, 26.0, 27.0]).into(),
        ])
        .unwrap();
        let mut bytes = Vec::new();
        ParquetWriter::new(&mut bytes).finish(&mut frame).unwrap();
        let parquet = read("x.bdf.parquet", &bytes, SeriesOptions::default())
            .1
            .unwrap();
        assert_eq!(
            (&parquet.current_a, &parquet.voltage_v),
            (&series.current_a, &series.voltage_v)
        );
        assert_eq!(parquet.temperature_c, Some(vec![25.0, 26.0]));
    }

    #[test]
    fn files_of_batterydf_are_read() {
        // Provenance beside the files: the first rows of a real one, and the same as Parquet.
        for name in ["landt.bdf.csv", "landt.bdf.parquet"] {
            let path = Path::new(concat!(
                env!("CARGO_MANIFEST_DIR"),
                "/../../fixtures/data/series"
            ))
            .join(name);
            let series = read_series(&path, &SeriesOptions::default()).unwrap();
            assert_eq!(
                (
                    series.time_s.len(),
                    series.time_s[1],
                    series.voltage_v[9],
                    series.current_a[0].abs()
                ),
                (10, 15.02, 2.921, 0.0),
                "{name}"
            );
            assert_eq!(series.temperature_c.unwrap()[3], 0.0, "{name}");
        }
    }

    #[test]
    fn a_comma_between_semicolons_is_a_decimal_point_here_too() {
        let text = "Test Time / s;Voltage / V;Current / A\n0;4,1;-2,5\n1,5;4,0;0\n";
        let series = read("x.bdf.csv", text.as_bytes(), SeriesOptions::default())
            .1
            .unwrap();
        assert_eq!(
            (series.time_s, series.voltage_v, series.current_a),
            (vec![0.0, 1.5], vec![4.1, 4.0], vec![2.5, -0.0])
        );
        let (path, mixed) = read(
            "x.csv",
            text.replace("4,0", "4.0").as_bytes(),
            SeriesOptions::default(),
        );
        let expected = "expected one decimal mark in all numbers, a comma or a point, met both \
        in \"1,5;4.0;0\"";
        assert_eq!(
            mixed.unwrap_err().to_string(),
            format!("{path}, line 3: {expected}")
        );
    }

    #[test]
    fn the_benchs_own_parquet_comes_back_with_discharge_positive() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("series.parquet");
        let row = |time_s: f64, current_a: f64| SeriesRow {
            time_s,
            voltage_v: 3.7,
            current_a,
            temperature_c: f64::NAN,
        };
        dataset::write_series_parquet(&path, &[row(0.0, -1.0), row(1.0, f64::NAN), row(2.0, 0.25)])
            .unwrap();
        let series = read_series(&path, &SeriesOptions::default()).unwrap();
        assert_eq!(
            (series.time_s.as_slice(), series.current_a.as_slice()),
            ([0.0, 2.0].as_slice(), [1.0, -0.25].as_slice())
        );
    }

    #[test]
    fn errors_name_the_place() {
        for (text, ending) in [
            (
                "Time,Voltage,Current\n0,4.1,1\n1,4.x,1\n",
                ", line 3, column 2 (Voltage): expected a finite number, met \"4.x\"",
            ),
            (
                "Time,Voltage,Current\n0,4.1,1\n1,4.1\n",
                ", line 3, column 3 (Current): expected a finite number, met the end of the line",
            ),
            (
                "Time,Voltage,Current\n0,4,1,1\n1,4,1,1\n",
                ", line 2, column 4: expected 3 fields, met 4",
            ),
            (
                "Time,Voltage,Current\n0,4.1,1\n,4.1,1\n",
                ", line 3, column 1 (Time): expected a finite number, met \"\"",
            ),
            (
                "Time,Voltage,Current\n1,4.1,1\n0,4.1,1\n",
                ": time series \"discharge.csv\", sample 2 (counted from 1): expected times in s \
                that rise, met 0",
            ),
            (
                "t,u,i\n0,4.1,1\n",
                ", line 1: expected the columns \"time_s,voltage_v,current_a\", \"Test Time / \
                s,Voltage / V,Current / A\", \
                 \"Test_Time(s),Voltage(V),Current(A)\" or \"Time,Voltage,Current\", met \"t,u,i\"",
            ),
        ] {
            let (path, result) = read("discharge.csv", text.as_bytes(), SeriesOptions::default());
            assert_eq!(result.unwrap_err().to_string(), format!("{path}{ending}"));
        }
        let damaged = read(
            "x.parquet",
            b"PAR1 and nothing more",
            SeriesOptions::default(),
        )
        .1
        .unwrap_err()
        .to_string();
        assert!(
            damaged.contains("expected Parquet with columns of numbers"),
            "{damaged}"
        );
    }
}
