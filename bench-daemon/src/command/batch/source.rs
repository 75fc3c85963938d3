//! Spectra of files, folders and tables, one after another.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use analysis::batch::{LongForm, TableSpectrum};
use analysis::formats::read_file;
use analysis::spectrum::SourcedSpectrum;

use super::paths;
use super::work::Items;
use bench_core::safety::failure::Failure;
use bench_evaluate::run::slope_of_spectrum;
use bench_evaluate::support::present::refused_in_words;

/// Spectra of everything that was named, in its order; the files of a folder by name.
pub(super) struct Source {
    files: Vec<PathBuf>,
    /// Number of the file that is read next.
    next: usize,
    table: Option<LongForm>,
    ready: VecDeque<TableSpectrum>,
    choice: Choice,
}

/// Points that are used.
#[derive(Debug, Clone, Copy)]
pub struct Choice {
    /// Lowest frequency, Hz.
    pub from_hz: f64,
    /// Highest frequency, Hz.
    pub to_hz: f64,
    /// Use points that the quality gate of their measurement refused.
    pub refused_points: bool,
    /// Spectra of controls and under direct current are left out.
    pub cells_only: bool,
    /// Subtract the share of the open-circuit voltage from spectra in a run folder whose cell has
    /// one.
    pub run_slopes: bool,
}

impl Source {
    pub(super) fn new(paths: &[PathBuf], choice: Choice) -> Result<Self, Failure> {
        let files = paths::files_of(paths, "spectra")?;
        Ok(Self {
            files,
            next: 0,
            table: None,
            ready: VecDeque::new(),
            choice,
        })
    }
}

impl Items for Source {
    type Item = TableSpectrum;

    /// Files with size and time of change.
    fn identity(&self) -> Result<String, Failure> {
        self.files
            .iter()
            .map(|file| paths::identity(file))
            .collect()
    }

    fn share(&self) -> f64 {
        let open = self.table.as_ref().map_or(0.0, |table| table.share() - 1.0);
        (self.next as f64 + open) / self.files.len().max(1) as f64
    }

    /// Returns the next spectrum. A file that does not contain spectra counts as one without a
    /// result.
    fn next(&mut self) -> Result<Option<TableSpectrum>, Failure> {
        loop {
            if let Some(ready) = self.ready.pop_front() {
                return Ok(Some(self.choice.applied(ready)));
            }
            if let Some(table) = &mut self.table {
                let next = table.next_spectrum();
                match next.map_err(|error| Failure::Usage(error.to_string()))? {
                    Some(spectrum) => return Ok(Some(self.choice.applied(spectrum))),
                    None => self.table = None,
                }
            }
            let Some(file) = self.files.get(self.next) else {
                return Ok(None);
            };
            self.next += 1;
            if LongForm::is_one(file) {
                let opened = LongForm::open(file);
                self.table = Some(opened.map_err(|error| Failure::Usage(error.to_string()))?);
            } else {
                let mut spectra = spectra_of(file);
                if self.choice.run_slopes
                    && let Some(found) = slope_of_spectrum(file)
                {
                    let measured = spectra
                        .iter_mut()
                        .filter_map(|one| one.spectrum.as_mut().ok());
                    measured.for_each(|sourced| {
                        let left = sourced.spectrum.less_charge_storage(found.at.slope);
                        sourced.spectrum = left;
                    });
                }
                self.ready.extend(spectra);
            }
        }
    }
}

impl Choice {
    fn applied(&self, one: TableSpectrum) -> TableSpectrum {
        TableSpectrum {
            spectrum: one.spectrum.and_then(|sourced| self.of(sourced)),
            ..one
        }
    }

    fn of(&self, mut sourced: SourcedSpectrum) -> Result<SourcedSpectrum, String> {
        let band = self.from_hz..=self.to_hz;
        sourced.spectrum.keep(|p| band.contains(&p.freq_hz));
        sourced.flagged.retain(|p| band.contains(&p.freq_hz));
        if self.cells_only && !sourced.origin.is_unbiased_cell() {
            return Err(
                "not fitted, because it is a control or carries a direct current".to_owned(),
            );
        }
        let refusals = refused_in_words(&sourced.flagged);
        if !self.refused_points {
            sourced.leave_out_flagged();
        }
        if !sourced.spectrum.points.is_empty() {
            return Ok(sourced);
        }
        let (from_hz, to_hz) = (self.from_hz, self.to_hz);
        Err(if refusals.is_empty() {
            format!("expected frequencies from {from_hz} to {to_hz} Hz, found none")
        } else {
            format!("the quality gate refused all points: {refusals}")
        })
    }
}

fn spectra_of(file: &Path) -> Vec<TableSpectrum> {
    let id = |name: String| TableSpectrum {
        spectrum_id: name,
        spectrum: Err(String::new()),
    };
    match read_file(file) {
        Ok(read) => read
            .spectra
            .into_iter()
            .map(|sourced| TableSpectrum {
                spectrum_id: sourced.spectrum.name.clone(),
                spectrum: Ok(sourced),
            })
            .collect(),
        Err(error) => vec![TableSpectrum {
            spectrum: Err(error.to_string()),
            ..id(file
                .file_name()
                .map_or_else(String::new, |name| name.to_string_lossy().into_owned()))
        }],
    }
}
