//! `eis-bench verify`: checks that a run folder is unchanged, and that its numbers follow from its
//! captures.
//!
//! First every file is compared with its hash. Then everything that follows from captures and
//! readings is computed again, in a folder of its own. It is compared with the stored results, file
//! by file and number by number. Nothing is changed in the run folder.

use crate::command::printed::say_json;
use std::path::{Path, PathBuf};

use analysis::run_folder::{
    CAPTURES, EVENTS, JOURNAL, LOG, MANIFEST, READINGS, REPORT, SUMS, TRANSCRIPTS, moved_captures,
    sums::Sums,
};
use clap::Args;
use rayon::prelude::*;

use super::replay::{Scratch, run_folders};
use bench_core::safety::failure::Failure;
use bench_evaluate::{
    run::{RecomputedPoint, Recorded, RecordedPoint},
    support::compare::{Difference, compare},
};
use bench_plan::support::{
    sums::{self, Altered},
    terminal::say,
};

/// Files that a folder holds only as they were read: no capture reproduces them.
const AS_READ: [&str; 7] = [
    JOURNAL,
    MANIFEST,
    EVENTS,
    READINGS,
    CAPTURES,
    TRANSCRIPTS,
    LOG,
];

/// Arguments of `verify`.
#[derive(Debug, Args)]
pub struct VerifyArgs {
    /// Run folders, or folders of run folders.
    #[arg(required = true, value_name = "RUN")]
    pub runs: Vec<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// How much was recomputed from captures.
#[derive(Debug, Default, serde::Serialize)]
struct Counts {
    points: usize,
    lines_of_multisines: usize,
    rows_of_traces: usize,
    files: usize,
}

/// Outcome of the check of a run folder.
#[derive(Debug, Default, serde::Serialize)]
struct Verified {
    folder: PathBuf,
    /// The run is unaltered, and every number follows from its captures, as far as they exist.
    good: bool,
    /// Number of files that were compared with their hashes; `None` if the folder has none.
    hashed_files: Option<usize>,
    /// Number of captures that were moved to an archive: nothing is recomputed without them.
    moved_files: usize,
    /// Files that are not what they were.
    altered: Vec<Altered>,
    /// The run was stopped, and how: only its captures can be held against its journal.
    stopped: Option<String>,
    /// Amount that was recomputed from captures.
    recomputed: Counts,
    /// Numbers that came out otherwise.
    differences: Vec<Difference>,
    /// Results that cannot be recomputed from a capture, by file.
    as_read: Vec<String>,
    /// Remarks, as sentences.
    notes: Vec<String>,
}

/// Verifies runs.
///
/// # Errors
/// A run that was altered, or cannot be read.
pub fn verify(args: &VerifyArgs) -> Result<(), Failure> {
    let mut all = Vec::new();
    for folder in run_folders(&args.runs)? {
        let verified = of_run(&folder)?;
        if !args.json {
            tell(&verified);
        }
        all.push(verified);
    }
    if args.json {
        say_json(&all)?;
    }
    match all.iter().filter(|one| !one.good).count() {
        0 => Ok(()),
        bad => Err(Failure::Differs(format!(
            "{bad} of the run folders are not what they should be"
        ))),
    }
}

fn of_run(folder: &Path) -> Result<Verified, Failure> {
    let mut verified = Verified {
        folder: folder.to_owned(),
        ..Verified::default()
    };
    // A report is written at the end: if it exists, it must follow from the captures, whatever
    // the journal records about the end.
    if !folder.join(SUMS).exists()
        && !folder.join(REPORT).exists()
        && let Some(how) = Recorded::read(folder)?.stopped()
    {
        verified.stopped = Some(how.to_string());
        let (count, differences) = points(folder)?;
        verified.recomputed.points = count;
        verified.good = differences.is_empty();
        verified.differences = differences;
        return Ok(verified);
    }
    if folder.join(SUMS).exists() {
        let checked = sums::check(folder).map_err(|error| Failure::Usage(error.to_string()))?;
        verified.hashed_files = Some(checked.files);
        verified.moved_files = checked.moved;
        verified.altered = checked.altered;
    } else {
        verified.altered = vec![Altered {
            file: SUMS.to_owned(),
            what: "missing, though the run came to its end or wrote a report".to_owned(),
        }];
    }
    if verified.moved_files > 0 {
        let moved = moved_captures(folder).map_err(Failure::Usage)?;
        verified.notes.push(format!(
            "nothing was recomputed: {}",
            moved.unwrap_or_default()
        ));
        verified.good = verified.altered.is_empty();
        return Ok(verified);
    }
    match recomputed(folder, &mut verified) {
        Ok(differences) => verified.differences = differences,
        // A required file may be among the altered ones.
        Err(failure) if !verified.altered.is_empty() => {
            verified
                .notes
                .push(format!("nothing was recomputed: {failure}"));
            return Ok(verified);
        }
        Err(failure) => return Err(failure),
    }
    verified.good = verified.altered.is_empty() && verified.differences.is_empty();
    Ok(verified)
}

fn tell(verified: &Verified) {
    let name = verified.folder.display();
    if let Some(files) = verified.hashed_files {
        let altered = counted(verified.altered.len(), "as they were", "altered");
        say!("{name}: {files} files held against {SUMS}: {altered}");
    }
    for Altered { file, what } in &verified.altered {
        say!("  {file}: {what}");
    }
    for Difference { file, what } in &verified.differences {
        say!("  {file}: {what}");
    }
    let counts = &verified.recomputed;
    let differing = verified.differences.len();
    if let Some(how) = &verified.stopped {
        say!(
            "{name}: the run was stopped ({how}): no report, no {SUMS}; only its captures can be \
            held against its journal"
        );
        let outcome = counted(differing, "as in the journal", "differences");
        say!(
            "{name}: {} points recomputed from captures: {outcome}",
            counts.points
        );
    } else if counts.files > 0 {
        let numbers = if differing == 0 {
            "every number as stored".to_owned()
        } else {
            format!("{differing} differences")
        };
        let kinds = [
            (counts.points, "points"),
            (counts.lines_of_multisines, "lines of multisines"),
            (counts.rows_of_traces, "rows of traces"),
        ];
        let parts: String = kinds
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, of)| format!("{count} {of}, "))
            .collect();
        let files = counts.files;
        say!("{name}: {parts}{files} files recomputed from captures: {numbers}");
    }
    for file in &verified.as_read {
        say!(
            "  {file}: its rows are meter readings, which no capture can reproduce: only its hash \
            was checked"
        );
    }
    verified.notes.iter().for_each(|note| say!("  {note}"));
}

fn counted(count: usize, none: &str, some: &str) -> String {
    if count == 0 {
        format!("all {none}")
    } else {
        format!("{count} {some}")
    }
}

/// The points again, and how many there are.
fn points(folder: &Path) -> Result<(usize, Vec<Difference>), Failure> {
    let recorded = Recorded::read(folder)?;
    let known = recorded.points()?;
    let recomputed = recorded.analyse(&known)?;
    Ok((known.len(), changed(&known, &recomputed)))
}

fn changed(known: &[RecordedPoint], recomputed: &[RecomputedPoint]) -> Vec<Difference> {
    let differing = known
        .iter()
        .zip(recomputed)
        .filter(|(known, recomputed)| known.point != recomputed.point);
    let what = |known: &RecordedPoint| {
        format!(
            "the journal's point at {} Hz differs from what this capture gives",
            known.point.phasors.freq_hz
        )
    };
    differing
        .map(|(known, recomputed)| Difference {
            file: recomputed.file.clone(),
            what: what(known),
        })
        .collect()
}

/// Everything again, from the captures on.
fn recomputed(folder: &Path, verified: &mut Verified) -> Result<Vec<Difference>, Failure> {
    let recorded = Recorded::read(folder)?;
    let known = recorded.points()?;
    let recomputed = recorded.analyse(&known)?;
    let mut differences = changed(&known, &recomputed);
    let scratch = Scratch::new("verify")?;
    let points: Vec<_> = known
        .iter()
        .zip(recomputed)
        .map(|(known, recomputed)| (known.stage, recomputed.point))
        .collect();
    let others = recorded.settle(&points, scratch.path(), true)?;
    let (files, unknown) = written(folder, made(scratch.path(), Path::new(""))?);
    verified.notes.extend(unknown.iter().map(|file| {
        format!("{file}: neither stored nor in {SUMS}: the version that wrote the folder did not write it")
    }));
    let compared: Vec<Vec<Difference>> = files
        .par_iter()
        .map(|file| match compare(folder, scratch.path(), file) {
            Err(_) => vec![Difference {
                file: file.clone(),
                what: "cannot be read, and follows from the captures".to_owned(),
            }],
            Ok(differences) => differences,
        })
        .collect();
    differences.extend(compared.into_iter().flatten());
    verified.recomputed = Counts {
        points: known.len(),
        lines_of_multisines: others.lines,
        rows_of_traces: others.rows,
        files: files.len(),
    };
    verified.as_read = others.as_read;
    for file in &others.uncommanded {
        verified.notes.push(format!(
            "{file}: recorded by a version that did not write down what was commanded: held against \
            its hash alone"
        ));
    }
    if !differences.is_empty() && recorded.version() != env!("CARGO_PKG_VERSION") {
        verified.notes.push(format!(
            "recorded by version {}, recomputed by {}",
            recorded.version(),
            env!("CARGO_PKG_VERSION")
        ));
    }
    Ok(differences)
}

/// Divides computed files into those that the run wrote, and those that its version did not write: they
/// are neither stored nor in the list of hashes, which is written last.
fn written(folder: &Path, files: Vec<String>) -> (Vec<String>, Vec<String>) {
    let text = std::fs::read_to_string(folder.join(SUMS)).unwrap_or_default();
    let listed = Sums::of(&text).files;
    files.into_iter().partition(|file| {
        listed.is_empty() || listed.contains_key(file.as_str()) || folder.join(file).exists()
    })
}

/// Returns the computed files of a folder, without input files and links to them.
fn made(folder: &Path, below: &Path) -> Result<Vec<String>, Failure> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder.join(below))? {
        let entry = entry?;
        let name = below.join(entry.file_name()).display().to_string();
        let kind = entry.file_type()?;
        if AS_READ.contains(&name.as_str()) || kind.is_symlink() {
            continue;
        }
        if kind.is_dir() {
            files.extend(made(folder, Path::new(&name))?);
        } else {
            files.push(name);
        }
    }
    files.sort_unstable();
    Ok(files)
}
