//! `eis-bench pause`, `go-on`, `abort` and `reorder`: send a run control request to a run in
//! another terminal.

use std::path::{Path, PathBuf};

use clap::Args;

use bench_core::{
    journal::replay::JournalReplay,
    journal::{self, Entry, Line},
    operator::run_control::{self, RunAction, RunControl, RunStatus},
    safety::failure::{Failure, pasted},
    safety::state::{Holder, State, is_stopped},
};
use bench_evaluate::run::begun_experiment;
use bench_plan::{config, procedure, support::terminal::say};

/// Arguments of `pause`, `go-on` and `abort`.
#[derive(Debug, Args)]
pub struct FolderArgs {
    /// The run folder.
    pub folder: PathBuf,
}

/// Arguments of `reorder`.
#[derive(Debug, Args)]
pub struct ReorderArgs {
    /// The run folder.
    pub folder: PathBuf,
    /// Numbers of the next runs, in this order; the others follow in their previous order.
    #[arg(required = true)]
    pub runs: Vec<usize>,
}

/// Requests that a run pauses, continues or ends.
///
/// # Errors
/// A folder without an active run.
pub fn send_action(args: &FolderArgs, action: RunAction) -> Result<(), Failure> {
    let replay = going_on(&args.folder)?;
    let request = RunControl {
        action,
        ..RunControl::read(&args.folder)
    };
    request
        .write(&args.folder)
        .map_err(|error| Failure::Usage(format!("{}: {error}", args.folder.display())))?;
    match action {
        RunAction::Pause => {
            let takes = step_s(&args.folder, &replay).map_or_else(String::new, |step_s| {
                format!(", which takes about {step_s:.0} s of bench time in all")
            });
            say!(
                "pauses after the step in work{takes}, in safe state; `eis-bench go-on` lets it \
                go on"
            );
        }
        RunAction::GoOn => say!("goes on"),
        RunAction::Abort => say!(
            "ends in safe state: at the next point of a sweep, behind a trace, within seconds of \
            anything else; then `eis-bench resume` can take it up again"
        ),
    }
    Ok(())
}

/// Returns the expected bench time of the step in work, s.
fn step_s(folder: &Path, replay: &JournalReplay) -> Option<f64> {
    let lines = journal::read(folder).ok()?.lines;
    let in_work = |line: &Line| match line.entry {
        Entry::Intent { stage, step, .. } => Some((stage, step)),
        _ => None,
    };
    let (stage, step) = lines.iter().rev().find_map(in_work)?;
    let experiment = begun_experiment(folder, &replay.started).ok()?;
    let plan = procedure::plan(&experiment);
    Some(plan.stages.get(stage)?.steps.get(step)?.expected_s().0)
}

/// Sets which runs of a campaign come next. Replaces any earlier order.
///
/// # Errors
/// As [`send_action`]; runs that do not belong to the campaign, that are named twice or that have
/// begun.
pub fn reorder(args: &ReorderArgs) -> Result<(), Failure> {
    let usage = |text: String| Failure::Usage(format!("{}: {text}", args.folder.display()));
    let replay = going_on(&args.folder)?;
    let runs = run_statuses(&args.folder, &replay)?;
    if runs.is_empty() {
        return Err(usage(
            "expected a campaign, whose runs have an order, found an experiment without [campaign]"
                .to_owned(),
        ));
    }
    let coming = run_control::coming(&runs, &args.runs).map_err(usage)?;
    let before = RunControl::read(&args.folder);
    let request = RunControl {
        order: args.runs.clone(),
        action: before.action,
    };
    request
        .write(&args.folder)
        .map_err(|error| usage(error.to_string()))?;
    let work = run_control::in_words(
        runs.iter()
            .filter(|run| run.1 == RunStatus::InWork)
            .map(|run| run.0),
    );
    say!(
        "in work: {work}; then: {}",
        run_control::in_words(coming.into_iter())
    );
    if !before.order.is_empty() && before.order != request.order {
        say!(
            "the order that was asked for before holds no more: {}",
            run_control::in_words(before.order.into_iter())
        );
    }
    Ok(())
}

/// Returns the runs of the campaign by number, as far as they have progressed; empty without a
/// campaign.
fn run_statuses(folder: &Path, replay: &JournalReplay) -> Result<Vec<(usize, RunStatus)>, Failure> {
    let experiment = begun_experiment(folder, &replay.started)?;
    let plan = procedure::plan(&experiment);
    let of_run = |number: usize| {
        plan.stages
            .iter()
            .enumerate()
            .filter(move |(_, stage)| stage.run() == Some(number))
    };
    let status = |number: usize| {
        if of_run(number).all(|(stage, _)| replay.finished(stage)) {
            RunStatus::Finished
        } else if of_run(number).any(|(stage, _)| replay.stages.contains_key(&stage)) {
            RunStatus::InWork
        } else {
            RunStatus::NotBegun
        }
    };
    let runs = experiment
        .campaign
        .iter()
        .flat_map(|campaign| campaign.runs());
    Ok(runs.map(|run| (run.number, status(run.number))).collect())
}

/// Returns the progress of an active run that accepts requests.
fn going_on(folder: &Path) -> Result<JournalReplay, Failure> {
    let usage = |text: String| Failure::Usage(format!("{}: {text}", folder.display()));
    let lines = journal::read(folder)
        .map_err(|error| Failure::Usage(error.to_string()))?
        .lines;
    let replay = JournalReplay::of(&lines).map_err(|error| usage(error.to_string()))?;
    // A run that waits to continue automatically has ended for now, but still holds its journal.
    if let Some(how) = replay
        .ended
        .as_ref()
        .filter(|_| !journal::is_written(folder))
    {
        return Err(usage(format!(
            "expected a run that is going on, found one that has ended: {how}"
        )));
    }
    if lines
        .iter()
        .any(|line| matches!(&line.entry, Entry::Started(started) if started.time == "virtual"))
    {
        return Err(usage(
            "expected a run in real or scaled time: a run in virtual time takes no requests"
                .to_owned(),
        ));
    }
    if !journal::is_written(folder) {
        return Err(usage(unheard(folder, &replay, &lines)));
    }
    let holder = begun_experiment(folder, &replay.started)
        .ok()
        .and_then(|begun| State::of(&begun.bench).ok()??.holder().ok()?);
    if let Some(Holder { pid, .. }) = holder.filter(|holder| is_stopped(holder.pid)) {
        let text = format!(
            "the run cannot receive requests: its process {pid} is stopped; `eis-bench safe --kill \
            BENCH` ends it and switches off"
        );
        return Err(usage(text));
    }
    Ok(replay)
}

/// Describes a run without a process: requests have no receiver. States how far the run came, in
/// which state it left its bench, and what to do.
fn unheard(folder: &Path, replay: &JournalReplay, lines: &[Line]) -> String {
    let points: usize = replay.stages.values().map(|stage| stage.points.len()).sum();
    let last = lines.iter().rev().find_map(|line| match &line.entry {
        Entry::Intent { text, .. } => Some(text.as_str()),
        _ => None,
    });
    let bench_state = match begun_experiment(folder, &replay.started) {
        Ok(begun) => bench_state(&begun.bench),
        Err(error) => format!("what its bench was left in is not known ({error})"),
    };
    format!(
        "the run cannot receive requests: its process ended at {:.0} s of bench time, {points} \
        points finished, last in step \"{}\"; {bench_state}; `eis-bench resume {}` continues it",
        replay.last_s.0,
        last.unwrap_or("none"),
        pasted(folder)
    )
}

/// State in which a run has left its bench, by its records.
fn bench_state(bench: &config::Bench) -> String {
    let safe = format!(
        "`eis-bench safe {}` switches off at any time",
        pasted(&bench.path)
    );
    match State::of(bench).and_then(|state| {
        state.map_or(Ok(None), |state| {
            Ok(Some((state.latched()?, state.outputs())))
        })
    }) {
        Ok(Some((Some(cause), _))) => format!("its bench is latched: {cause}; {safe}"),
        Ok(Some((None, read))) => format!("its bench: {}; {safe}", read.words),
        Ok(None) => "its simulated bench is gone with it".to_owned(),
        Err(error) => format!("what its bench was left in is not known ({error}): {safe}"),
    }
}
