//! Data set for a diagnosis of several runs: a campaign, and later experiments on the same cell.

use std::{
    collections::BTreeSet,
    fmt::Display,
    path::{Path, PathBuf},
};

use analysis::{
    dataset::write_atomically,
    diagnosis::{DataSet, Fixture, RunData},
    run_folder::OCV_CURVE,
};

use super::error::AnalysisError;
use crate::{jobs, settings::Settings};
use bench_evaluate::{
    investigate::{
        closed_loop::{Later, add_played},
        dataset::{read_dataset, write_dataset},
    },
    run::Recorded,
};

/// The data set as the diagnosis reads it.
pub(super) struct Joined {
    /// Its folder.
    pub(super) folder: PathBuf,
    /// Open-circuit voltage of the cell from its file; `None` if the file states none.
    pub(super) ocv: Option<PathBuf>,
}

/// Joins runs, the campaign first, and writes them below a folder.
///
/// # Errors
/// Runs that cannot be read or are of several cells; a folder that cannot be written.
pub(super) fn joined(
    settings: &Settings,
    runs: &[String],
    into: &Path,
) -> Result<Joined, AnalysisError> {
    let unfit = |run: &str, error: &dyn Display| {
        AnalysisError::Unfit(format!("runs: {run} cannot be joined: {error}"))
    };
    let failed = |error: &dyn Display| AnalysisError::Io(error.to_string());
    let Some((first, later)) = runs.split_first() else {
        return Err(unfit("none", &"expected at least one run"));
    };
    let campaign = settings.runs().join(first);
    let mut loaded = read_dataset(&campaign).map_err(|error| unfit(first, &error))?;
    for run in later {
        let apart_s = begun_s(settings, run) - begun_s(settings, first);
        let folder = settings.runs().join(run);
        let later = Later {
            folder: &folder,
            // In virtual time a run takes longer than the clock on the wall shows.
            start_s: apart_s.max(end_s(&loaded.set)),
        };
        add_played(&mut loaded, later).map_err(|error| unfit(run, &error))?;
    }
    if let Some(problem) = loaded.problems.first() {
        return Err(unfit(&problem.run, &problem.text));
    }
    of_one_cell(&loaded.set)?;
    let folder = into.join("data");
    write_dataset(&folder, &loaded.set).map_err(|error| failed(&error))?;
    let recorded = Recorded::read(&campaign).map_err(|error| unfit(first, &error))?;
    let mut ocv = None;
    if let Some(curve) = recorded.ocv() {
        let text = serde_json::to_string(curve).map_err(|error| failed(&error))?;
        let path = into.join(OCV_CURVE);
        write_atomically(&path, text.as_bytes()).map_err(|error| failed(&error))?;
        ocv = Some(path);
    }
    Ok(Joined { folder, ocv })
}

/// Returns when a run began, s since 1970, or 0 if that is unknown.
fn begun_s(settings: &Settings, run: &str) -> f64 {
    let process = jobs::read(&settings.data, run).and_then(|job| job.item.process);
    process.map_or(0.0, |process| process.started_unix_s)
}

/// End of the last run, s since the first of the campaign.
fn end_s(set: &DataSet) -> f64 {
    let ends = set.runs.iter().map(|run| {
        let span_s = match &run.data {
            RunData::Time(record) => record.series.time_s.last(),
            RunData::Eis(sweep) => sweep.elapsed_s.last(),
        };
        run.start_s + span_s.copied().unwrap_or(0.0)
    });
    ends.fold(0.0, f64::max)
}

/// A model is one cell's.
fn of_one_cell(set: &DataSet) -> Result<(), AnalysisError> {
    let names = set.runs.iter().filter_map(|run| match &run.fixture {
        Fixture::Cell(name) => Some(name.as_str()),
        _ => None,
    });
    let cells: BTreeSet<&str> = names.collect();
    if cells.len() <= 1 {
        return Ok(());
    }
    let found = cells.into_iter().collect::<Vec<_>>().join(", ");
    Err(AnalysisError::Unfit(format!(
        "runs: expected runs of one cell, found {found}"
    )))
}
