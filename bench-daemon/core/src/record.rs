//! Writes the run folder during the run: every result is on disk before the next step begins.
//!
//! `config/` the files that were read · `manifest.json` identity of the run · `events.csv` every
//! step with bench time · `readings.csv` every reading (at the end also `readings.parquet`) ·
//! `bath.csv` readings of the chiller · `envelope.csv` bounds of the readings in each step ·
//! `captures/FIXTURE/…parquet` raw ADC codes · `raw_FIXTURE.csv` impedances before correction ·
//! `correction.json` · `spectrum.csv`, `.parquet` · `spectrum_2.csv` … further sweeps ·
//! `series_TRACE_REPEAT.bdf.csv` traces · `traces.json` index of the sweeps and traces, with their
//! measurement conditions · `budget.csv`, `.json` · `model_Nrc.json` · `plots/` · `report.html` ·
//! `transcripts/` every message · `log.txt` · `journal.jsonl` intended and finished steps, from
//! which a run whose process died is resumed.

mod error;
mod folder;
mod measured;
mod names;
mod notes;
mod reopen;
mod tables;
mod warnings;

use std::{
    fs::{self, File},
    io::BufWriter,
    path::{Path, PathBuf},
};

use analysis_files::{
    dataset::RunIndex,
    run_folder::{self, BathRow},
};
use instruments::{
    clock::{Clock, TimeMode},
    transcript::Tap,
    units::Celsius,
};
use serde::Serialize;

use error::io;
use folder::Folder;
use tables::Tables;
use warnings::Warnings;

pub use analysis_files::run_folder::Event;
pub use error::RecordError;
pub use error::with_causes;
pub use names::{CaptureFile, sweep_name};
pub use names::{capture_of, code_scale};

use crate::{
    clock::TypedClock,
    journal::{Entry, Journal, PointDone},
};
use bench_plan::{
    interlock::{Limits, Reading},
    measure::SweepPoint,
    support::crash_point::Drill,
};

/// Writer of a run folder.
pub struct Recorder {
    folder: Folder,
    clock: Clock,
    journal: Journal,
    /// Captures of the present point, with their SHA-256.
    fresh: Vec<(String, String)>,
    /// The transcripts that are being written.
    taps: Vec<(PathBuf, Tap)>,
    tables: Tables,
    index: RunIndex,
    warnings: Warnings,
}

impl Recorder {
    /// Creates a run folder.
    ///
    /// # Errors
    /// Fails if the folder is in use or cannot be written.
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
        let folder = Folder::new(folder);
        Ok(Self {
            tables: Tables::create(&folder)?,
            folder,
            clock,
            journal,
            fresh: Vec::new(),
            taps: Vec::new(),
            index: RunIndex::default(),
            warnings: Warnings::of(Vec::new()),
        })
    }

    /// Returns the folder.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Returns the path of a file in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.file(name)
    }

    /// Makes the journal and the transcripts points of a crash drill from now on.
    pub fn drill(&mut self, drill: &Drill) {
        self.folder.drill(drill);
        self.journal.drill(drill.clone());
    }

    /// Returns a tap that appends to the transcript of one instrument.
    ///
    /// # Errors
    /// Fails if a file cannot be created.
    pub fn tap(&mut self, role: &str) -> Result<Tap, RecordError> {
        let name = run_folder::transcript(role);
        let path = self.path(&name);
        let file = File::options()
            .append(true)
            .create(true)
            .open(&path)
            .map_err(io(&path, "cannot be made"))?;
        let tap = Tap::new(self.folder.transcript(BufWriter::new(file), name));
        self.taps.push((path, tap.clone()));
        Ok(tap)
    }

    /// Writes an entry into the journal; it is on disk when this returns. Nothing may begin if its
    /// communication cannot be recorded.
    ///
    /// # Errors
    /// Fails if a file cannot be written, including a transcript since the last step.
    pub fn journal(&mut self, entry: Entry) -> Result<(), RecordError> {
        self.numbered(entry).map(|_| ())
    }

    /// As [`Self::journal`], but returns the number of the line.
    ///
    /// # Errors
    /// As there.
    pub fn numbered(&mut self, entry: Entry) -> Result<u64, RecordError> {
        if matches!(entry, Entry::Intent { .. }) {
            for (path, tap) in &self.taps {
                tap.take_error()
                    .map_or(Ok(()), |source| Err(io(path, "cannot be written")(source)))?;
            }
        }
        Ok(self.journal.write(entry)?)
    }

    /// Writes a finished point of a sweep into the journal, with the captures since the previous
    /// point. `idle` is the last reading of the cell before its current was switched on.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
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

    /// Records that something begins, before it does.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn event(&mut self, kind: Event, text: &str) -> Result<(), RecordError> {
        let row = kind.row(self.clock.now().0, text);
        self.tables.event(&self.folder, &row)
    }

    /// Writes a reading.
    ///
    /// # Errors
    /// Fails if a file cannot be written, or if the folder was deleted, so that nothing can be
    /// written.
    pub fn reading(&mut self, phase: &str, reading: &Reading) -> Result<(), RecordError> {
        if self.clock.mode() != TimeMode::Virtual {
            let journal = self.path(run_folder::JOURNAL);
            std::fs::metadata(&journal).map_err(io(
                &journal,
                "the run folder was deleted or moved while the run was going on",
            ))?;
        }
        self.tables.reading(&self.folder, phase, reading)
    }

    /// Records the reading of the chiller and its set-point. A gap in this table does not justify
    /// ending a run: if the folder cannot be written, the next reading ends it.
    pub fn bath(&mut self, bath_degc: Option<Celsius>, setpoint_degc: Option<Celsius>) {
        let row = BathRow {
            time_s: self.clock.now().0,
            bath_degc: bath_degc
                .filter(|celsius| celsius.is_finite())
                .map(Celsius::value),
            setpoint_degc: setpoint_degc.map(Celsius::value),
        };
        if let Err(error) = self.tables.bath(&self.folder, &row) {
            tracing::error!("{error}");
        }
    }

    /// Records the limits of each reading from now on, if they have changed. As [`Self::bath`], a
    /// write error does not end the run.
    pub fn envelope(&mut self, limits: &Limits) {
        let time_s = self.clock.now();
        if let Err(error) = self.tables.envelope(&self.folder, time_s.0, limits) {
            tracing::error!("{error}");
        }
    }

    /// Writes all readings again as one table with full digits, at the end of a run.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn finish_readings(&self) -> Result<(), RecordError> {
        self.tables.finish(&self.folder)
    }

    /// Writes a structure as JSON, atomically.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), RecordError> {
        self.folder.json(name, value)
    }

    /// Writes a text, atomically.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn text(&self, name: &str, text: &str) -> Result<(), RecordError> {
        self.folder.text(name, text)
    }
}
