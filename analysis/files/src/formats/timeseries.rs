//! Reads current and voltage over time from files of cyclers and of the bench. The format is
//! recognised by the content.
//!
//! * text and spreadsheets with the names that programs write (`columns`): the bench's own, BDF, Arbin,
//!   Basytec, EC-Lab, Digatron, Gamry, Maccor, Neware, Novonix, PEC, TRI, the thesis' cycler
//! * Parquet with these names, the bench's own with its checksum
//! * EC-Lab's `.mpr`, MATLAB's `.mat`, Neware's `.nda` and `.ndax`
//!
//! The result is positive for discharge: `direction` determines the sign convention of the file, for
//! all readers. Redundant columns are compared (`agreement`). Rows whose voltage or current is empty,
//! NaN or an overload were not measured and are left out. Of several rows at the same time, which
//! cyclers write at the end of a step, the last is kept. Columns may have any order; others are
//! skipped.

mod agreement;
mod columns;
#[cfg(test)]
#[path = "timeseries/tests.rs"]
mod cyclers_tests;
mod direction;
mod error;
mod evidence;
mod frame;
mod head;
#[cfg(test)]
mod kinds;
mod moment;
mod names;
mod near;
mod parts;
mod raw;
mod state;
#[cfg(test)]
mod study;
mod table;

use self::direction::{Fault, Known};
use self::raw::{Quantity, Raw};
use super::spreadsheet::{self, Sheet};
use super::{mat, mpr, neware};
use analysis_signal::series::TimeSeries;
pub use error::SeriesReadError;
pub use parts::{CurrentSign, Fact, Head, LeftOut};
pub use state::State;
use std::path::Path;

/// Options of reading a time series.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SeriesOptions {
    /// Direction that the file counts positive; overrides the content of the file.
    pub sign: Option<CurrentSign>,
}

/// One row in this many may share its time with the next without a remark.
const REPEATED: usize = 20;

/// A record, and remarks on how it was read.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadSeries {
    /// The record, discharge positive.
    pub series: TimeSeries,
    /// Rows that were left out.
    pub left_out: Vec<LeftOut>,
    /// Numbers of the cycler's steps, one for each row, if the file has them.
    pub steps: Option<Vec<f64>>,
    /// State of the cell from the file.
    pub state: State,
    /// Remarks on the interpretation of columns, each a sentence with the file's name.
    pub notes: Vec<String>,
}

/// Reads a time series; its name is the file name without folder.
///
/// # Errors
/// [`SeriesReadError`] if the file cannot be read, has no known format, contains values that cannot
/// be measurements, contradicts itself, or does not determine its direction.
pub fn read_series(path: &Path, options: &SeriesOptions) -> Result<TimeSeries, SeriesReadError> {
    read_record(path, options).map(|read| read.series)
}

/// Like [`read_series`], with remarks on how it was read.
///
/// # Errors
/// As [`read_series`].
pub fn read_record(path: &Path, options: &SeriesOptions) -> Result<ReadSeries, SeriesReadError> {
    let bytes = std::fs::read(path).map_err(|source| SeriesReadError::Read {
        file: path.to_owned(),
        source,
    })?;
    let mut raw = if bytes.starts_with(b"PAR1") {
        frame::read(path, bytes)?
    } else if let Some(decoded) = neware::text(path, &bytes) {
        let neware::Decoded { text, mut notes } = decoded?;
        let mut raw = table::read(path, text.as_bytes())?;
        raw.notes.append(&mut notes);
        raw
    } else {
        match spreadsheet::sheets(path, &bytes) {
            Some(sheets) => of_sheets(path, &sheets?)?,
            None => of_text(path, &bytes)?,
        }
    };
    rises(path, &raw)?;
    let known = Known {
        stated: options.sign,
        named: named(path),
    };
    let directed = direction::discharge_positive(&mut raw, known);
    let current_a = directed.map_err(|fault| match fault {
        Fault::Unknown(detail) => SeriesReadError::Sign {
            file: path.to_owned(),
            detail,
        },
        Fault::Contradiction(row, met) => SeriesReadError::Contradiction {
            file: path.to_owned(),
            line: raw.line(row),
            met,
        },
    })?;
    let file = path
        .file_name()
        .map_or_else(|| "series".to_owned(), |n| n.to_string_lossy().into_owned());
    let (state, temperature_degc) = state::take(&mut raw);
    let mut read = ReadSeries {
        state,
        left_out: std::mem::take(&mut raw.left_out),
        steps: raw.take(Quantity::Step),
        notes: raw
            .notes
            .iter()
            .map(|note| format!("{file}: {note}"))
            .collect(),
        series: TimeSeries {
            name: file.clone(),
            time_s: raw.take(Quantity::Time).unwrap_or_default(),
            voltage_v: raw.take(Quantity::Voltage).unwrap_or_default(),
            current_a,
            temperature_degc,
        },
    };
    let unmeasured: Vec<usize> = read
        .left_out
        .iter()
        .filter(|row| !row.replaced)
        .map(|row| row.line)
        .collect();
    if let [first, ..] = unmeasured.as_slice() {
        let count = unmeasured.len();
        read.notes.push(format!(
            "{file}: {count} rows without a measured voltage or current are left out, the first in \
             line {first}"
        ));
    }
    // One extra row at the end of each step is usual.
    let replaced = read.left_out.iter().filter(|row| row.replaced).count();
    if REPEATED * replaced > read.series.len() {
        read.notes.push(format!(
            "{file}: the time stands still in {replaced} rows, of which {} are kept: the last at each time",
            read.series.len()
        ));
    }
    let valid = read.series.validate();
    valid.map_err(|source| SeriesReadError::Series {
        file: path.to_owned(),
        source,
    })?;
    Ok(read)
}

/// Refuses times that decrease: either a second record begins, or the column is not the test time.
fn rises(path: &Path, raw: &Raw) -> Result<(), SeriesReadError> {
    let times = raw.get(Quantity::Time);
    let Some(row) = (1..times.len()).find(|row| times[*row] < times[*row - 1]) else {
        return Ok(());
    };
    Err(SeriesReadError::Order {
        file: path.to_owned(),
        line: raw.line(row),
        met: format!(
            "{} behind {}; if the file holds several records, split it there, otherwise name the \
             time since the start of the test \"Test Time / s\"",
            times[row],
            times[row - 1]
        ),
    })
}

/// Reads the record of a text, or of a binary file that is converted to text.
fn of_text(path: &Path, bytes: &[u8]) -> Result<Raw, SeriesReadError> {
    if let Some(text) = mpr::text(path, bytes) {
        return table::read(path, text?.as_bytes());
    }
    let Some(decoded) = mat::decode(path, bytes) else {
        return table::read(path, bytes);
    };
    let mat::Decoded { text, note } = decoded?;
    let mut raw = table::read(path, text.as_bytes())?;
    raw.notes.extend(note);
    Ok(raw)
}

/// Returns the direction of a record from the name of its file.
fn named(path: &Path) -> Option<CurrentSign> {
    let name = path.file_name()?.to_string_lossy().to_lowercase();
    let discharge = name.contains("discharge");
    // A name with both words is ambiguous.
    match (discharge, name.replace("discharge", "").contains("charge")) {
        (true, true) | (false, false) => None,
        (true, false) => Some(CurrentSign::Discharge),
        (false, true) => Some(CurrentSign::Charge),
    }
}

/// Reads the record of the sheets that contain one; a record continues in sheets with the same
/// columns.
fn of_sheets(path: &Path, sheets: &[Sheet]) -> Result<Raw, SeriesReadError> {
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
        let lacks = sheets.iter().find_map(|sheet| {
            let lines: Vec<&str> = sheet.text.lines().collect();
            let (at, lacks) = near::near_miss(&lines)?;
            Some(format!(
                "; nearest is {}, line {}: {lacks}",
                sheet.name,
                at + 1
            ))
        });
        let (met, lacks) = (
            names().collect::<Vec<_>>().join(", "),
            lacks.unwrap_or_default(),
        );
        return Err(unknown(format!(
            "the sheets {met}, and no such columns{lacks}"
        )));
    };
    if let Some((other, _)) = named.iter().find(|(_, header)| header != first) {
        let (one, other) = (&named[0].0.name, &other.name);
        return Err(unknown(format!(
            "the sheets {one} and {other}, both with such columns, but not the same"
        )));
    }
    let mut all = Raw::default();
    for (sheet, _) in &named {
        all.append(table::read(&sheet.path, sheet.text.as_bytes())?);
    }
    Ok(all)
}

/// Returns the line, from 0, that names the columns of a record over time.
pub(super) fn names_a_series(lines: &[&str]) -> Option<usize> {
    columns::header(lines).map(|(at, _)| at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::{self, SeriesRow};
    use polars::prelude::{DataFrame, NamedFrom, ParquetWriter, Series};

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
            let temperature = series.temperature_degc.unwrap();
            assert!(temperature[0] == 25.0 && temperature[1].is_nan());
        }
        let (path, result) = read("x.csv", CYCLER.as_bytes(), SeriesOptions::default());
        let message = result.unwrap_err().to_string();
        assert!(
            message.starts_with(&format!("{path}: its currents are all of one sign")),
            "{message}"
        );
        assert!(message.contains("--positive discharge"), "{message}");
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
        assert_eq!(series.temperature_degc, None);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.bdf.csv");
        std::fs::write(&path, text).unwrap();
        let left_out = read_record(&path, &SeriesOptions::default())
            .unwrap()
            .left_out;
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
        assert_eq!(parquet.temperature_degc, Some(vec![25.0, 26.0]));
    }

    #[test]
    fn a_net_capacity_with_its_unit_is_a_counter_of_the_charge() {
        let rows = "\n0,0,4.1,0.5\n1,-2,4.0,0.4997\n2,-2,3.99,\n";
        let net_ah = |unit: &str| {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("x.bdf.csv");
            let text = format!("Test Time / s,Current / A,Voltage / V,Net Capacity{unit}{rows}");
            std::fs::write(&path, text).unwrap();
            let read = read_record(&path, &SeriesOptions::default()).unwrap();
            read.state.net_ah
        };
        let met = net_ah(" / Ah").unwrap();
        assert!(met[..2] == [0.5, 0.4997] && met[2].is_nan(), "{met:?}");
        assert!((net_ah(" / mAh").unwrap()[1] - 0.4997e-3).abs() < 1e-12);
        assert_eq!(net_ah(""), None);
    }

    #[test]
    fn a_time_of_parquet_that_stands_still_beside_a_clock_is_passed_over() {
        let mut frame = DataFrame::new_infer_height(vec![
            Series::new("test_time_second".into(), [0.0, 0.0, 0.0]).into(),
            Series::new("unix_time_second".into(), [1.7e9, 1.7e9 + 1.0, 1.7e9 + 2.5]).into(),
            Series::new("voltage_volt".into(), [4.1, 4.0, 3.9]).into(),
            Series::new("current_ampere".into(), [-2.0, 0.5, 0.0]).into(),
        ])
        .unwrap();
        let mut bytes = Vec::new();
        ParquetWriter::new(&mut bytes).finish(&mut frame).unwrap();
        let series = read("x.bdf.parquet", &bytes, SeriesOptions::default())
            .1
            .unwrap();
        assert_eq!(series.time_s, [0.0, 1.0, 2.5]);
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
            assert_eq!(series.temperature_degc.unwrap()[3], 0.0, "{name}");
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
            temperature_degc: f64::NAN,
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
                ", line 3: expected times in s that rise, met 0 behind 1; if the file holds several \
                 records, split it there, otherwise name the time since the start of the test \"Test \
                 Time / s\"",
            ),
            (
                "t,u,i\n0,4.1,1\n",
                ", line 1: expected columns of a time, a voltage and a current, such as \"Test Time / \
                 s,Voltage / V,Current / A\", met \"t,u,i\"",
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
