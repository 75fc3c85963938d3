//! Writes the measurements of a run: captures, spectra, traces, readings of legs, and their index.

use std::{fs, path::PathBuf};

use analysis_files::{
    dataset::{self, Capture, LegRow, PointConditions, RunIndex, SweepEntry, TraceEntry, TraceRow},
    run_folder::{self, CAPTURES, INDEX},
};
use analysis_signal::spectrum::{ImpedancePoint, Spectrum};
use instruments::scope::Waveform;

use super::{
    Recorder,
    error::{RecordError, io},
    names::{CaptureFile, capture_of, sweep_name},
    reopen,
};

impl Recorder {
    /// Writes the raw codes of a point completely, before they are processed.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
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

    /// Writes the raw codes of any frame completely into a folder of `captures`.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
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

    /// Writes a trace and adds it to the index.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn trace(&mut self, entry: TraceEntry, rows: &[TraceRow]) -> Result<(), RecordError> {
        self.folder.room(&entry.file)?;
        dataset::write_trace_csv(&self.path(&entry.file), rows)?;
        self.index.traces.push(entry);
        self.json(INDEX, &self.index)
    }

    /// Rewrites a trace of the index, and its entry.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
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

    /// Writes the readings of legs, atomically.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn legs(&self, name: &str, rows: &[LegRow]) -> Result<(), RecordError> {
        self.folder.room(name)?;
        let path = self.path(name);
        if path.exists() {
            // A leg that is executed again after a crash has moved another charge: both are kept.
            let stem = name.strip_suffix(".bdf.csv").unwrap_or(name);
            let kept = (1..).map(|pass| self.path(&format!("{stem}_pass_{pass}.bdf.csv")));
            if let Some(kept) = kept.into_iter().find(|kept| !kept.exists()) {
                std::fs::rename(&path, &kept).map_err(|source| RecordError::Io {
                    path: kept,
                    what: "rename",
                    source,
                })?;
            }
        }
        Ok(dataset::write_legs_csv(&self.path(name), rows)?)
    }

    /// Removes an incomplete sweep from the index: its entry was written, but not its end in the
    /// journal.
    pub fn forget_sweep(&mut self, file: &str) {
        self.index.sweeps.retain(|entry| entry.file != file);
    }

    /// Adds a sweep whose file is complete to the index.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn sweep(&mut self, entry: SweepEntry) -> Result<(), RecordError> {
        self.index.sweeps.push(entry);
        self.json(INDEX, &self.index)
    }

    /// Sets the cell that the index describes.
    pub fn about(&mut self, cell: &str, capacity_coulomb: f64) {
        (self.index.cell, self.index.capacity_coulomb) = (cell.to_owned(), capacity_coulomb);
    }

    /// Returns the number of sweeps and traces in the index.
    pub fn measured(&self) -> usize {
        self.index.sweeps.len() + self.index.traces.len()
    }

    /// Returns the index of the measurements.
    pub fn index(&self) -> &RunIndex {
        &self.index
    }

    /// Appends a point to a spectrum; it is on disk when this returns.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn spectrum_point(&self, name: &str, point: &ImpedancePoint) -> Result<(), RecordError> {
        let path = self.writable_path(name)?;
        Ok(dataset::append_spectrum_csv(&path, point)?)
    }

    /// Rewrites a spectrum atomically; it replaces the points that were appended one by one.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn spectrum(&self, name: &str, points: &[ImpedancePoint]) -> Result<(), RecordError> {
        self.folder.room(name)?;
        Ok(dataset::write_spectrum_csv(&self.path(name), points)?)
    }

    /// Writes a spectrum with the refusals of the quality gate, as text for each point. The column
    /// is omitted if nothing was refused.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
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

    /// Returns the path of a file to write: its folder exists, and the disk has room.
    fn writable_path(&self, name: &str) -> Result<PathBuf, RecordError> {
        let path = self.path(name);
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(io(folder, "cannot be made"))?;
        }
        self.folder.room(name)?;
        Ok(path)
    }

    /// Writes a spectrum that was measured under a direct current, with the conditions of each point
    /// and the refusals of the quality gate.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn biased_spectrum(
        &self,
        name: &str,
        spectrum: &Spectrum,
        conditions: &[PointConditions],
        flags: &[String],
    ) -> Result<(), RecordError> {
        let path = self.writable_path(name)?;
        Ok(dataset::write_biased_spectrum_csv(
            &path, spectrum, conditions, flags,
        )?)
    }

    /// As the flagged spectrum, in Parquet format.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
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

    /// Writes a spectrum completely, with the errors that its points share and the refusals of the
    /// quality gate.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn whole_spectrum(
        &self,
        name: &str,
        spectrum: &Spectrum,
        flags: &[String],
    ) -> Result<(), RecordError> {
        let path = self.writable_path(name)?;
        Ok(dataset::write_whole_spectrum_csv(&path, spectrum, flags)?)
    }
}
