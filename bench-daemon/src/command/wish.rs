//! `eis-bench pause`, `go-on`, `abort` and `reorder`: what is wanted of a run in another terminal.

use std::path::PathBuf;

use clap::Args;

use crate::terminal::say;
use crate::{
    command::Failure,
    journal::{self, Entry},
    story::Story,
    wishes::{Course, Wishes},
};

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
    /// Numbers of the runs that come next, in this order; the others follow as they were.
    #[arg(required = true)]
    pub runs: Vec<usize>,
}

/// Says whether a run is to pause, to go on or to end.
///
/// # Errors
/// A folder in which nothing runs.
pub fn wish(args: &FolderArgs, course: Course) -> Result<(), Failure> {
    said(args, &Wishes { course, ..Wishes::read(&args.folder) })?;
    say!(
        "{}",
        match course {
            Course::Pause => "pauses at the next point, every output off; `eis-bench go-on` lets it go on",
            Course::GoOn => "goes on",
            Course::Abort => "ends at the next point, in safe state; `eis-bench resume` can take it up again",
        }
    );
    Ok(())
}

/// Says which runs of a campaign come next.
///
/// # Errors
/// As [`wish`].
pub fn reorder(args: &ReorderArgs) -> Result<(), Failure> {
    said(&FolderArgs { folder: args.folder.clone() }, &Wishes { order: args.runs.clone(), ..Wishes::read(&args.folder) })?;
    say!("after the run in work: {}", args.runs.iter().map(ToString::to_string).collect::<Vec<_>>().join(", "));
    Ok(())
}

fn said(args: &FolderArgs, wishes: &Wishes) -> Result<(), Failure> {
    let usage = |text: String| Failure::Usage(format!("{}: {text}", args.folder.display()));
    let lines = journal::read(&args.folder).map_err(|error| Failure::Usage(error.to_string()))?.lines;
    let story = Story::of(&lines).map_err(|error| usage(error.to_string()))?;
    if let Some(how) = story.ended {
        return Err(usage(format!("expected a run that is going on, found one that has ended: {how}")));
    }
    if lines.iter().any(|line| matches!(&line.entry, Entry::Started(started) if started.time == "virtual")) {
        return Err(usage("expected a run in real or scaled time: in virtual time nobody is asked".to_owned()));
    }
    wishes.write(&args.folder).map_err(|error| usage(error.to_string()))
}
