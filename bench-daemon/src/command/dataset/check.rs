//! `eis-bench dataset check`: checks whether `diagnose` accepts a data set.

use std::path::Path;

use analysis::diagnosis::{Role, RunData};

use bench_core::safety::failure::Failure;
use bench_evaluate::investigate::dataset::{named_files, read_dataset};
use bench_plan::support::terminal::say;

/// Reads a data set as `diagnose` does, and prints its contents.
///
/// # Errors
/// The first key that is missing or invalid, with file and line; [`Failure::Invalid`] for a run with a
/// damaged file.
pub(super) fn check(path: &Path) -> Result<(), Failure> {
    let read = read_dataset(path)?;
    let named = named_files(path)?;
    let runs = &read.set.runs;
    let in_time = |run: &&analysis::diagnosis::Run| matches!(run.data, RunData::Time(_));
    say!(
        "{}: {} runs: {} in time, {} spectra; {} held out",
        path.display(),
        runs.len(),
        runs.iter().filter(in_time).count(),
        runs.iter().filter(|run| !in_time(run)).count(),
        runs.iter().filter(|run| run.role == Role::HeldOut).count()
    );
    read.notes.iter().for_each(|note| say!("  {note}"));
    if named.model.is_none() {
        let curve = if named.ocv.is_some() {
            ""
        } else {
            "; it must hold an OCV curve, or --ocv must name one"
        };
        say!("  it names no model: `diagnose` needs --model{curve}");
    }
    match read.problems.first() {
        Some(problem) => Err(Failure::Invalid(problem.to_string())),
        None => Ok(()),
    }
}
