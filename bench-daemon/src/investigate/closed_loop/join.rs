//! Joins run folders to one data set: the campaign and the experiments after it, with one count of
//! time and order.

use std::path::Path;

use analysis::{
    dataset::RunIndex,
    diagnosis::{Planned, PlannedRun, RunData},
    fit::RefusedPoint,
    run_folder::INDEX,
};

use crate::{
    config::ConfigError,
    investigate::dataset::{Loaded, Reading, read_as},
    safety::failure::Failure,
};

/// The run folders that are joined.
#[derive(Clone, Copy)]
pub(super) struct Folders<'a> {
    /// The campaign's, whose first run begins the count of time.
    pub(super) first: &'a Path,
    /// The experiment's after it.
    pub(super) later: &'a Path,
}

/// Adds the runs of an experiment to those before it: they come later, and repeat what the plan
/// says that they repeat.
pub(super) fn add(
    loaded: &mut Loaded,
    folders: Folders<'_>,
    planned: &[PlannedRun],
) -> Result<(), Failure> {
    let folder = folders.later;
    let refused_points = loaded.refused.iter().any(|point| point.fitted);
    let mut more = read_as(
        folder,
        Reading {
            known: loaded.set.calibration,
            refused_points,
        },
    )?;
    let later_s = begin_s(folder)? - begin_s(folders.first)?;
    let orders = loaded
        .set
        .runs
        .iter()
        .map(|run| run.order + 1)
        .max()
        .unwrap_or(0);
    let prefix = folder
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    for run in &mut more.set.runs {
        run.name = format!("{prefix}_{}", run.name);
        run.order += orders;
        run.start_s += later_s;
        let swept = matches!(run.data, RunData::Eis(_));
        let alike = || {
            planned
                .iter()
                .filter(|plan| matches!(plan.what, Planned::Eis { .. }) == swept)
        };
        if let Some(plan) = alike()
            .find(|plan| run.repeat_group == plan.repeat_group)
            .or(alike().next())
        {
            // What repeats nothing of the campaign repeats itself alone: an earlier experiment of
            // this name found another cell.
            run.repeat_group = if plan.repeat_group == plan.name {
                format!("{prefix}_{}", plan.name)
            } else {
                plan.repeat_group.clone()
            };
        }
    }
    loaded.set.runs.extend(more.set.runs);
    loaded.problems.extend(more.problems);
    loaded.notes.extend(more.notes);
    loaded
        .refused
        .extend(more.refused.into_iter().map(|point| RefusedPoint {
            spectrum: format!("{prefix}_{}", point.spectrum),
            ..point
        }));
    // A repeat of what lost a point before has to lose it too.
    loaded.leave_out_refused();
    Ok(())
}

/// Bench time of a folder's first run, s.
fn begin_s(folder: &Path) -> Result<f64, Failure> {
    let path = folder.join(INDEX);
    let fail = |reason: String| {
        Failure::Config(ConfigError::Unreadable {
            path: path.clone(),
            reason,
        })
    };
    let text = std::fs::read_to_string(&path).map_err(|error| fail(error.to_string()))?;
    let index: RunIndex = serde_json::from_str(&text).map_err(|error| fail(error.to_string()))?;
    let starts = index
        .sweeps
        .iter()
        .map(|sweep| sweep.start_time_s)
        .chain(index.traces.iter().map(|trace| trace.start_time_s));
    Ok(starts.fold(f64::INFINITY, f64::min))
}
