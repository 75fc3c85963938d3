//! Joins run folders to one data set: the campaign and the experiments after it, with one count of
//! time and order.

use std::path::Path;

use analysis::{
    dataset::RunIndex,
    diagnosis::{Fixture, Planned, PlannedRun, Run, RunData},
    fit::RefusedPoint,
    run_folder::INDEX,
};

use crate::investigate::dataset::{Loaded, Reading, read_as};
use bench_core::safety::failure::Failure;
use bench_plan::config::ConfigError;

/// Name of the recommended run that repeats the first run of the campaign.
const SENTINEL: &str = "sentinel_repeat";

/// The run folders that are joined.
#[derive(Clone, Copy)]
pub(super) struct Folders<'a> {
    /// The campaign's folder. Its first run is the origin of time.
    pub(super) first: &'a Path,
    /// The experiment's after it.
    pub(super) later: &'a Path,
}

/// An experiment after the campaign.
#[derive(Debug, Clone, Copy)]
pub struct Later<'a> {
    /// Its run folder.
    pub folder: &'a Path,
    /// Start of its first run since that of the campaign's, s.
    pub start_s: f64,
}

/// Names of an experiment that is joined.
struct Names<'a> {
    /// That of the experiment.
    experiment: &'a str,
    /// That before the names of its runs.
    prefix: &'a str,
}

/// Appends the runs of an experiment to the previous ones. Their order and their repeats follow
/// the plan.
pub(super) fn add(
    loaded: &mut Loaded,
    folders: Folders<'_>,
    planned: &[PlannedRun],
) -> Result<(), Failure> {
    let later = Later {
        folder: folders.later,
        start_s: begin_s(folders.later)? - begin_s(folders.first)?,
    };
    join(loaded, later, |run, names| {
        let swept = is_sweep(run);
        let alike = || {
            planned
                .iter()
                .filter(|plan| matches!(plan.what, Planned::Eis { .. }) == swept)
        };
        let plan = alike()
            .find(|plan| run.repeat_group == plan.repeat_group)
            .or(alike().next());
        match plan {
            // What repeats nothing of the campaign repeats itself alone: an earlier experiment of
            // this name found another cell.
            Some(plan) if plan.repeat_group == plan.name => {
                format!("{}_{}", names.prefix, plan.name)
            }
            Some(plan) => plan.repeat_group.clone(),
            None => run.repeat_group.clone(),
        }
    })
}

/// Adds the runs of a recommended experiment whose plan is unavailable. Its file names the group
/// of a record; only sweeps of the sentinel repeat the campaign.
///
/// # Errors
/// A run folder that cannot be read.
pub fn add_played(loaded: &mut Loaded, later: Later<'_>) -> Result<(), Failure> {
    let records = loaded.set.runs.iter().filter(|run| !is_sweep(run));
    let known: Vec<String> = records.map(|run| run.repeat_group.clone()).collect();
    let cells = loaded.set.runs.iter().filter(|run| is_of_cell(run));
    let first = cells
        .filter(|run| is_sweep(run))
        .min_by_key(|run| run.order)
        .map(|run| run.repeat_group.clone());
    join(loaded, later, |run, names| {
        let repeated = first
            .as_ref()
            .filter(|_| is_sweep(run) && names.experiment == SENTINEL);
        let own = &run.repeat_group;
        match repeated {
            Some(group) => group.clone(),
            None if !is_sweep(run) && known.contains(own) => own.clone(),
            None => format!("{}_{own}", names.prefix),
        }
    })
}

fn is_sweep(run: &Run) -> bool {
    matches!(run.data, RunData::Eis(_))
}

fn is_of_cell(run: &Run) -> bool {
    matches!(run.fixture, Fixture::Cell(_))
}

/// Adds the runs of an experiment, each to the group that `group` gives.
fn join(
    loaded: &mut Loaded,
    later: Later<'_>,
    group: impl Fn(&Run, &Names<'_>) -> String,
) -> Result<(), Failure> {
    let refused_points = loaded.refused.iter().any(|point| point.fitted);
    let mut more = read_as(
        later.folder,
        Reading {
            known: loaded.set.calibration,
            refused_points,
        },
    )?;
    let orders = loaded
        .set
        .runs
        .iter()
        .map(|run| run.order + 1)
        .max()
        .unwrap_or(0);
    let prefix = later
        .folder
        .file_name()
        .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let names = Names {
        experiment: &more.set.name,
        prefix: &prefix,
    };
    for run in &mut more.set.runs {
        run.name = format!("{prefix}_{}", run.name);
        run.order += orders;
        run.start_s += later.start_s;
        run.repeat_group = group(run, &names);
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
