//! The run folder, written as the run goes: whatever is finished is on disk before the next thing is begun.
//!
//! `config/` the files that were read · `manifest.json` what ran · `events.csv` every step with bench time · `readings.csv` every reading (at the end
//! also `readings.parquet`) ·
//! `captures/FIXTURE/…parquet` raw ADC codes · `raw_FIXTURE.csv` impedances before correction · `correction.json` · `spectrum.csv`, `.parquet` ·
//! `spectrum_2.csv` … further sweeps · `series_TRACE_REPEAT.bdf.csv` traces · `traces.json` which sweeps and traces there are, and under which
//! circumstances they were measured · `budget.csv`, `.json` ·
//! `model_Nrc.json` · `plots/` · `report.html` · `transcripts/` every message · `log.txt`.

use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use analysis::{
    dataset::{self, Capture, CaptureMeta, ChannelMeta, DatasetError, LegRow, RunIndex, SeriesRow, SweepEntry, TraceEntry, TraceRow},
    sine::CodeScale,
    spectrum::ImpedancePoint,
};
use instruments::{clock::Clock, mock::plant::Fixture, scope::Waveform, transcript::Tap};
use serde::Serialize;

use crate::{interlock::Reading, plan::fixture_name};

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
        let mut events = create(&folder.join("events.csv"))?;
        let mut readings = create(&folder.join("readings.csv"))?;
        line(&mut events, &folder.join("events.csv"), "time_s,event")?;
        line(&mut readings, &folder.join("readings.csv"), "time_s,phase,voltage_v,current_a,temperature_c")?;
        Ok(Self {
            folder: folder.to_owned(),
            clock,
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

    /// A tap that writes one instrument's conversation.
    ///
    /// # Errors
    /// A file that cannot be made.
    pub fn tap(&self, role: &str) -> Result<Tap, RecordError> {
        let path = self.path("transcripts").join(format!("{role}.txt"));
        Ok(Tap::new(create(&path)?))
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
    pub fn capture(&self, file: &CaptureFile, waveforms: &[Waveform; 4]) -> Result<(), RecordError> {
        let name = sweep_name(file.fixture, file.repeat);
        let label = format!("{name} point {} attempt {} at {} A", file.index + 1, file.attempt + 1, file.amplitude_a);
        let again = if file.attempt == 0 { String::new() } else { format!("_again{}", file.attempt) };
        let point = format!("point{:02}_{:.6}Hz{again}", file.index + 1, file.freq_hz);
        self.write_capture(&name, &point, &capture_of(label, file.freq_hz, file.start_s, waveforms))
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
        Ok(dataset::append_spectrum_csv(&self.path(name), point)?)
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
        // A folder that cannot be written ends the run at the next record; the warning itself is not worth it.
        if let Err(error) = self.event(&format!("note: {text}")) {
            tracing::error!("{error}");
        }
        self.warnings.push(text.to_owned());
    }

    /// Remembers something odd about a point of a sweep; what was odd about several is said once.
    pub fn point_warning(&mut self, sweep: &str, freq_hz: f64, text: &str) {
        if let Err(error) = self.event(&format!("note: {sweep}, {freq_hz:.4} Hz: {text}")) {
            tracing::error!("{error}");
        }
        match self.point_warnings.iter_mut().find(|(known, _)| known == text) {
            Some((_, points)) => points.push((sweep.to_owned(), freq_hz)),
            None => self.point_warnings.push((text.to_owned(), vec![(sweep.to_owned(), freq_hz)])),
        }
    }

    /// What was odd.
    pub fn warnings(&self) -> Vec<String> {
        let points = self.point_warnings.iter().map(|(text, points)| format!("{}: {text}", places(points)));
        points.chain(self.warnings.iter().cloned()).collect()
    }
}

/// Points of sweeps in words: each sweep once, its points counted where there are several.
fn places(points: &[(String, f64)]) -> String {
    let mut sweeps: Vec<(&str, Vec<f64>)> = Vec::new();
    for (sweep, freq_hz) in points {
        match sweeps.iter_mut().find(|(known, _)| known == sweep) {
            Some((_, freqs_hz)) => freqs_hz.push(*freq_hz),
            None => sweeps.push((sweep, vec![*freq_hz])),
        }
    }
    let words = sweeps.iter().map(|(sweep, freqs_hz)| match freqs_hz.as_slice() {
        [freq_hz] => format!("{sweep}, {freq_hz:.4} Hz"),
        several => {
            let (least, greatest) =
                several.iter().fold((f64::INFINITY, 0.0_f64), |(least, greatest), &freq_hz| (least.min(freq_hz), greatest.max(freq_hz)));
            format!("{sweep}, {} points from {least:.4} Hz to {greatest:.4} Hz", several.len())
        }
    });
    words.collect::<Vec<_>>().join("; ")
}

/// A sweep in names of files: a control is called after its fixture, a sweep of the cell too, and with its number from the second on.
pub fn sweep_name(fixture: Fixture, repeat: usize) -> String {
    let name = fixture_name(fixture);
    match (fixture, repeat) {
        (_, 0) | (Fixture::Cell, 1) => name.to_owned(),
        (Fixture::Cell, number) => format!("{name}_{number}"),
        (_, number) => format!("{name}_sweep_{number}"),
    }
}

/// A frame of four channels as it is stored.
pub(crate) fn capture_of(label: String, freq_hz: f64, start_s: f64, waveforms: &[Waveform; 4]) -> Capture {
    let channel = |waveform: &Waveform| ChannelMeta { scale: code_scale(waveform), volts_per_div: waveform.preamble.volts_per_div };
    let channels = waveforms.each_ref().map(channel);
    let meta = CaptureMeta { label, freq_hz, interval_s: waveforms[0].interval_s, start_s, channels };
    Capture { meta, codes: waveforms.each_ref().map(|waveform| waveform.codes.clone()) }
}

/// What a waveform's codes mean: on disk as in the fit.
pub(crate) fn code_scale(waveform: &Waveform) -> CodeScale {
    let preamble = &waveform.preamble;
    CodeScale {
        volts_per_code: preamble.volts_per_code,
        offset_v: preamble.offset_v,
        code_min: preamble.code_min,
        code_max: preamble.code_max,
        code_step: preamble.code_step,
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
    fn points_are_named_by_sweep_and_counted() {
        let points = [("shunt", 300.0), ("cell", 0.1), ("cell", 10.0), ("cell", 0.5)].map(|(sweep, freq_hz)| (sweep.to_owned(), freq_hz));
        assert_eq!(places(&points[..1]), "shunt, 300.0000 Hz");
        assert_eq!(places(&points), "shunt, 300.0000 Hz; cell, 3 points from 0.1000 Hz to 10.0000 Hz");
    }

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
