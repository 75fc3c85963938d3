//! `eis-archive push`: sends runs, each with retries.

use bench_archive::{
    ArchiveError,
    push::{Now, Outcome, Pusher},
    receipt::{Kept, RunState},
    snapshot::RunSource,
};
use instruments_link::clock::{Clock, TimeMode, unix_time_s};
use serde::Serialize;

use super::arguments::PushArgs;
use crate::{
    data_folder::read_operator,
    failure::Failure,
    open::Archive,
    print::{print_json, print_line, print_remark},
};

/// First and longest pause between two attempts, s. The pause doubles each time.
const PAUSES_S: [f64; 2] = [1.0, 30.0];

/// Result of a push.
#[derive(Debug, Default, Serialize)]
pub(super) struct PushReport {
    archived: usize,
    unchanged: usize,
    waiting: usize,
    refused: usize,
    pub(super) failed: usize,
    sent_bytes: u64,
    took_s: f64,
}

pub(super) async fn push_runs(args: &PushArgs) -> Result<(), Failure> {
    let archive = Archive::load(&args.config)?;
    let report = push_due(&archive, args, &Clock::start(TimeMode::Real), || Ok(())).await?;
    archive.update_status()?;
    if args.json {
        print_json(&report)?;
    } else {
        report.print();
    }
    report.check()
}

/// Sends the runs that are due. Calls `between` before each run.
///
/// # Errors
/// The store fails or refuses an operation. Failures of single runs are counted instead.
pub(super) async fn push_due(
    archive: &Archive,
    args: &PushArgs,
    clock: &Clock,
    mut between: impl FnMut() -> Result<(), Failure>,
) -> Result<PushReport, Failure> {
    let begin_s = clock.now_s();
    let mut pusher = Pusher::of(&archive.store, &archive.receipts, &archive.settings.site);
    let mut report = PushReport::default();
    for source in archive.sources(&args.runs)? {
        between()?;
        if !is_due(archive, args, &source)? {
            report.unchanged += 1;
            continue;
        }
        let outcome = push_with_retries(&mut pusher, archive, args, &source, clock).await;
        report.add(&source, outcome, args.json)?;
    }
    report.took_s = clock.now_s() - begin_s;
    Ok(report)
}

/// Returns whether a run is sent: named runs always are, others only if they have changed.
fn is_due(archive: &Archive, args: &PushArgs, source: &RunSource) -> Result<bool, Failure> {
    let receipt = archive.receipts.read(&source.name)?;
    let state = receipt.state(archive.store.name(), &source.stamp());
    Ok(match state {
        RunState::Pending | RunState::Failed => true,
        RunState::Archived => args.again,
        RunState::Waiting => args.unfinished || !args.runs.is_empty(),
        RunState::Refused => args.again || !args.runs.is_empty(),
    })
}

/// Pushes a run, and retries after a pause if that may succeed.
async fn push_with_retries(
    pusher: &mut Pusher<'_>,
    archive: &Archive,
    args: &PushArgs,
    source: &RunSource,
    clock: &Clock,
) -> Result<Outcome, ArchiveError> {
    let operator = read_operator(&archive.settings.data, &source.name);
    let now = || Now {
        unix_s: unix_time_s(),
        operator: operator.clone(),
        unfinished: args.unfinished,
        again: args.again,
    };
    let mut pause_s = PAUSES_S[0];
    let mut outcome = pusher.push(source, &now()).await;
    for _ in 1..args.tries {
        match &outcome {
            Err(error) if error.may_pass() => print_remark(format_args!("tried again: {error}")),
            _ => break,
        }
        clock.sleep_s(with_jitter(pause_s)).await;
        pause_s = (2.0 * pause_s).min(PAUSES_S[1]);
        outcome = pusher.push(source, &now()).await;
    }
    outcome
}

/// Returns 0.5 to 1.5 times a pause, s, so that clients of one store do not return at the same time.
pub(super) fn with_jitter(pause_s: f64) -> f64 {
    let mut byte = [128];
    // Without random numbers, use the unchanged pause.
    let _ = getrandom::fill(&mut byte);
    pause_s * (0.5 + f64::from(byte[0]) / 255.0)
}

impl PushReport {
    fn add(
        &mut self,
        source: &RunSource,
        outcome: Result<Outcome, ArchiveError>,
        is_quiet: bool,
    ) -> Result<(), Failure> {
        match outcome {
            Ok(Outcome::Unchanged(_)) => self.unchanged += 1,
            Ok(Outcome::Archived(kept)) => {
                self.archived += 1;
                self.sent_bytes += kept.sent_bytes;
                if !is_quiet {
                    print_archived(&source.name, &kept);
                }
            }
            Err(error @ ArchiveError::Waiting { .. }) => {
                self.waiting += 1;
                print_remark(format_args!("{error}"));
            }
            Err(error @ ArchiveError::Refused { .. }) => {
                self.refused += 1;
                print_remark(format_args!("{error}"));
            }
            Err(error) if error.is_of_store() => return Err(error.into()),
            Err(error) => {
                self.failed += 1;
                print_remark(format_args!("{}: {error}", source.name));
            }
        }
        Ok(())
    }

    fn print(&self) {
        print_line(format_args!(
            "{} runs archived, {} unchanged, {} wait for their end, {} refused, {} failed; {} bytes sent",
            self.archived, self.unchanged, self.waiting, self.refused, self.failed, self.sent_bytes
        ));
    }

    fn check(&self) -> Result<(), Failure> {
        match (self.failed, self.refused) {
            (0, 0) => Ok(()),
            (0, refused) => Err(Failure::Differs(format!(
                "{refused} runs differ from their list of hashes and were not archived"
            ))),
            (failed, _) => Err(Failure::Store(format!(
                "{failed} runs could not be archived"
            ))),
        }
    }
}

fn print_archived(run: &str, kept: &Kept) {
    print_line(format_args!(
        "{run}: {} files of {} bytes, {} sent, all read back; {}",
        kept.files, kept.bytes, kept.sent_bytes, kept.placed.run_sha256
    ));
    if let Some(before) = &kept.supersedes {
        print_line(format_args!("  replaces {before}"));
    }
}
