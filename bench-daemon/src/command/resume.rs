//! `eis-bench resume`: continues a run that crashed or was stopped, in its folder and with its
//! original configuration.
//!
//! If the instruments persist, it queries them first, brings them into safe state, and continues
//! at the next unfinished point. A simulated world in virtual time ends with its process. In that
//! case the whole run is simulated again from its seed into a separate folder, which replaces the
//! old one if everything that the old run had finished is bit-identical.

use std::{
    fs,
    path::{Path, PathBuf},
};

use analysis::{
    dataset::FLAGS,
    run_folder::{JOURNAL, READINGS_PARQUET},
};
use instruments::{clock::TimeMode, transport::Address};

use crate::command::{diagnose, run::run_experiment};
use bench_core::{
    journal::{self, Entry, Line},
    operator::run_control::RunControl,
    record::RecordError,
    safety::bench_lease,
    safety::failure::Failure,
};
use bench_evaluate::run::{Accepted, ResumeContext, Session};
use bench_plan::{config::Experiment, support::terminal::say};

/// Arguments of `resume`.
#[derive(Debug, clap::Args)]
pub struct ResumeArgs {
    /// The run folder.
    pub folder: PathBuf,
    /// Repeat a step whose moved charge is unknown, or continue a sweep although the state of the
    /// cell has changed. Use it only after an inspection of the cell.
    #[arg(long)]
    pub accept_charge: bool,
    /// Continue although the serial number or identity of an instrument has changed. The finished
    /// part was measured with the old instrument; the report names both.
    #[arg(long)]
    pub accept_instruments: bool,
}

/// Tables and transcripts only grow: the existing content must be the beginning of the new
/// content.
const GROWING: [&str; 4] = ["csv", "txt", "jsonl", "torn"];
/// Files that are written again as the run goes.
const REWRITTEN: [&str; 1] = ["json"];

/// Resumes a run.
///
/// # Errors
/// A folder from which the run cannot continue; later as `run`.
pub fn resume(args: &ResumeArgs) -> Result<(), Failure> {
    // Without the slash that a terminal appends.
    let folder = &args.folder.components().collect::<PathBuf>();
    // A run that is still active must find its folder and its requests unchanged. Outputs that it
    // has left on are switched off in any case.
    let accepted = Accepted {
        charge: args.accept_charge,
        instruments: args.accept_instruments,
    };
    let (experiment, context) = ResumeContext::read(folder, accepted, |experiment| {
        bench_lease::refuse(&experiment.bench)?;
        refuse_going(folder)
    })?;
    RunControl::forget(folder);
    let addressed = experiment.bench.instruments.addressed();
    let in_process = addressed
        .iter()
        .any(|(_, instrument)| matches!(instrument.address, Address::Memory { .. }));
    let mode = experiment
        .bench
        .simulation
        .as_ref()
        .map_or(TimeMode::Real, |simulation| simulation.time);
    let usage = |text: &str| Err(Failure::Usage(format!("{}: {text}", folder.display())));
    let (summary, gated) = match (in_process, mode) {
        (false, _) => {
            let mut session = Session::at(&experiment.bench, context.time_s(folder))?;
            let mut finished = session.go_on(&experiment, folder, context)?;
            diagnose::finished(&experiment, folder, &mut finished)?;
            finished.summary_and_verdict()
        }
        (true, _) if context.inherited() => {
            return usage(
                "expected a run that began in a world of its own, found one on a simulated bench \
                that others had used before",
            );
        }
        (true, TimeMode::Virtual) => replay(&experiment, folder)?,
        (true, _) => {
            return usage(
                "the simulated cell died with its process, and only in virtual time can it be \
                played again",
            );
        }
    };
    say!("{}", summary.trim_end());
    gated
}

/// A run has no lock beside its journal where its bench is simulated in its own process.
fn refuse_going(folder: &Path) -> Result<(), Failure> {
    let text = || {
        format!(
            "{}: expected a run that was interrupted, found one that is going on: another process \
            writes its journal",
            folder.display()
        )
    };
    if journal::is_written(folder) {
        Err(Failure::Going(text()))
    } else {
        Ok(())
    }
}

/// Simulates a run in virtual time again and replaces the finished part of it.
fn replay(
    experiment: &Experiment,
    folder: &Path,
) -> Result<(String, Result<(), Failure>), Failure> {
    let _held = journal::hold(folder).map_err(RecordError::from)?;
    let mut scratch = folder.as_os_str().to_owned();
    scratch.push(".again");
    let scratch = PathBuf::from(scratch);
    // The remains of an earlier attempt can be deleted; files of another origin must not.
    if scratch.join(JOURNAL).exists() {
        fs::remove_dir_all(&scratch)?;
    } else if scratch.exists() {
        let text = format!(
            "{}: expected nothing, or what an earlier attempt to resume left, found something else",
            scratch.display()
        );
        return Err(Failure::Usage(text));
    }
    let finished = run_experiment(experiment, &scratch)?;
    let folders = Folders {
        old: folder,
        new: &scratch,
    };
    compare(folders, Path::new(""), begun_s(folder))?;
    replace(&scratch, folder)?;
    fs::remove_dir_all(&scratch)?;
    let (from, to) = (scratch.display().to_string(), folder.display().to_string());
    let (summary, gated) = finished.summary_and_verdict();
    Ok((summary.replace(&from, &to), gated))
}

/// Returns when the last step began, s. A run that ended on its own, for example on a full disk,
/// took another path after that.
fn begun_s(folder: &Path) -> f64 {
    let lines = journal::read(folder).map_or_else(|_| Vec::new(), |read| read.lines);
    let begun = lines
        .iter()
        .rev()
        .find(|line| matches!(line.entry, Entry::Intent { .. }));
    begun.map_or(0.0, |line| line.time_s.0)
}

/// Finished part of a run, and the run simulated again.
#[derive(Clone, Copy)]
struct Folders<'a> {
    old: &'a Path,
    new: &'a Path,
}

/// Everything in the old folder is in the new one, or the beginning of it.
fn compare(folders: Folders<'_>, below: &Path, begun_s: f64) -> Result<(), Failure> {
    for entry in fs::read_dir(folders.old.join(below))? {
        let entry = entry?;
        let name = below.join(entry.file_name());
        // Files without their final names are ignored.
        if entry.file_type()?.is_dir() {
            compare(folders, &name, begun_s)?;
        } else if !entry.file_name().to_string_lossy().starts_with('.') {
            same(folders, &name, begun_s)?;
        }
    }
    Ok(())
}

fn same(folders: Folders<'_>, name: &Path, begun_s: f64) -> Result<(), Failure> {
    let Folders { old, new } = folders;
    let extension = name.extension().map_or_else(String::new, |extension| {
        extension.to_string_lossy().into_owned()
    });
    if REWRITTEN.contains(&extension.as_str())
        || extension == "torn"
        // Readings are written as one table when a run ends, however it ends.
        || name == Path::new(READINGS_PARQUET)
    {
        return Ok(());
    }
    let (was, is) = (
        unflagged(fs::read(old.join(name))?),
        unflagged(fs::read(new.join(name)).unwrap_or_default()),
    );
    let growing = GROWING.contains(&extension.as_str());
    let whole = if growing {
        was.iter()
            .rposition(|byte| *byte == b'\n')
            .map_or(0, |at| at + 1)
    } else {
        was.len()
    };
    if if growing {
        is.starts_with(&was[..whole])
    } else {
        is == was
    } {
        return Ok(());
    }
    let at = was
        .iter()
        .zip(&is)
        .position(|(was, is)| was != is)
        .unwrap_or(was.len().min(is.len()));
    if growing && time_s(&was[..whole], at).is_some_and(|time_s| time_s >= begun_s) {
        return Ok(());
    }
    let text = format!(
        "expected the run played again from its seed to give the same, found a difference at byte \
        {at}: the program is not the one that began it; \
         {} holds what came out now",
        new.display()
    );
    Err(Failure::Usage(format!(
        "{}: {text}",
        old.join(name).display()
    )))
}

/// Returns a table without the flags of the quality gate: that column is written with the
/// complete sweep, after the points were appended one by one.
fn unflagged(table: Vec<u8>) -> Vec<u8> {
    let header = table
        .split(|byte| *byte == b'\n')
        .next()
        .unwrap_or_default();
    if !header.ends_with(FLAGS.as_bytes()) {
        return table;
    }
    let own = |line: &[u8]| {
        line.iter()
            .rposition(|byte| *byte == b',')
            .map_or_else(|| line.to_vec(), |at| line[..at].to_vec())
    };
    table
        .split(|byte| *byte == b'\n')
        .map(own)
        .collect::<Vec<_>>()
        .join(&b'\n')
}

/// The bench time that begins the line around a byte, or that an entry of the journal has, s.
fn time_s(text: &[u8], at: usize) -> Option<f64> {
    let start = text[..at.min(text.len())]
        .iter()
        .rposition(|byte| *byte == b'\n')
        .map_or(0, |end| end + 1);
    let line = String::from_utf8_lossy(&text[start..]);
    let line = line.lines().next()?;
    if let Ok(line) = serde_json::from_str::<Line>(line) {
        return Some(line.time_s.0);
    }
    let number: String = line
        .trim_start()
        .chars()
        .take_while(|c| c.is_ascii_digit() || *c == '.')
        .collect();
    number.parse().ok()
}

/// Moves every file of a folder into another one, over existing files, the journal last. An
/// interruption leaves files that are equal or beginnings, and a journal of an unfinished run, so
/// that the whole operation is repeated.
fn replace(from: &Path, to: &Path) -> Result<(), Failure> {
    fs::create_dir_all(to)?;
    let entries = fs::read_dir(from)?.collect::<Result<Vec<_>, _>>()?;
    let (journal, others): (Vec<_>, Vec<_>) = entries
        .into_iter()
        .partition(|entry| entry.file_name() == JOURNAL);
    for entry in others.iter().chain(&journal) {
        let goal = to.join(entry.file_name());
        if entry.file_type()?.is_dir() {
            replace(&entry.path(), &goal)?;
        } else {
            fs::rename(entry.path(), goal)?;
        }
    }
    for entry in fs::read_dir(to)? {
        let path = entry?.path();
        // A file that was being written when the process died, or a line.
        if path
            .extension()
            .is_some_and(|extension| extension == "partial" || extension == "torn")
        {
            fs::remove_file(path)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_was_flagged_meanwhile_is_what_it_was() {
        let plain = b"freq_hz,z\n1,2\n3,4\n".to_vec();
        assert_eq!(
            unflagged(b"freq_hz,z,flags\n1,2,\n3,4,noise: much; drift\n".to_vec()),
            plain
        );
        assert_eq!(unflagged(plain.clone()), plain);
    }

    #[test]
    fn the_time_of_a_line_is_found_whatever_the_file() {
        let text =
            b"time_s,event\n1.500,\"a\"\n     2.012 s ERROR x\n3.100000 load > MEAS:VOLT?\nodd\n";
        for (at, expected) in [
            (3, None),
            (13, Some(1.5)),
            (20, Some(1.5)),
            (40, Some(2.012)),
            (60, Some(3.1)),
            (75, None),
            (500, None),
        ] {
            assert_eq!(time_s(text, at), expected, "{at}");
        }
    }
}
