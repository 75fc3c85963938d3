//! `eis-bench archive`: ended runs of a server into its store, and back.

mod args;
mod print;

use std::path::Path;

use bench_archive::{
    ArchiveError, Store,
    fetch::{fetch_moved, fetch_run},
    layout::is_sha256,
    push::{Now, Outcome, Pusher},
    receipt::{Receipts, RunState},
    snapshot::RunSource,
    thin::{ThinPolicy, thin},
    verify::Verifier,
};
use instruments::clock::{self, Clock, TimeMode};
use serde::Serialize;

use super::printed::say_json;
use crate::{
    safety::failure::Failure,
    serve::{
        archive::{ArchiveNow, sources},
        jobs,
        settings::{Archive, Settings},
    },
    support::{
        chance::chance,
        terminal::{remark, say},
    },
};
use args::{Act, FetchArgs, PushArgs, StatusArgs, ThinArgs, VerifyArgs};

pub use args::ArchiveArgs;

/// Pauses between two tries of a run, the first and the longest, s. Each is twice the one before.
const PAUSES_S: [f64; 2] = [1.0, 30.0];

/// Runs an action on the archive of a server.
///
/// # Errors
/// A file that is not as expected; a store that refuses or fails an operation; runs that are not
/// in the expected state.
pub fn archive(args: &ArchiveArgs) -> Result<(), Failure> {
    let runtime = Clock::runtime(TimeMode::Real)?;
    runtime.block_on(async {
        match &args.act {
            Act::Push(args) => push(args).await,
            Act::Status(args) => status(args),
            Act::Verify(args) => verify(args).await,
            Act::Fetch(args) => fetch(args).await,
            Act::Thin(args) => thin_all(args).await,
        }
    })
}

/// A server's archive that is open.
struct Open {
    settings: Settings,
    archive: Archive,
    store: Store,
    receipts: Receipts,
}

impl Open {
    fn of(config: &Path) -> Result<Self, Failure> {
        let settings = Settings::load(config)?;
        let archive = configured(&settings)?.clone();
        Ok(Self {
            store: Store::open(&archive.place).map_err(failed)?,
            receipts: Receipts::of(&settings.data).map_err(failed)?,
            settings,
            archive,
        })
    }

    fn sources(&self, named: &[String]) -> Result<Vec<RunSource>, Failure> {
        sources(&self.settings, named).map_err(Failure::Usage)
    }
}

fn configured(settings: &Settings) -> Result<&Archive, Failure> {
    settings.archive.as_ref().ok_or_else(|| {
        Failure::Usage(format!(
            "{}: expected a section [archive], found none",
            settings.file.display()
        ))
    })
}

#[expect(clippy::needless_pass_by_value, reason = "a function of `map_err`")]
fn failed(error: ArchiveError) -> Failure {
    match &error {
        ArchiveError::Setting { .. } | ArchiveError::Record(_) => Failure::Usage(error.to_string()),
        ArchiveError::Refused { .. } | ArchiveError::Waiting { .. } => {
            Failure::Differs(error.to_string())
        }
        _ => Failure::Store(error.to_string()),
    }
}

/// Result of a push.
#[derive(Debug, Default, Serialize)]
struct Pushed {
    archived: usize,
    unchanged: usize,
    waiting: usize,
    refused: usize,
    failed: usize,
    sent_bytes: u64,
    took_s: f64,
}

async fn push(args: &PushArgs) -> Result<(), Failure> {
    let open = Open::of(&args.config)?;
    let clock = Clock::start(TimeMode::Real);
    let mut pusher = Pusher::of(&open.store, &open.receipts, &open.archive.site);
    let mut pushed = Pushed::default();
    for source in open.sources(&args.runs)? {
        if !args.is_wanted(&open, &source)? {
            pushed.unchanged += 1;
            continue;
        }
        let outcome = tried(&mut pusher, &clock, &source, args, &open).await;
        pushed.add(&source, outcome, args)?;
    }
    pushed.took_s = clock.now_s();
    pushed.tell(args)
}

impl PushArgs {
    /// Returns whether a run is checked: named runs always are, others only if they have changed.
    fn is_wanted(&self, open: &Open, source: &RunSource) -> Result<bool, Failure> {
        let receipt = open.receipts.read(&source.name).map_err(failed)?;
        let state = receipt.state(open.store.name(), &source.stamp());
        Ok(match state {
            RunState::Pending | RunState::Failed => true,
            RunState::Archived => self.again,
            RunState::Waiting => self.unfinished || !self.runs.is_empty(),
            RunState::Refused => self.again || !self.runs.is_empty(),
        })
    }
}

/// Pushes a run, and retries after a pause if that may succeed.
async fn tried(
    pusher: &mut Pusher<'_>,
    clock: &Clock,
    source: &RunSource,
    args: &PushArgs,
    open: &Open,
) -> Result<Outcome, ArchiveError> {
    let job = jobs::read(&open.settings.data, &source.name);
    let now = || Now {
        unix_s: clock::unix_time_s(),
        operator: job.as_ref().map(|job| job.item.by.clone()),
        unfinished: args.unfinished,
        again: args.again,
    };
    let mut pause_s = PAUSES_S[0];
    let mut outcome = pusher.push(source, &now()).await;
    for _ in 1..args.tries {
        match &outcome {
            Err(error) if error.may_pass() => remark!("eis-bench: tried again: {error}"),
            _ => break,
        }
        clock.sleep_s(pause_s * (0.5 + chance())).await;
        pause_s = (2.0 * pause_s).min(PAUSES_S[1]);
        outcome = pusher.push(source, &now()).await;
    }
    outcome
}

impl Pushed {
    fn add(
        &mut self,
        source: &RunSource,
        outcome: Result<Outcome, ArchiveError>,
        args: &PushArgs,
    ) -> Result<(), Failure> {
        match outcome {
            Ok(Outcome::Unchanged(_)) => self.unchanged += 1,
            Ok(Outcome::Archived(kept)) => {
                self.archived += 1;
                self.sent_bytes += kept.sent_bytes;
                if !args.json {
                    print::archived(&source.name, &kept);
                }
            }
            Err(error @ ArchiveError::Waiting { .. }) => {
                self.waiting += 1;
                remark!("eis-bench: {error}");
            }
            Err(error @ ArchiveError::Refused { .. }) => {
                self.refused += 1;
                remark!("eis-bench: {error}");
            }
            Err(error) if error.is_of_store() => return Err(failed(error)),
            Err(error) => {
                self.failed += 1;
                remark!("eis-bench: {}: {error}", source.name);
            }
        }
        Ok(())
    }

    fn tell(&self, args: &PushArgs) -> Result<(), Failure> {
        if args.json {
            say_json(self)?;
        } else {
            say!(
                "{} runs archived, {} unchanged, {} wait for their end, {} refused, {} failed; \
                 {} bytes sent",
                self.archived,
                self.unchanged,
                self.waiting,
                self.refused,
                self.failed,
                self.sent_bytes
            );
        }
        match (self.failed, self.refused) {
            (0, 0) => Ok(()),
            (0, refused) => Err(Failure::Differs(format!(
                "{refused} runs do not go into the archive as they are"
            ))),
            (failed, _) => Err(Failure::Store(format!(
                "{failed} runs could not be archived"
            ))),
        }
    }
}

fn status(args: &StatusArgs) -> Result<(), Failure> {
    let settings = Settings::load(&args.config)?;
    configured(&settings)?;
    let now = ArchiveNow::of(&settings).map_err(Failure::Usage)?;
    let now = now.unwrap_or_default();
    if args.json {
        return say_json(&now);
    }
    print::status(&now);
    Ok(())
}

async fn verify(args: &VerifyArgs) -> Result<(), Failure> {
    let open = Open::of(&args.config)?;
    let mut verifier = Verifier::of(&open.store);
    let mut verified = print::Verified::default();
    let found = match args.all {
        true => {
            let mut found = Vec::new();
            for run in open.store.runs().await.map_err(failed)? {
                found.push(verifier.run(&run).await.map_err(failed)?);
            }
            found
        }
        false => of_receipts(&open, &mut verifier, args).await?,
    };
    for run in found {
        verified.runs += 1;
        verified.files += run.files;
        verified.bytes += run.bytes;
        verified.wrong.extend(run.wrong);
    }
    if args.json {
        say_json(&verified)?;
    } else {
        print::verified(&verified);
    }
    match verified.wrong.len() {
        0 => Ok(()),
        wrong => Err(Failure::Differs(format!(
            "{wrong} objects of the archive are not what they should be"
        ))),
    }
}

async fn of_receipts(
    open: &Open,
    verifier: &mut Verifier<'_>,
    args: &VerifyArgs,
) -> Result<Vec<bench_archive::verify::VerifiedRun>, Failure> {
    let mut found = Vec::new();
    for source in open.sources(&args.runs)? {
        let receipt = open.receipts.read(&source.name).map_err(failed)?;
        let is_here = receipt.store == open.store.name();
        match receipt.kept.filter(|_| is_here) {
            Some(kept) => found.push(verifier.kept(&kept).await.map_err(failed)?),
            None if args.runs.is_empty() => remark!("{}: not in the archive yet", source.name),
            None => {
                let why = format!("{}: expected a run in the archive, found none", source.name);
                return Err(Failure::Usage(why));
            }
        }
    }
    Ok(found)
}

async fn fetch(args: &FetchArgs) -> Result<(), Failure> {
    let open = Open::of(&args.config)?;
    let fetched = match &args.out {
        Some(out) => {
            let run = whole(&open, &args.run)?;
            fetch_run(&open.store, &run, out).await
        }
        None => {
            let sources = open.sources(std::slice::from_ref(&args.run))?;
            let source = sources.first().ok_or_else(|| unknown(&args.run))?;
            fetch_moved(&open.store, &open.receipts, source).await
        }
    };
    let fetched = fetched.map_err(failed)?;
    say!(
        "{}: {} files of {} bytes are back, each with its hash",
        args.run,
        fetched.files,
        fetched.bytes
    );
    Ok(())
}

fn unknown(run: &str) -> Failure {
    Failure::Usage(format!("expected a run, found {run:?}"))
}

/// A run of the store by its hash, or by the receipt of its name.
fn whole(open: &Open, run: &str) -> Result<String, Failure> {
    if is_sha256(run) {
        return Ok(run.to_owned());
    }
    let receipt = open.receipts.read(run).map_err(failed)?;
    let kept = receipt.kept.filter(|_| receipt.store == open.store.name());
    kept.map(|kept| kept.placed.run_sha256).ok_or_else(|| {
        Failure::Usage(format!(
            "expected an archived run or the SHA-256 of one, found {run:?}"
        ))
    })
}

async fn thin_all(args: &ThinArgs) -> Result<(), Failure> {
    let open = Open::of(&args.config)?;
    let after_s = args.captures_after_s.or(open.archive.captures_after_s);
    let Some(captures_after_s) = after_s else {
        return Err(Failure::Usage(
            "archive.thin.captures_after: expected a time, or --captures-after, found neither"
                .to_owned(),
        ));
    };
    let policy = ThinPolicy {
        captures_after_s,
        unix_s: clock::unix_time_s(),
        dry: args.dry_run,
    };
    let (mut files, mut bytes, mut runs) = (0, 0, 0);
    for source in open.sources(&args.runs)? {
        let thinned = thin(&open.store, &open.receipts, &source, &policy).await;
        let thinned = thinned.map_err(failed)?;
        runs += usize::from(thinned.files > 0);
        files += thinned.files;
        bytes += thinned.bytes;
    }
    let words = if args.dry_run {
        "would be moved"
    } else {
        "moved"
    };
    say!("{files} captures of {runs} runs {words} to the archive: {bytes} bytes");
    Ok(())
}
