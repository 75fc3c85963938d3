//! A table with one row for each of many spectra.

use std::path::{Path, PathBuf};

use analysis::batch::TableSpectrum;
use analysis::plot;
use analysis::rows::{ResultRow, ResultRows};

use super::plots::Plots;
use super::source::{Choice, Source};
use super::work::{Job, work};
use bench_core::safety::failure::Failure;
use bench_evaluate::figures::impedance::compared;
use bench_evaluate::files;

/// Spectra of one part.
const PART: usize = 1024;

/// Table to be made.
pub struct Batch<'a> {
    /// Files, folders and tables of spectra.
    pub files: &'a [PathBuf],
    /// Points that are used.
    pub choice: Choice,
    /// The table.
    pub table: &'a Path,
    /// Everything beside the files that decides the results, as text.
    pub call: String,
    /// Folder of pictures, and which are wished for.
    pub pictures: Option<(&'a Path, Plots)>,
}

/// Works on every spectrum and writes the table.
///
/// # Errors
/// As [`work`].
pub fn work_on_spectra(batch: Batch<'_>, rows: &impl ResultRows) -> Result<(), Failure> {
    let mut source = Source::new(batch.files, batch.choice)?;
    let job = Job {
        table: batch.table,
        call: batch.call,
        columns: rows.columns(),
        part: PART,
        noun: ["spectrum", "spectra"],
    };
    let row = |one: &TableSpectrum| vec![rows.row(&one.spectrum_id, &one.spectrum)];
    work(job, &mut source, row, |spectra, results| {
        draw(batch.pictures, spectra, results)
    })
}

fn draw(
    pictures: Option<(&Path, Plots)>,
    spectra: &[TableSpectrum],
    results: &[Vec<ResultRow>],
) -> Result<(), Failure> {
    let Some((folder, plots)) = pictures else {
        return Ok(());
    };
    for (one, result) in spectra.iter().zip(results.iter().flatten()) {
        let needs_a_look = result.error.is_some() || result.has_warnings;
        let Ok(sourced) = &one.spectrum else { continue };
        if plots.draws(needs_a_look) {
            files::make_folder(folder)?;
            let title = result.error.as_deref().unwrap_or(&one.spectrum_id);
            let picture = compared(title, &sourced.spectrum, result.fitted.as_ref());
            let name = one.spectrum_id.replace(['/', '\\'], "_");
            files::write_picture(folder, &name, |path| plot::nyquist(&picture, path))?;
        }
    }
    Ok(())
}
