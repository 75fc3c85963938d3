//! Opens the folder of a resumed run. Incomplete rows are cut off, written values are read back,
//! and both are compared with the journal.

use std::{
    fs::{self, File},
    path::Path,
};

use analysis_files::{
    dataset::{self, RunIndex},
    run_folder::{
        BATH, CAPTURES, ENVELOPE, EVENT_COLUMNS, EVENTS, INDEX, LOG, READINGS, TRANSCRIPTS,
    },
};
use analysis_signal::spectrum::ImpedancePoint;
use instruments::clock::Clock;

use super::{
    Recorder,
    error::{RecordError, io},
    folder::Folder,
    tables::Tables,
    warnings::Warnings,
};
use crate::{
    journal::replay::JournalReplay,
    journal::{Journal, PointDone, Read},
};
use bench_plan::support::hash;

impl Recorder {
    /// Opens the folder of a run that is resumed. Cuts off what follows the last complete row of a
    /// table.
    ///
    /// # Errors
    /// Fails if files cannot be read or written, or were not written by a run.
    pub fn reopen(
        folder: &Path,
        clock: Clock,
        read: &Read,
        replay: &JournalReplay,
    ) -> Result<Self, RecordError> {
        let journal = Journal::reopen(folder, &clock, read)?;
        for name in [EVENTS, READINGS, BATH, ENVELOPE, LOG] {
            cut_torn_line(&folder.join(name))?;
        }
        let events = folder.join(EVENTS);
        let columns = fs::read_to_string(&events).unwrap_or_default();
        let columns = columns.lines().next().unwrap_or_default();
        // The process was killed before the first line was complete.
        if columns.is_empty() {
            fs::write(&events, format!("{EVENT_COLUMNS}\n"))
                .map_err(io(&events, "cannot be written"))?;
        } else if columns != EVENT_COLUMNS {
            return Err(differs(
                &events,
                &format!("the columns {EVENT_COLUMNS}"),
                &columns,
            ));
        }
        let transcripts = folder.join(TRANSCRIPTS);
        for entry in fs::read_dir(&transcripts).map_err(io(&transcripts, "cannot be read"))? {
            cut_torn_line(&entry.map_err(io(&transcripts, "cannot be read"))?.path())?;
        }
        let index = folder.join(INDEX);
        let index: RunIndex = match fs::read_to_string(&index) {
            Ok(text) => serde_json::from_str(&text)
                .map_err(|error| differs(&index, "an index of sweeps and traces", &error))?,
            // It is written with the first sweep.
            Err(_) => RunIndex::default(),
        };
        let folder = Folder::new(folder);
        Ok(Self {
            tables: Tables::reopen(&folder)?,
            folder,
            clock,
            journal,
            fresh: Vec::new(),
            taps: Vec::new(),
            index,
            warnings: Warnings::of(replay.notes.clone()),
        })
    }

    /// Makes a table of a sweep match its finished points: appends missing rows, and removes rows
    /// of points that the journal does not contain, because those points are measured again.
    ///
    /// # Errors
    /// Fails if a row differs from its point or a file cannot be written.
    pub fn settle_spectrum(
        &self,
        name: &str,
        points: &[ImpedancePoint],
    ) -> Result<(), RecordError> {
        let path = self.path(name);
        let rows = if path.exists() && cut_torn_line(&path)? > 0 {
            dataset::read_spectrum_csv(&path)?
        } else {
            Vec::new()
        };
        for (number, (row, point)) in rows.iter().zip(points).enumerate() {
            if !same(row, point) {
                let expected = format!("the point of the journal in row {}: {point:?}", number + 1);
                return Err(differs(&path, &expected, &format!("{row:?}")));
            }
        }
        if rows.len() > points.len() {
            let text = fs::read_to_string(&path).map_err(io(&path, "cannot be read"))?;
            let kept: String = text.split_inclusive('\n').take(points.len() + 1).collect();
            dataset::write_atomically(&path, kept.as_bytes())?;
        }
        points
            .iter()
            .skip(rows.len())
            .try_for_each(|point| self.spectrum_point(name, point))
    }

    /// Checks that the captures of finished points are unchanged.
    ///
    /// # Errors
    /// Fails if a capture is missing or differs.
    pub fn check_captures(&self, points: &[&PointDone]) -> Result<(), RecordError> {
        for (file, sha256) in points.iter().flat_map(|point| &point.files) {
            let path = self.path(file);
            let found = sha256_of(&path)?;
            if found != *sha256 {
                return Err(differs(
                    &path,
                    &format!("a capture with the SHA-256 {sha256}"),
                    &found,
                ));
            }
        }
        Ok(())
    }

    /// Removes captures of a folder that belong to no finished point: their points are measured
    /// again.
    ///
    /// # Errors
    /// Fails if the folder cannot be read.
    pub fn drop_captures(&self, sweep: &str, points: &[&PointDone]) -> Result<(), RecordError> {
        let folder = self.path(CAPTURES).join(sweep);
        let Ok(entries) = fs::read_dir(&folder) else {
            return Ok(());
        };
        for entry in entries {
            let entry = entry.map_err(io(&folder, "cannot be read"))?;
            let path = entry.path();
            if !points
                .iter()
                .flat_map(|point| &point.files)
                .any(|(file, _)| self.path(file) == path)
            {
                fs::remove_file(&path).map_err(io(&path, "cannot be removed"))?;
            }
        }
        Ok(())
    }
}

/// Returns the SHA-256 of a file.
pub(super) fn sha256_of(path: &Path) -> Result<String, RecordError> {
    hash::sha256_of(path).map_err(io(path, "cannot be read"))
}

/// Compares two points; two values that are not numbers are equal.
fn same(a: &ImpedancePoint, b: &ImpedancePoint) -> bool {
    let numbers = |p: &ImpedancePoint| {
        [p.freq_hz, p.z_ohm.re, p.z_ohm.im, p.amplitude_a]
            .map(|number| if number.is_nan() { None } else { Some(number) })
    };
    numbers(a) == numbers(b)
}

fn differs(path: &Path, expected: &str, found: &dyn std::fmt::Display) -> RecordError {
    RecordError::Differs {
        path: path.to_owned(),
        expected: expected.to_owned(),
        found: found.to_string(),
    }
}

/// Cuts off what follows the last line end; returns the remaining size, bytes. A missing file is
/// not created.
fn cut_torn_line(path: &Path) -> Result<u64, RecordError> {
    let Ok(bytes) = fs::read(path) else {
        return Ok(0);
    };
    let whole = bytes
        .iter()
        .rposition(|byte| *byte == b'\n')
        .map_or(0, |at| at as u64 + 1);
    if whole < bytes.len() as u64 {
        let file = File::options()
            .write(true)
            .open(path)
            .map_err(io(path, "cannot be opened"))?;
        file.set_len(whole)
            .map_err(io(path, "cannot be cut after its last whole line"))?;
    }
    Ok(whole)
}

#[cfg(test)]
mod tests {
    use super::*;
    use analysis_numeric::Covariance2;
    use instruments::clock::TimeMode;
    use instruments::units::Seconds;
    use num_complex::Complex64;

    fn point(freq_hz: f64) -> ImpedancePoint {
        ImpedancePoint {
            freq_hz,
            z_ohm: Complex64::new(0.01, -0.001 / freq_hz),
            covariance: Covariance2::ZERO,
            amplitude_a: 1.0,
        }
    }

    #[test]
    fn a_table_becomes_what_the_journal_says_of_it() {
        let folder = tempfile::tempdir().unwrap();
        let recorder =
            Recorder::create(&folder.path().join("run"), Clock::start(TimeMode::Real)).unwrap();
        let points: Vec<ImpedancePoint> = [1.0, 2.0, 3.0].map(point).to_vec();
        let whole = |count: usize| {
            let name = format!("whole{count}.csv");
            let _ = fs::remove_file(recorder.path(&name));
            points[..count]
                .iter()
                .for_each(|point| recorder.spectrum_point(&name, point).unwrap());
            fs::read_to_string(recorder.path(&name)).unwrap_or_default()
        };
        for (before, torn, known) in [
            (0, "", 2),
            (1, "", 2),
            (2, "", 2),
            (3, "", 2),
            (3, "", 0),
            (2, "4.0,0.0", 3),
            (0, "freq", 1),
        ] {
            let name = format!("t{before}{known}{}.csv", torn.len());
            fs::write(recorder.path(&name), whole(before) + torn).unwrap();
            recorder.settle_spectrum(&name, &points[..known]).unwrap();
            let text = fs::read_to_string(recorder.path(&name)).unwrap();
            let expected = if known == 0 {
                whole(3).lines().next().unwrap().to_owned() + "\n"
            } else {
                whole(known)
            };
            assert_eq!(
                text, expected,
                "{before} rows and {torn:?}, the journal knows {known}"
            );
        }
        fs::write(recorder.path("other.csv"), whole(2)).unwrap();
        let message = recorder
            .settle_spectrum("other.csv", &[point(1.0), point(2.5)])
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("other.csv: expected the point of the journal in row 2: "),
            "{message}"
        );
    }

    #[test]
    fn the_torn_last_line_of_every_growing_table_is_cut_off() {
        let folder = tempfile::tempdir().unwrap();
        let run = folder.path().join("run");
        let clock = Clock::start(TimeMode::Real);
        let mut recorder = Recorder::create(&run, clock.clone()).unwrap();
        recorder.tap("load").unwrap();
        drop(recorder);
        let growing = [
            "events.csv",
            "readings.csv",
            "bath.csv",
            "envelope.csv",
            "log.txt",
            "transcripts/load.txt",
        ];
        for name in growing {
            let whole = fs::read_to_string(run.join(name)).unwrap_or_default() + "1.000,whole\n";
            fs::write(run.join(name), whole + "2.000,to").unwrap();
        }
        let started = crate::journal::Line {
            number: 1,
            time_s: Seconds(0.0),
            entry: crate::journal::replay::test_started(),
        };
        let read = Read {
            lines: vec![started],
            whole_bytes: 0,
            torn: Vec::new(),
        };
        let replay = JournalReplay::of(&read.lines).unwrap();
        drop(Recorder::reopen(&run, clock, &read, &replay).unwrap());
        for name in growing {
            let text = fs::read_to_string(run.join(name)).unwrap();
            assert!(text.ends_with("1.000,whole\n"), "{name}: {text:?}");
        }
    }
}
