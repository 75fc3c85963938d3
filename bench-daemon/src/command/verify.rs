//! `eis-bench verify`: checks that a run folder is unchanged, and that its numbers follow from its
//! captures.
//!
//! First every file is compared with its hash. Then everything that follows from captures and
//! readings is computed again, in a folder of its own. It is compared with the stored results, file
//! by file and number by number. Nothing is changed in the run folder.

use std::path::{Path, PathBuf};

use analysis::run_folder::{
    CAPTURES, EVENTS, JOURNAL, LOG, MANIFEST, READINGS, REPORT, SUMS, TRANSCRIPTS,
};
use clap::Args;
use rayon::prelude::*;

use super::replay::{Scratch, run_folders};
use crate::{
    run::{OtherResults, RecomputedPoint, Recorded, RecordedPoint},
    safety::failure::Failure,
    support::compare::{Difference, compare},
    support::sums::{self, Altered},
    support::terminal::say,
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
}

/// Verifies runs.
///
/// # Errors
/// A run that is not what it was, or cannot be read.
pub fn verify(args: &VerifyArgs) -> Result<(), Failure> {
    let mut bad = 0;
    for folder in run_folders(&args.runs)? {
        bad += usize::from(!of_run(&folder)?);
    }
    if bad == 0 {
        Ok(())
    } else {
        Err(Failure::Differs(format!(
            "{bad} of the run folders are not what they should be"
        )))
    }
}

fn of_run(folder: &Path) -> Result<bool, Failure> {
    let name = folder.display();
    // A report is written at the end: where there is one, it must follow from the captures,
    // whatever the journal says of the end.
    if !folder.join(SUMS).exists()
        && !folder.join(REPORT).exists()
        && let Some(how) = Recorded::read(folder)?.stopped()
    {
        say!(
            "{name}: the run was stopped ({how}): no report, no {SUMS}; only its captures can be \
            held against its journal"
        );
        let (count, differences) = points(folder)?;
        differences
            .iter()
            .for_each(|one| say!("  {}: {}", one.file, one.what));
        say!(
            "{name}: {count} points recomputed from captures: {}",
            counted(differences.len(), "as in the journal", "differences")
        );
        return Ok(differences.is_empty());
    }
    let altered = if folder.join(SUMS).exists() {
        let (files, altered) =
            sums::check(folder).map_err(|error| Failure::Usage(error.to_string()))?;
        say!(
            "{name}: {files} files held against {SUMS}: {}",
            counted(altered.len(), "as they were", "altered")
        );
        altered
    } else {
        say!("{name}: no {SUMS}, though the run came to its end or wrote a report");
        vec![Altered {
            file: SUMS.to_owned(),
            what: "missing".to_owned(),
        }]
    };
    altered
        .iter()
        .for_each(|one| say!("  {}: {}", one.file, one.what));
    let differences = match recomputed(folder) {
        Ok(differences) => differences,
        // What was altered may be what is needed.
        Err(failure) if !altered.is_empty() => {
            say!("{name}: nothing was recomputed: {failure}");
            return Ok(false);
        }
        Err(failure) => return Err(failure),
    };
    differences
        .iter()
        .for_each(|one| say!("  {}: {}", one.file, one.what));
    Ok(altered.is_empty() && differences.is_empty())
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
fn recomputed(folder: &Path) -> Result<Vec<Difference>, Failure> {
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
    let files = made(scratch.path(), Path::new(""))?;
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
    let numbers = if differences.is_empty() {
        "every number as stored".to_owned()
    } else {
        format!("{} differences", differences.len())
    };
    say!(
        "{}: {}{} files recomputed from captures: {numbers}",
        folder.display(),
        counts(known.len(), &others),
        files.len()
    );
    for file in &others.as_read {
        say!(
            "  {file}: its rows are what meters said, and no capture tells them anew: held against \
            its hash"
        );
    }
    for file in &others.uncommanded {
        say!(
            "  {file}: recorded by a version that did not write down what was commanded: held \
            against its hash alone"
        );
    }
    if !differences.is_empty() && recorded.version() != env!("CARGO_PKG_VERSION") {
        say!(
            "  recorded by version {}, recomputed by {}",
            recorded.version(),
            env!("CARGO_PKG_VERSION")
        );
    }
    Ok(differences)
}

/// How much was computed from captures.
fn counts(points: usize, others: &OtherResults) -> String {
    let told = [
        (points, "points"),
        (others.lines, "lines of multisines"),
        (others.rows, "rows of traces"),
    ];
    told.iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, of)| format!("{count} {of}, "))
        .collect()
}

/// Files of a folder that were computed: not what was only read, nor links to it.
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
