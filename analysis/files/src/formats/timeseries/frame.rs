//! A record from Parquet: the bench's own, and tables with the names of cyclers.

use super::super::parquet;
use super::super::text::{self, shorten};
use super::agreement::{self, COUNTED, Open};
use super::columns::{self, Columns, direction_of};
use super::error::SeriesReadError;
use super::moment::Stamp;
use super::near;
use super::raw::{self, QUANTITIES, Quantity, Raw};
use crate::dataset;
use polars::prelude::{Column, DataFrame, DataType, ParquetReader, SerReader, TimeUnit};
use std::path::Path;

/// Columns of the bench's own files, which contain a checksum.
const BENCH: [&str; 3] = ["time_s", "voltage_v", "current_a"];
/// Quantities that are plain numbers.
const NUMBERS: [Quantity; 11] = [
    Quantity::Capacity,
    Quantity::Voltage,
    Quantity::Current,
    Quantity::Temperature,
    Quantity::ChargeAh,
    Quantity::DischargeAh,
    Quantity::Step,
    Quantity::Soc,
    Quantity::Dod,
    Quantity::Ambient,
    Quantity::NetAh,
];

/// Reads Parquet.
///
/// # Errors
/// Returns an error for bytes that cannot be decoded, a table without such columns, and columns
/// that contradict each other.
pub(super) fn read(path: &Path, bytes: Vec<u8>) -> Result<Raw, SeriesReadError> {
    let reader = ParquetReader::new(std::io::Cursor::new(bytes));
    let frame = parquet::decode(|| reader.finish()).map_err(|reason| failed(path, reason))?;
    let names: Vec<&str> = frame
        .get_column_names()
        .iter()
        .map(|name| name.as_str())
        .collect();
    let has = |wanted: &str| names.iter().any(|name| name.eq_ignore_ascii_case(wanted));
    if BENCH.iter().all(|name| has(name)) {
        return bench(path);
    }
    let columns = columns::columns(&names, None).ok_or_else(|| {
        let line = names.join("\t");
        let lacks = near::near_miss(&[line.as_str()]);
        let lacks = lacks.map_or_else(String::new, |(_, lacks)| format!(": {lacks}"));
        SeriesReadError::UnknownFormat {
            file: path.to_owned(),
            place: String::new(),
            met: format!("{}{lacks}", shorten(&names.join(","))),
        }
    })?;
    of_columns(path, &frame, &columns)
}

/// A file of the bench has a checksum, which its own reader verifies.
fn bench(path: &Path) -> Result<Raw, SeriesReadError> {
    let mut present = [false; QUANTITIES];
    for quantity in [
        Quantity::Time,
        Quantity::Voltage,
        Quantity::Current,
        Quantity::Temperature,
    ] {
        present[quantity as usize] = true;
    }
    let mut raw = Raw::with(present);
    raw.charge_positive = true;
    for (k, row) in dataset::read_series_parquet(path)?.into_iter().enumerate() {
        let mut values = [f64::NAN; QUANTITIES];
        values[Quantity::Time as usize] = row.time_s;
        values[Quantity::Voltage as usize] = row.voltage_v;
        values[Quantity::Current as usize] = row.current_a;
        values[Quantity::Temperature as usize] = row.temperature_degc;
        raw.push(k + 1, values);
    }
    Ok(raw)
}

fn of_columns(path: &Path, frame: &DataFrame, columns: &Columns) -> Result<Raw, SeriesReadError> {
    let mut all: [Option<Vec<f64>>; QUANTITIES] = Default::default();
    for quantity in NUMBERS {
        all[quantity as usize] = match columns.get(quantity) {
            None => None,
            Some(found) => {
                let factor = found.unit.unwrap_or(1.0);
                let values = numbers(path, column(path, frame, found.index)?)?;
                let scaled = |value: f64| {
                    if text::is_measured(value) {
                        value * factor
                    } else {
                        f64::NAN
                    }
                };
                Some(values.into_iter().map(scaled).collect())
            }
        };
    }
    let wall = columns
        .get(Quantity::Wall)
        .map(|found| times(path, frame, found.index))
        .transpose()?;
    all[Quantity::Wall as usize] = wall.map(|(stamps, _)| stamps);
    let mut times_of = Vec::new();
    for found in &columns.times {
        let (stamps, kind) = times(path, frame, found.index)?;
        let factor = found.unit.filter(|_| kind == Kind::Number).unwrap_or(1.0);
        let start_s = if kind == Kind::Date {
            stamps.first().copied().unwrap_or(0.0)
        } else {
            0.0
        };
        let stamps: Vec<f64> = stamps.iter().map(|t| (t - start_s) * factor).collect();
        times_of.push((found, stamps, kind));
    }
    let moves: Vec<Option<usize>> = times_of
        .iter()
        .map(|(_, stamps, _)| count_moves(stamps))
        .collect();
    let chosen = raw::most_moving(&moves).unwrap_or(0);
    if chosen >= times_of.len() {
        return Err(failed(path, "no column of a time".to_owned()));
    }
    let (time, stamps, kind) = times_of.swap_remove(chosen);
    all[Quantity::Time as usize] = Some(stamps);
    all[Quantity::State as usize] = state(frame, columns);
    let present = std::array::from_fn(|k| all[k].is_some());
    let mut raw = Raw::with(present);
    for k in 0..frame.height() {
        let value = |one: &Option<Vec<f64>>| one.as_ref().map_or(f64::NAN, |values| values[k]);
        raw.push(k + 1, std::array::from_fn(|quantity| value(&all[quantity])));
    }
    raw.charge_positive = columns.charge_positive;
    raw.notes.extend(columns.not_the_surest(time));
    let plain = |quantity| {
        let found = columns.get(quantity);
        found
            .filter(|found| found.unit.is_none())
            .map(|found| found.title.clone())
    };
    let open = Open {
        time: (kind == Kind::Number && time.unit.is_none()).then(|| time.title.clone()),
        voltage: plain(Quantity::Voltage),
        current: plain(Quantity::Current),
        maccor: columns.maccor,
        capacity: COUNTED
            .into_iter()
            .filter_map(|quantity| columns.get(quantity))
            .all(|found| found.unit.is_some()),
    };
    agreement::settle(path, &mut raw, &open)?;
    Ok(raw)
}

/// Returns how often a time increases; `None` if it decreases or contains NaN.
fn count_moves(stamps: &[f64]) -> Option<usize> {
    let rises = stamps.windows(2).all(|pair| pair[1] >= pair[0]);
    let moves = stamps.windows(2).filter(|pair| pair[1] > pair[0]).count();
    rises.then_some(moves)
}

/// Kind of a column of times.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// In the unit of its name.
    Number,
    /// Seconds of a clock.
    Clock,
    /// Seconds since 1970.
    Date,
}

/// Returns the times of a column, in its unit or in s.
fn times(
    path: &Path,
    frame: &DataFrame,
    index: usize,
) -> Result<(Vec<f64>, Kind), SeriesReadError> {
    let column = column(path, frame, index)?;
    let per_s = |unit: &TimeUnit| match unit {
        TimeUnit::Nanoseconds => 1.0e9,
        TimeUnit::Microseconds => 1.0e6,
        TimeUnit::Milliseconds => 1.0e3,
    };
    let (unit, kind) = match column.dtype() {
        DataType::Datetime(unit, _) => (per_s(unit), Kind::Date),
        DataType::Duration(unit) => (per_s(unit), Kind::Clock),
        DataType::String => {
            let words = column
                .str()
                .map_err(|error| failed(path, error.to_string()))?;
            let stamps: Vec<Option<Stamp>> = words
                .iter()
                .map(|word| Stamp::of(word.unwrap_or_default(), '\t'))
                .collect();
            let kind = match stamps.iter().flatten().next() {
                Some(Stamp::Date(_)) => Kind::Date,
                Some(Stamp::Clock(_)) => Kind::Clock,
                _ => Kind::Number,
            };
            let seconds = |stamp: Option<Stamp>| stamp.map_or(f64::NAN, |stamp| stamp.seconds(1.0));
            return Ok((stamps.into_iter().map(seconds).collect(), kind));
        }
        _ => {
            let values = numbers(path, column)?;
            let is_wall = columns::is_wall(column.name());
            let wall = |value: f64| {
                if is_wall {
                    Stamp::Number(value).wall_s()
                } else {
                    value
                }
            };
            let kind = if is_wall { Kind::Date } else { Kind::Number };
            return Ok((values.into_iter().map(wall).collect(), kind));
        }
    };
    let whole = column
        .cast(&DataType::Int64)
        .map_err(|error| failed(path, error.to_string()))?;
    let values = numbers(path, &whole)?;
    Ok((values.into_iter().map(|value| value / unit).collect(), kind))
}

/// Returns directions from the words of the first column that contains any.
fn state(frame: &DataFrame, columns: &Columns) -> Option<Vec<f64>> {
    columns.states.iter().find_map(|index| {
        let column = frame.columns().get(*index)?.cast(&DataType::String).ok()?;
        let words = column.str().ok()?;
        let all: Vec<f64> = words
            .iter()
            .map(|word| direction_of(word.unwrap_or_default()))
            .collect();
        all.iter().any(|word| word.abs() == 1.0).then_some(all)
    })
}

fn column<'a>(
    path: &Path,
    frame: &'a DataFrame,
    index: usize,
) -> Result<&'a Column, SeriesReadError> {
    frame
        .columns()
        .get(index)
        .ok_or_else(|| failed(path, format!("column {} is not there", index + 1)))
}

/// Returns a column as floats; null becomes NaN.
fn numbers(path: &Path, column: &Column) -> Result<Vec<f64>, SeriesReadError> {
    let fail = |error: polars::prelude::PolarsError| {
        failed(path, format!("column {}: {error}", column.name()))
    };
    let floats = column.cast(&DataType::Float64).map_err(fail)?;
    let floats = floats.f64().map_err(fail)?;
    Ok(floats
        .iter()
        .map(|value| value.unwrap_or(f64::NAN))
        .collect())
}

fn failed(path: &Path, reason: String) -> SeriesReadError {
    SeriesReadError::Parquet {
        file: path.to_owned(),
        reason,
    }
}
