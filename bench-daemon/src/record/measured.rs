//! Writes the measurements of a run: captures, spectra, traces, readings of legs, and their index.

use std::fs;

use analysis::{
    dataset::{self, Capture, LegRow, RunIndex, SweepEntry, TraceEntry, TraceRow},
    run_folder::{self, CAPTURES, INDEX},
    spectrum::{ImpedancePoint, Spectrum},
};
use instruments::scope::Waveform;

use super::{
    Recorder,
    error::{RecordError, io},
    names::{CaptureFile, capture_of, sweep_name},
    reopen,
};

impl Recorder {
    /// Writes the raw codes of a point, whole and before anything is made of them.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn capture(
        &mut self,
        file: &CaptureFile,
        waveforms: &[Waveform; 4],
    ) -> Result<(), RecordError> {
        let name = sweep_name(file.fixture, file.repeat);
        let label = format!(
            "{name} point {} attempt {} at {} A",
            file.index + 1,
            file.attempt + 1,
            file.amplitude_a
        );
        let point = run_folder::point_capture(file.index + 1, file.freq_hz, file.attempt);
        self.write_capture(
            &name,
            &point,
            &capture_of(label, file.freq_hz, file.start_s, waveforms),
        )?;
        if file.attempt == 0 {
            self.fresh.clear();
        }
        let relative = run_folder::capture(&name, &point);
        let sha256 = reopen::sha256_of(&self.path(&relative))?;
        self.fresh.push((relative, sha256));
        Ok(())
    }

    /// Writes the raw codes of any frame, whole, into a folder of `captures`.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn write_capture(
        &self,
        folder: &str,
        name: &str,
        capture: &Capture,
    ) -> Result<(), RecordError> {
        let file = run_folder::capture(folder, name);
        self.folder.room(&file)?;
        let folder = self.path(CAPTURES).join(folder);
        fs::create_dir_all(&folder).map_err(io(&folder, "cannot be made"))?;
        Ok(dataset::write_capture(&self.path(&file), capture)?)
    }

    /// Writes a trace and enters it into the index.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn trace(&mut self, entry: TraceEntry, rows: &[TraceRow]) -> Result<(), RecordError> {
        self.folder.room(&entry.file)?;
        dataset::write_trace_csv(&self.path(&entry.file), rows)?;
        self.index.traces.push(entry);
        self.json(INDEX, &self.index)
    }

    /// Writes a trace of the index, and its entry, again.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn trace_again(&mut self, entry: TraceEntry, rows: &[TraceRow]) -> Result<(), RecordError> {
        dataset::write_trace_csv(&self.path(&entry.file), rows)?;
        if let Some(known) = self
            .index
            .traces
            .iter_mut()
            .find(|known| known.file == entry.file)
        {
            *known = entry;
        }
        self.json(INDEX, &self.index)
    }

    /// Writes the readings of legs, whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn legs(&self, name: &str, rows: &[LegRow]) -> Result<(), RecordError> {
        self.folder.room(name)?;
        Ok(dataset::write_legs_csv(&self.path(name), rows)?)
    }

    /// Takes a sweep that is not finished out of the index: its entry was written, but not its end
    /// in the journal.
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
        self.folder.room(name)?;
        Ok(dataset::append_spectrum_csv(&path, point)?)
    }

    /// Writes a spectrum again, whole or not at all, in the place of the points that were appended
    /// as they came.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn spectrum(&self, name: &str, points: &[ImpedancePoint]) -> Result<(), RecordError> {
        self.folder.room(name)?;
        Ok(dataset::write_spectrum_csv(&self.path(name), points)?)
    }

    /// Writes a spectrum with what the quality gate has refused of it, in words for each point; a
    /// column less where it has refused nothing.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn flagged_spectrum(
        &self,
        name: &str,
        points: &[ImpedancePoint],
        flags: &[String],
    ) -> Result<(), RecordError> {
        if flags.iter().all(String::is_empty) {
            return self.spectrum(name, points);
        }
        self.folder.room(name)?;
        Ok(dataset::write_flagged_spectrum_csv(
            &self.path(name),
            points,
            flags,
        )?)
    }

    /// The same as Parquet.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn flagged_parquet(
        &self,
        name: &str,
        points: &[ImpedancePoint],
        flags: &[String],
    ) -> Result<(), RecordError> {
        Ok(dataset::write_flagged_spectrum_parquet(
            &self.path(name),
            points,
            flags,
        )?)
    }

    /// Writes a spectrum whole, with the errors that its points share and what the quality gate has
    /// refused.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn whole_spectrum(
        &self,
        name: &str,
        spectrum: &Spectrum,
        flags: &[String],
    ) -> Result<(), RecordError> {
        let path = self.path(name);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(io(folder, "cannot be made"))?;
        }
        self.folder.room(name)?;
        Ok(dataset::write_whole_spectrum_csv(&path, spectrum, flags)?)
    }
}
