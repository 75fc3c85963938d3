//! The run folder, written as the run goes: whatever is finished is on disk before the next thing is begun.
//!
//! `config/` the files that were read · `manifest.json` what ran · `events.csv` every step with bench time · `readings.csv` every reading (at the end
//! also `readings.parquet`) ·
//! `captures/FIXTURE/…parquet` raw ADC codes · `raw_FIXTURE.csv` impedances before correction · `correction.json` · `spectrum.csv`, `.parquet` ·
//! `spectrum_2.csv` … further sweeps · `series_TRACE_REPEAT.bdf.csv` traces · `traces.json` which sweeps and traces there are, and under which
//! circumstances they were measured · `budget.csv`, `.json` ·
//! `model_Nrc.json` · `plots/` · `report.html` · `transcripts/` every message · `log.txt` · `journal.jsonl` what was intended and what was done, from
//! which a run that died goes on.

mod names;
mod reopen;

use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use analysis::{
    dataset::{self, Capture, DatasetError, LegRow, RunIndex, SeriesRow, SweepEntry, TraceEntry, TraceRow},
    spectrum::ImpedancePoint,
};
use instruments::{clock::Clock, mock::plant::Fixture, scope::Waveform, transcript::Tap};
use serde::Serialize;

pub use names::sweep_name;
pub(crate) use names::{capture_of, code_scale};

use crate::{
    drill::Drill,
    executor::SweepPoint,
    interlock::Reading,
    journal::{Entry, Journal, JournalError, PointDone},
};

/// The index of sweeps and traces.
const INDEX: &str = "traces.json";

/// A file that cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file system.
    #[error("{path}: {what}: {source}", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried.
        what: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
    /// A table.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The journal.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A file of the folder is not what the journal says of it.
    #[error("{path}: expected {expected}, found {found}", path = path.display())]
    Differs {
        /// The file.
        path: PathBuf,
        /// What it should be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// The folder is already in use.
    #[error("{path}: expected a new or empty folder, found files in it; choose another with --out", path = path.display())]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
}

/// Which capture it is.
#[derive(Debug, Clone, Copy)]
pub struct CaptureFile {
    /// What was in the jig.
    pub fixture: Fixture,
    /// Number of the sweep, 0 for a control.
    pub repeat: usize,
    /// Number of the point, from 0.
    pub index: usize,
    /// Number of the attempt, from 0: later ones after a change of range.
    pub attempt: usize,
    /// Frequency, Hz.
    pub freq_hz: f64,
    /// Commanded amplitude of the current, A.
    pub amplitude_a: f64,
    /// Bench time when it was downloaded, s.
    pub start_s: f64,
}

/// A run folder.
pub struct Recorder {
    folder: PathBuf,
    clock: Clock,
    journal: Journal,
    drill: Drill,
    /// Captures of the point in work, with their SHA-256.
    fresh: Vec<(String, String)>,
    events: BufWriter<File>,
    readings: BufWriter<File>,
    series: Vec<SeriesRow>,
    index: RunIndex,
    warnings: Vec<String>,
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
            return Err(RecordError::NotEmpty { path: folder.to_owned() });
        }
        for part in ["config", "captures", "plots", "transcripts"] {
            let path = folder.join(part);
            fs::create_dir_all(&path).map_err(io(&path, "cannot be made"))?;
        }
        let journal = Journal::create(folder, &clock)?;
        let mut events = create(&folder.join("events.csv"))?;
        let mut readings = create(&folder.join("readings.csv"))?;
        line(&mut events, &folder.join("events.csv"), "time_s,event")?;
        line(&mut readings, &folder.join("readings.csv"), "time_s,phase,voltage_v,current_a,temperature_c")?;
        Ok(Self {
            folder: folder.to_owned(),
            clock,
            journal,
            drill: Drill::none(),
            fresh: Vec::new(),
            events,
            readings,
            series: Vec::new(),
            index: RunIndex::default(),
            warnings: Vec::new(),
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
    pub fn tap(&self, role: &str) -> Result<Tap, RecordError> {
        let path = self.path("transcripts").join(format!("{role}.txt"));
        let file = File::options().append(true).create(true).open(&path).map_err(io(&path, "cannot be made"))?;
        Ok(Tap::new(self.drill.transcript(BufWriter::new(file))))
    }

    /// Writes an entry into the journal; it is on disk when this returns.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn journal(&mut self, entry: Entry) -> Result<(), RecordError> {
        Ok(self.journal.write(entry)?)
    }

    /// Writes a finished point of a sweep into the journal, with the captures since the point before it.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn point(&mut self, (stage, step): (usize, usize), idle: Reading, point: &SweepPoint) -> Result<(), RecordError> {
        let files = std::mem::take(&mut self.fresh);
        self.journal(Entry::Point(Box::new(PointDone { stage, step, files, idle, point: point.clone() })))
    }

    /// Writes down that something begins, before it does.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn event(&mut self, text: &str) -> Result<(), RecordError> {
        let row = format!("{:.3},\"{}\"", self.clock.now_s(), text.replace('"', "'"));
        line(&mut self.events, &self.folder.join("events.csv"), &row)
    }

    /// Writes a reading.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn reading(&mut self, phase: &str, reading: &Reading) -> Result<(), RecordError> {
        let cell = |value: Option<f64>, digits: usize| value.map_or_else(String::new, |value| format!("{value:.digits$}"));
        let row = format!(
            "{:.3},{phase},{},{},{}",
            reading.time_s,
            cell(reading.voltage_v, 6),
            cell(reading.current_a, 6),
            cell(reading.temperature_c, 4)
        );
        self.series.push(SeriesRow {
            time_s: reading.time_s,
            voltage_v: reading.voltage_v.unwrap_or(f64::NAN),
            current_a: reading.current_a.unwrap_or(f64::NAN),
            temperature_c: reading.temperature_c.unwrap_or(f64::NAN),
        });
        line(&mut self.readings, &self.folder.join("readings.csv"), &row)
    }

    /// Writes all readings again as one table with full digits, at the end of a run.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn finish_readings(&self) -> Result<(), RecordError> {
        Ok(dataset::write_series_parquet(&self.path("readings.parquet"), &self.series)?)
    }

    /// Writes the raw codes of a point, whole and before anything is made of them.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn capture(&mut self, file: &CaptureFile, waveforms: &[Waveform; 4]) -> Result<(), RecordError> {
        let name = sweep_name(file.fixture, file.repeat);
        let label = format!("{name} point {} attempt {} at {} A", file.index + 1, file.attempt + 1, file.amplitude_a);
        let again = if file.attempt == 0 { String::new() } else { format!("_again{}", file.attempt) };
        let point = format!("point{:02}_{:.6}Hz{again}", file.index + 1, file.freq_hz);
        self.write_capture(&name, &point, &capture_of(label, file.freq_hz, file.start_s, waveforms))?;
        if file.attempt == 0 {
            self.fresh.clear();
        }
        let relative = format!("captures/{name}/{point}.parquet");
        let sha256 = reopen::sha256_of(&self.path(&relative))?;
        self.fresh.push((relative, sha256));
        Ok(())
    }

    /// Writes the raw codes of any frame, whole, into a folder of `captures`.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write_capture(&self, folder: &str, name: &str, capture: &Capture) -> Result<(), RecordError> {
        let folder = self.path("captures").join(folder);
        fs::create_dir_all(&folder).map_err(io(&folder, "cannot be made"))?;
        Ok(dataset::write_capture(&folder.join(format!("{name}.parquet")), capture)?)
    }

    /// Writes a trace and enters it into the index.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn trace(&mut self, entry: TraceEntry, rows: &[TraceRow]) -> Result<(), RecordError> {
        dataset::write_trace_csv(&self.path(&entry.file), rows)?;
        self.index.traces.push(entry);
        self.json(INDEX, &self.index)
    }

    /// Writes the readings of legs, whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn legs(&self, name: &str, rows: &[LegRow]) -> Result<(), RecordError> {
        Ok(dataset::write_legs_csv(&self.path(name), rows)?)
    }

    /// Takes a sweep that is not finished out of the index: its entry was written, but not its end in the journal.
    pub fn forget_sweep(&mut self, file: &str) {
        self.index.sweeps.retain(|entry| entry.file != file);
    }

    /// Enters a sweep whose file is whole into the index.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn sweep(&mut self, entry: SweepEntry) -> Result<(), RecordError> {
        self.index.sweeps.push(entry);
        self.json(INDEX, &self.index)
    }

    /// Names the cell that the index is about.
    pub fn about(&mut self, cell: &str, capacity_c: f64) {
        (self.index.cell, self.index.capacity_c) = (cell.to_owned(), capacity_c);
    }

    /// How many sweeps and traces the index holds.
    pub fn measured(&self) -> usize {
        self.index.sweeps.len() + self.index.traces.len()
    }

    /// The index of what was measured.
    pub fn index(&self) -> &RunIndex {
        &self.index
    }

    /// Appends a point to a spectrum; it is on disk when this returns.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn spectrum_point(&self, name: &str, point: &ImpedancePoint) -> Result<(), RecordError> {
        let path = self.path(name);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(io(folder, "cannot be made"))?;
        }
        Ok(dataset::append_spectrum_csv(&path, point)?)
    }

    /// Writes a spectrum again, whole or not at all, in the place of the points that were appended as they came.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn spectrum(&self, name: &str, points: &[ImpedancePoint]) -> Result<(), RecordError> {
        Ok(dataset::write_spectrum_csv(&self.path(name), points)?)
    }

    /// Writes a structure as JSON, whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), RecordError> {
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
        Ok(dataset::write_atomically(&self.path(name), text.as_bytes())?)
    }

    /// Remembers something odd for the report.
    pub fn warning(&mut self, text: &str) {
        if self.warnings.iter().any(|known| known == text) {
            return;
        }
        // A folder that cannot be written ends the run at the next record; the warning itself is not worth it.
        let noted = self.journal(Entry::Note { text: text.to_owned() });
        if let Err(error) = noted.and_then(|()| self.event(&format!("note: {text}"))) {
            tracing::error!("{error}");
        }
        self.warnings.push(text.to_owned());
    }

    /// Remembers something odd about a point of a sweep; what was odd about several is said once.
    pub fn point_warning(&mut self, sweep: &str, freq_hz: f64, text: &str) {
        if let Err(error) = self.event(&format!("note: {sweep}, {freq_hz:.4} Hz: {text}")) {
            tracing::error!("{error}");
        }
        self.known_point_warning(sweep, freq_hz, text);
    }

    /// As [`Self::point_warning`], for a point whose event was written when it was measured.
    pub fn known_point_warning(&mut self, sweep: &str, freq_hz: f64, text: &str) {
        match self.point_warnings.iter_mut().find(|(known, _)| known == text) {
            Some((_, points)) => points.push((sweep.to_owned(), freq_hz)),
            None => self.point_warnings.push((text.to_owned(), vec![(sweep.to_owned(), freq_hz)])),
        }
    }

    /// What was odd.
    pub fn warnings(&self) -> Vec<String> {
        let points = self.point_warnings.iter().map(|(text, points)| format!("{}: {text}", names::places(points)));
        points.chain(self.warnings.iter().cloned()).collect()
    }
}

fn create(path: &Path) -> Result<BufWriter<File>, RecordError> {
    File::create(path).map(BufWriter::new).map_err(io(path, "cannot be made"))
}

fn line(writer: &mut BufWriter<File>, path: &Path, text: &str) -> Result<(), RecordError> {
    writeln!(writer, "{text}").and_then(|()| writer.flush()).map_err(io(path, "cannot be written"))
}

fn io(path: &Path, what: &'static str) -> impl Fn(std::io::Error) -> RecordError + use<> {
    let path = path.to_owned();
    move |source| RecordError::Io { path: path.clone(), what, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_odd_about_several_points_is_said_once() {
        let folder = tempfile::tempdir().unwrap();
        let clock = Clock::start(instruments::clock::TimeMode::Real);
        let mut recorder = Recorder::create(&folder.path().join("run"), clock).unwrap();
        recorder.warning("of the run");
        for (sweep, freq_hz, text) in [("shunt", 1.0, "odd"), ("shunt", 1.0, "other"), ("cell", 1.0, "odd")] {
            recorder.point_warning(sweep, freq_hz, text);
        }
        let said = ["shunt, 1.0000 Hz; cell, 1.0000 Hz: odd", "shunt, 1.0000 Hz: other", "of the run"];
        assert_eq!(recorder.warnings(), said);
    }
}
