//! The tables that grow while the run goes on: events and readings.

use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::Path,
};

use analysis::{
    dataset::{self, SeriesRow},
    run_folder::{EVENT_COLUMNS, EVENTS, READING_COLUMNS, READINGS, READINGS_PARQUET, ReadingRow},
};

use super::{
    error::{RecordError, io},
    folder::Folder,
};
use crate::interlock::Reading;

/// The tables of events and readings, and the readings with all their digits.
pub(super) struct Tables {
    events: BufWriter<File>,
    readings: BufWriter<File>,
    series: Vec<SeriesRow>,
}

impl Tables {
    /// Makes both tables.
    pub(super) fn create(folder: &Folder) -> Result<Self, RecordError> {
        let mut events = create(&folder.file(EVENTS))?;
        let mut readings = create(&folder.file(READINGS))?;
        line(&mut events, &folder.file(EVENTS), EVENT_COLUMNS)?;
        line(&mut readings, &folder.file(READINGS), READING_COLUMNS)?;
        Ok(Self {
            events,
            readings,
            series: Vec::new(),
        })
    }

    /// Opens both tables of a run that is resumed, behind what is there.
    pub(super) fn reopen(folder: &Folder) -> Result<Self, RecordError> {
        Ok(Self {
            events: append(&folder.file(EVENTS))?,
            readings: append(&folder.file(READINGS))?,
            series: readings(&folder.file(READINGS)),
        })
    }

    /// Writes a row of the events.
    pub(super) fn event(&mut self, folder: &Folder, row: &str) -> Result<(), RecordError> {
        folder.room(EVENTS)?;
        line(&mut self.events, &folder.file(EVENTS), row)
    }

    /// Writes a reading.
    pub(super) fn reading(
        &mut self,
        folder: &Folder,
        phase: &str,
        reading: &Reading,
    ) -> Result<(), RecordError> {
        let row = ReadingRow {
            time_s: reading.time_s,
            phase,
            voltage_v: reading.voltage_v,
            current_a: reading.current_a,
            temperature_c: reading.temperature_c,
        };
        self.series.push(in_numbers(&row));
        folder.room(READINGS)?;
        line(&mut self.readings, &folder.file(READINGS), &row.row())
    }

    /// Writes all readings again as one table with full digits.
    pub(super) fn finish(&self, folder: &Folder) -> Result<(), RecordError> {
        folder.room(READINGS_PARQUET)?;
        Ok(dataset::write_series_parquet(
            &folder.file(READINGS_PARQUET),
            &self.series,
        )?)
    }
}

fn create(path: &Path) -> Result<BufWriter<File>, RecordError> {
    File::create(path)
        .map(BufWriter::new)
        .map_err(io(path, "cannot be made"))
}

fn line(writer: &mut BufWriter<File>, path: &Path, text: &str) -> Result<(), RecordError> {
    writeln!(writer, "{text}")
        .and_then(|()| writer.flush())
        .map_err(io(path, "cannot be written"))
}

fn append(path: &Path) -> Result<BufWriter<File>, RecordError> {
    File::options()
        .append(true)
        .create(true)
        .open(path)
        .map(BufWriter::new)
        .map_err(io(path, "cannot be opened"))
}

/// The readings so far, with the digits of the table. No finished point depends on them: rows that
/// are none are left out, and said.
fn readings(path: &Path) -> Vec<SeriesRow> {
    let bytes = fs::read(path).unwrap_or_default();
    let text = String::from_utf8_lossy(&bytes);
    let rows = text
        .lines()
        .skip(1)
        .map(|line| Some(in_numbers(&ReadingRow::parse_whole(line)?)));
    let lost = rows.clone().filter(Option::is_none).count();
    if lost > 0 {
        tracing::warn!(
            "{}: {lost} rows cannot be read and are left out of the readings",
            path.display()
        );
    }
    rows.flatten().collect()
}

/// A reading in numbers; what was not read is not a number.
fn in_numbers(row: &ReadingRow<'_>) -> SeriesRow {
    SeriesRow {
        time_s: row.time_s,
        voltage_v: row.voltage_v.unwrap_or(f64::NAN),
        current_a: row.current_a.unwrap_or(f64::NAN),
        temperature_c: row.temperature_c.unwrap_or(f64::NAN),
    }
}
