//! The tables that grow during the run: events, readings, bath and bounds.

use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::Path,
};

use analysis_files::{
    dataset::{self, SeriesRow},
    run_folder::{
        BATH, BATH_COLUMNS, BathRow, Between, ENVELOPE, ENVELOPE_COLUMNS, EVENT_COLUMNS, EVENTS,
        EnvelopeRow, READING_COLUMNS, READINGS, READINGS_PARQUET, ReadingRow,
    },
};

use instruments::units::{Amps, Celsius, Volts};

use super::{
    error::{RecordError, io},
    folder::Folder,
};
use bench_plan::interlock::{Limits, Reading};

/// The tables, and the readings with all their digits.
pub(super) struct Tables {
    events: BufWriter<File>,
    readings: BufWriter<File>,
    bath: LateTable,
    envelope: LateTable,
    /// Limits in its last row.
    bounded: Option<Limits>,
    series: Vec<SeriesRow>,
}

impl Tables {
    /// Creates the tables of events and readings.
    pub(super) fn create(folder: &Folder) -> Result<Self, RecordError> {
        let mut events = create(&folder.file(EVENTS))?;
        let mut readings = create(&folder.file(READINGS))?;
        line(&mut events, &folder.file(EVENTS), EVENT_COLUMNS)?;
        line(&mut readings, &folder.file(READINGS), READING_COLUMNS)?;
        Ok(Self {
            events,
            readings,
            bath: LateTable::new(BATH, BATH_COLUMNS),
            envelope: LateTable::new(ENVELOPE, ENVELOPE_COLUMNS),
            bounded: None,
            series: Vec::new(),
        })
    }

    /// Opens the tables of a resumed run for appending.
    pub(super) fn reopen(folder: &Folder) -> Result<Self, RecordError> {
        Ok(Self {
            events: append(&folder.file(EVENTS))?,
            readings: append(&folder.file(READINGS))?,
            bath: LateTable::new(BATH, BATH_COLUMNS),
            envelope: LateTable::new(ENVELOPE, ENVELOPE_COLUMNS),
            bounded: None,
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
            time_s: reading.time_s.0,
            phase,
            voltage_v: reading.voltage_v.map(Volts::value),
            current_a: reading.current_a.map(Amps::value),
            temperature_degc: reading.temperature_degc.map(Celsius::value),
        };
        self.series.push(in_numbers(&row));
        folder.room(READINGS)?;
        line(&mut self.readings, &folder.file(READINGS), &row.row())
    }

    /// Writes a row of the bath.
    pub(super) fn bath(&mut self, folder: &Folder, row: &BathRow) -> Result<(), RecordError> {
        self.bath.row(folder, &row.row())
    }

    /// Writes a row of the bounds, if they differ from the previous row.
    pub(super) fn envelope(
        &mut self,
        folder: &Folder,
        time_s: f64,
        limits: &Limits,
    ) -> Result<(), RecordError> {
        if self.bounded.as_ref() == Some(limits) {
            return Ok(());
        }
        let row = EnvelopeRow {
            time_s,
            voltage_v: Between::of(limits.min_v.0, limits.max_v.0),
            current_a: Between::of((-limits.discharge_a).0, limits.charge_a.0),
            temperature_degc: Between::of(limits.min_degc.0, limits.max_degc.0),
        };
        self.envelope.row(folder, &row.row())?;
        self.bounded = Some(*limits);
        Ok(())
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

/// A table that is created with its first row: a bench without a chiller has no bath, and the
/// folder of an older run has none of these tables.
struct LateTable {
    name: &'static str,
    columns: &'static str,
    writer: Option<BufWriter<File>>,
}

impl LateTable {
    /// Creates a table without a row from this process.
    fn new(name: &'static str, columns: &'static str) -> Self {
        Self {
            name,
            columns,
            writer: None,
        }
    }

    /// Appends a row.
    fn row(&mut self, folder: &Folder, row: &str) -> Result<(), RecordError> {
        folder.room(self.name)?;
        let path = folder.file(self.name);
        let mut writer = match self.writer.take() {
            Some(writer) => writer,
            None => begun(&path, self.columns)?,
        };
        let written = line(&mut writer, &path, row);
        self.writer = Some(writer);
        written
    }
}

/// Opens a table for appending; a new or empty one gets its columns.
fn begun(path: &Path, columns: &str) -> Result<BufWriter<File>, RecordError> {
    let mut writer = append(path)?;
    let meta = writer.get_ref().metadata();
    if meta.map_err(io(path, "cannot be read"))?.len() == 0 {
        line(&mut writer, path, columns)?;
    }
    Ok(writer)
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

/// Returns the readings so far, with the digits of the table. No finished point depends on them:
/// invalid rows are skipped with a message.
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

/// Converts a reading to numbers; a missing value is not a number.
fn in_numbers(row: &ReadingRow<'_>) -> SeriesRow {
    SeriesRow {
        time_s: row.time_s,
        voltage_v: row.voltage_v.unwrap_or(f64::NAN),
        current_a: row.current_a.unwrap_or(f64::NAN),
        temperature_degc: row.temperature_degc.unwrap_or(f64::NAN),
    }
}

#[cfg(test)]
mod tests {
    use instruments::clock::{Clock, TimeMode};

    use super::*;
    use crate::record::Recorder;
    use bench_plan::interlock::Limits;

    const LIMITS: Limits = Limits {
        min_v: Volts(2.5),
        max_v: Volts(4.2),
        charge_a: Amps(0.1),
        discharge_a: Amps(5.0),
        min_degc: Celsius::NEG_INFINITY,
        max_degc: Celsius(60.0),
    };

    /// Returns the rows of a table without their times.
    fn rows(recorder: &Recorder, name: &str) -> Vec<String> {
        let text = fs::read_to_string(recorder.path(name)).unwrap();
        let row = |line: &str| line.split_once(',').unwrap().1.to_owned();
        text.lines().map(row).collect()
    }

    #[test]
    fn bath_and_bounds_have_a_head_from_their_first_row_on() {
        let folder = tempfile::tempdir().unwrap();
        let clock = Clock::start(TimeMode::Virtual);
        let mut recorder = Recorder::create(&folder.path().join("run"), clock).unwrap();
        assert!(!recorder.path(BATH).exists() && !recorder.path(ENVELOPE).exists());
        recorder.bath(None, Some(Celsius(25.0)));
        recorder.bath(Some(Celsius(24.5)), Some(Celsius(25.0)));
        recorder.bath(Some(Celsius::NAN), None);
        let expected = ["bath_c,setpoint_c", ",25.0000", "24.5000,25.0000", ","];
        assert_eq!(rows(&recorder, BATH), expected);
        // Bounds are written once as long as they do not change.
        recorder.envelope(&LIMITS);
        recorder.envelope(&LIMITS);
        recorder.envelope(&LIMITS.bounded(Amps(0.1), Amps(1.0)));
        let written = &rows(&recorder, ENVELOPE)[1..];
        let expected = [
            "2.500000,4.200000,-5.000000,0.100000,,60.000000",
            "2.500000,4.200000,-1.000000,0.100000,,60.000000",
        ];
        assert_eq!(written, expected);
    }

    #[test]
    fn a_table_goes_on_behind_what_another_process_has_written() {
        let temporary = tempfile::tempdir().unwrap();
        let folder = Folder::new(temporary.path());
        for text in ["1.000,24.0,25.0", "2.000,24.5,25.0"] {
            LateTable::new(BATH, BATH_COLUMNS)
                .row(&folder, text)
                .unwrap();
        }
        let text = fs::read_to_string(folder.file(BATH)).unwrap();
        let expected = format!("{BATH_COLUMNS}\n1.000,24.0,25.0\n2.000,24.5,25.0\n");
        assert_eq!(text, expected);
    }
}
