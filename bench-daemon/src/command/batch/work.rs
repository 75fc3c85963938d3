//! Works on many spectra, a part at a time, on all cores.

use std::path::{Path, PathBuf};

use analysis::batch::{BatchError, Parts, PartsPlan, TableSpectrum};
use analysis::plot;
use analysis::rows::{ResultRow, ResultRows};
use rayon::prelude::*;

use super::plots::Plots;
use super::source::{Choice, Source};
use crate::figures::impedance::compared;
use crate::files;
use crate::operator::progress::Share;
use crate::safety::failure::Failure;
use crate::support::terminal::{remark, say};

/// Spectra of one part: some seconds of work, so that a call that is killed loses no more.
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

/// Counts of a table.
#[derive(Default)]
struct Totals {
    spectra: usize,
    without_result: usize,
    with_warnings: usize,
}

/// Works on every spectrum and writes the table; goes on with the parts of a call that was killed.
///
/// # Errors
/// A file that cannot be read, a table that is there already, a folder that cannot be written. What
/// is wrong with one spectrum stands in its row.
pub fn work(batch: &Batch<'_>, rows: &impl ResultRows) -> Result<(), Failure> {
    let mut source = Source::new(batch.files, batch.choice)?;
    let plan = PartsPlan {
        out: batch.table.to_path_buf(),
        call: format!("{}\n{}", batch.call, source.identity()?),
        columns: rows.columns(),
    };
    let parts = Parts::begin(plan).map_err(|error| refused(&error))?;
    let (mut totals, mut part, mut before) = (Totals::default(), 0, 0);
    let shown = Share::shown();
    loop {
        let spectra = take(&mut source)?;
        if spectra.is_empty() {
            break;
        }
        totals.spectra += spectra.len();
        if parts.is_done(part) {
            before += spectra.len();
        } else {
            let results: Vec<ResultRow> = spectra
                .par_iter()
                .map(|one| rows.row(&one.spectrum_id, &one.spectrum))
                .collect();
            totals.count(&results);
            draw(batch, &spectra, &results)?;
            parts
                .write(part, &results)
                .map_err(|error| refused(&error))?;
        }
        part += 1;
        shown.at(source.share(), totals.spectra);
    }
    shown.end();
    if totals.spectra == 0 {
        let text = "expected at least one spectrum, found none".to_owned();
        return Err(Failure::Usage(text));
    }
    parts.finish(part).map_err(|error| refused(&error))?;
    if before > 0 {
        remark!("{before} spectra were worked on by a call before this one");
    }
    let Totals {
        spectra,
        without_result,
        with_warnings,
    } = totals;
    let told = if before > 0 { "of the others, " } else { "" };
    say!(
        "{spectra} spectra; {told}{without_result} without a result, {with_warnings} with warnings"
    );
    say!("written to {}", batch.table.display());
    Ok(())
}

impl Totals {
    fn count(&mut self, results: &[ResultRow]) {
        let count = |of: fn(&ResultRow) -> bool| results.iter().filter(|row| of(row)).count();
        self.without_result += count(|row| row.error.is_some());
        self.with_warnings += count(|row| row.has_warnings);
    }
}

fn take(source: &mut Source) -> Result<Vec<TableSpectrum>, Failure> {
    let mut spectra = Vec::new();
    while spectra.len() < PART {
        match source.next_spectrum()? {
            Some(one) => spectra.push(one),
            None => break,
        }
    }
    Ok(spectra)
}

fn draw(
    batch: &Batch<'_>,
    spectra: &[TableSpectrum],
    results: &[ResultRow],
) -> Result<(), Failure> {
    let Some((folder, plots)) = batch.pictures else {
        return Ok(());
    };
    for (one, result) in spectra.iter().zip(results) {
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

fn refused(error: &BatchError) -> Failure {
    Failure::Usage(error.to_string())
}
