//! Writes the run folder while the run goes on: every result is on disk before the next step is
//! begun.
//!
//! `config/` the files that were read · `manifest.json` what ran · `events.csv` every step with
//! bench time · `readings.csv` every reading (at the end also `readings.parquet`) ·
//! `captures/FIXTURE/…parquet` raw ADC codes · `raw_FIXTURE.csv` impedances before correction ·
//! `correction.json` · `spectrum.csv`, `.parquet` · `spectrum_2.csv` … further sweeps ·
//! `series_TRACE_REPEAT.bdf.csv` traces · `traces.json` which sweeps and traces there are, and
//! under which circumstances they were measured · `budget.csv`, `.json` · `model_Nrc.json` ·
//! `plots/` · `report.html` · `transcripts/` every message · `log.txt` · `journal.jsonl` what was
//! intended and what was done, from which a run that died goes on.

mod measured;
mod names;
mod notes;
mod reopen;

use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use analysis::{
    dataset::{self, DatasetError, RunIndex, SeriesRow},
    run_folder::{
        self, EVENT_COLUMNS, EVENTS, READING_COLUMNS, READINGS, READINGS_PARQUET, ReadingRow,
    },
};
use instruments::{clock::Clock, transcript::Tap};
use serde::Serialize;

pub use analysis::run_folder::Event;
pub use measured::CaptureFile;
pub use names::sweep_name;
pub(crate) use names::{capture_of, code_scale};

use crate::{
    interlock::Reading,
    journal::{Entry, Journal, JournalError, Note, PointDone},
    measure::SweepPoint,
    support::crash_point::Drill,
    support::present::quoted,
};

/// A file that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file system.
    #[error("{path}: {what}: {source}", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Operation that was tried.
        what: &'static str,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A table.
    #[error("{}", with_causes(.0))]
    Dataset(#[from] DatasetError),
    /// The journal.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A file of the folder is not what the journal says of it.
    #[error("{path}: expected {expected}, found {found}", path = path.display())]
    Differs {
        /// The file.
        path: PathBuf,
        /// Expected content.
        expected: String,
        /// Content that was found.
        found: String,
    },
    /// The folder is already in use.
    #[error("{path}: expected a new or empty folder, found files in it; choose another with --out, \
    or go on with that run: `eis-bench resume {pasted}`", path = path.display(), pasted = quoted(path))]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
}

/// A run folder.
pub struct Recorder {
    folder: PathBuf,
    clock: Clock,
    journal: Journal,
    drill: Drill,
    /// Captures of the point in work, with their SHA-256.
    fresh: Vec<(String, String)>,
    /// The conversations that are being written.
    taps: Vec<(PathBuf, Tap)>,
    events: BufWriter<File>,
    readings: BufWriter<File>,
    series: Vec<SeriesRow>,
    index: RunIndex,
    notes: Vec<Note>,
    /// Texts, and the sweeps and frequencies, Hz, that they are about.
    point_warnings: Vec<(String, Vec<(String, f64)>)>,
}

impl Recorder {
    /// Makes a run folder.
    ///
    /// # Errors
    /// A folder that is in use, or cannot be written.
    pub fn create(folder: &Path, clock: Clock) -> Result<Self, RecordError> {
        if fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
            return Err(RecordError::NotEmpty {
                path: folder.to_owned(),
            });
        }
        for part in [
            run_folder::CONFIG,
            run_folder::CAPTURES,
            run_folder::PLOTS,
            run_folder::TRANSCRIPTS,
        ] {
            let path = folder.join(part);
            fs::create_dir_all(&path).map_err(io(&path, "cannot be made"))?;
        }
        let journal = Journal::create(folder, &clock)?;
        let mut events = create(&folder.join(EVENTS))?;
        let mut readings = create(&folder.join(READINGS))?;
        line(&mut events, &folder.join(EVENTS), EVENT_COLUMNS)?;
        line(&mut readings, &folder.join(READINGS), READING_COLUMNS)?;
        Ok(Self {
            folder: folder.to_owned(),
            clock,
            journal,
            drill: Drill::none(),
            fresh: Vec::new(),
            taps: Vec::new(),
            events,
            readings,
            series: Vec::new(),
            index: RunIndex::default(),
            notes: Vec::new(),
            point_warnings: Vec::new(),
        })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// A file in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// From now on the journal and the transcripts are points of a crash drill.
    pub fn drill(&mut self, drill: &Drill) {
        self.drill = drill.clone();
        self.journal.drill(drill.clone());
    }

    /// A tap that writes one instrument's conversation, behind what is there.
    ///
    /// # Errors
    /// A file that cannot be made.
    pub fn tap(&mut self, role: &str) -> Result<Tap, RecordError> {
        let name = run_folder::transcript(role);
        let path = self.path(&name);
        let file = File::options()
            .append(true)
            .create(true)
            .open(&path)
            .map_err(io(&path, "cannot be made"))?;
        let tap = Tap::new(self.drill.transcript(BufWriter::new(file), name));
        self.taps.push((path, tap.clone()));
        Ok(tap)
    }

    /// Whether there is room for a file; see [`Drill::room`].
    fn room(&self, name: &str) -> Result<(), RecordError> {
        self.drill
            .room(name)
            .map_err(io(&self.path(name), "cannot be written"))
    }

    /// Writes an entry into the journal; it is on disk when this returns. Nothing is begun whose
    /// conversation cannot be written down.
    ///
    /// # Errors
    /// A file that cannot be written, a transcript since the last step included.
    pub fn journal(&mut self, entry: Entry) -> Result<(), RecordError> {
        if matches!(entry, Entry::Intent { .. }) {
            for (path, tap) in &self.taps {
                tap.take_error()
                    .map_or(Ok(()), |source| Err(io(path, "cannot be written")(source)))?;
            }
        }
        Ok(self.journal.write(entry)?)
    }

    /// Writes a finished point of a sweep into the journal, with the captures since the point
    /// before it. `idle` is the last reading of the cell before its current went on.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn point(
        &mut self,
        stage: usize,
        step: usize,
        idle: Reading,
        point: &SweepPoint,
    ) -> Result<(), RecordError> {
        let files = std::mem::take(&mut self.fresh);
        self.journal(Entry::Point(Box::new(PointDone {
            stage,
            step,
            files,
            idle,
            point: point.clone(),
        })))
    }

    /// Writes down that something begins, before it does.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn event(&mut self, kind: Event, text: &str) -> Result<(), RecordError> {
        let row = kind.row(self.clock.now_s(), text);
        self.room(EVENTS)?;
        line(&mut self.events, &self.folder.join(EVENTS), &row)
    }

    /// Writes a reading.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn reading(&mut self, phase: &str, reading: &Reading) -> Result<(), RecordError> {
        let row = ReadingRow {
            time_s: reading.time_s,
            phase,
            voltage_v: reading.voltage_v,
            current_a: reading.current_a,
            temperature_c: reading.temperature_c,
        };
        self.series.push(SeriesRow {
            time_s: reading.time_s,
            voltage_v: reading.voltage_v.unwrap_or(f64::NAN),
            current_a: reading.current_a.unwrap_or(f64::NAN),
            temperature_c: reading.temperature_c.unwrap_or(f64::NAN),
        });
        self.room(READINGS)?;
        line(&mut self.readings, &self.folder.join(READINGS), &row.row())
    }

    /// Writes all readings again as one table with full digits, at the end of a run.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish_readings(&self) -> Result<(), RecordError> {
        self.room(READINGS_PARQUET)?;
        Ok(dataset::write_series_parquet(
            &self.path(READINGS_PARQUET),
            &self.series,
        )?)
    }

    /// Writes a structure as JSON, whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), RecordError> {
        self.room(name)?;
        let path = self.path(name);
        let mut text = serde_json::to_string_pretty(value).map_err(|error| RecordError::Io {
            path: path.clone(),
            what: "cannot be put into JSON",
            source: std::io::Error::other(error),
        })?;
        text.push('\n');
        Ok(dataset::write_atomically(&path, text.as_bytes())?)
    }

    /// Writes a text, whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn text(&self, name: &str, text: &str) -> Result<(), RecordError> {
        self.room(name)?;
        Ok(dataset::write_atomically(
            &self.path(name),
            text.as_bytes(),
        )?)
    }
}

/// An error and what has caused it, which is what a person can mend.
pub(crate) fn with_causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(error.source(), |cause| cause.source());
    causes.fold(error.to_string(), |text, cause| format!("{text}: {cause}"))
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

fn io(path: &Path, what: &'static str) -> impl Fn(std::io::Error) -> RecordError + use<> {
    let path = path.to_owned();
    move |source| RecordError::Io {
        path: path.clone(),
        what,
        source,
    }
}
