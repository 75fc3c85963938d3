//! The archive of the server's own runs. The server sends nothing itself: a process of this program,
//! `eis-bench archive push`, does so after the end of each run and analysis, and at the start for what is
//! not there yet. While the store cannot be reached it is begun again after longer and longer pauses.
//! Nothing waits for it: neither a request nor a run.

use std::{
    collections::BTreeSet,
    fs,
    path::Path,
    process::Stdio,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use analysis::{
    catalog::rows::diagnoses_below,
    run_folder::{JOURNAL, MANIFEST},
};
use bench_archive::{
    ArchiveError,
    receipt::{Receipt, Receipts, RunState, TroubleKind},
    snapshot::RunSource,
};
use instruments::clock;
use serde::Serialize;
use tokio::{process::Command, sync::Notify};
use utoipa::ToSchema;

use super::{Server, settings::Settings};

/// Folder of the analyses in the data folder.
const ANALYSES: &str = "analyses";
/// Pauses before a push is begun again, the first and the longest, s. Each is twice the one before.
const PAUSES_S: [f64; 2] = [2.0, 300.0];
/// Time between two looks for captures that are due to be moved, s.
const THIN_S: f64 = 6.0 * 3600.0;
/// Time between two looks at the receipts while runs are sent, s.
const LOOK_S: f64 = 30.0;
/// Exit code of a push that has done its work and found runs that do not go into the store as they are.
const REFUSED_CODE: i32 = 10;
/// Runs with trouble that are told.
const MOST_TROUBLES: usize = 20;

/// The archive as it is now.
#[derive(Debug, Clone, Default, Serialize, ToSchema)]
pub struct ArchiveNow {
    /// The store.
    pub store: String,
    /// Name of this site in it.
    pub site: String,
    /// Number of runs that are in the store as they are here, every byte read back.
    pub archived: usize,
    /// Number of runs that are not there yet, or not as they are here.
    pub pending: usize,
    /// Number of runs whose last push has failed.
    pub failed: usize,
    /// Number of runs that do not go there as they are.
    pub refused: usize,
    /// Number of runs that go on, or whose journal tells no end.
    pub waiting: usize,
    /// Size of the archived runs.
    pub bytes: u64,
    /// Bytes that were sent for them: what was there already was not.
    pub sent_bytes: u64,
    /// Size of the captures that are in the store only.
    pub moved_bytes: u64,
    /// When the latest run was verified, s since 1970.
    pub last_verified_unix_s: Option<f64>,
    /// Runs that failed or were refused, at most 20.
    pub troubles: Vec<TroubleNow>,
    /// Runs are being sent.
    pub in_work: bool,
    /// Why the last push has ended; none where it has done its work.
    pub trouble: Option<String>,
    /// When it is begun again, s since 1970; none where nothing is to be repeated.
    pub again_unix_s: Option<f64>,
}

/// A run with trouble.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct TroubleNow {
    /// The run.
    pub run: String,
    /// `failed`, `refused` or `waiting`.
    pub kind: String,
    /// Why.
    pub why: String,
}

/// Runs of a data folder, each with the folders of its diagnoses beside it; all of them where none is
/// named.
///
/// # Errors
/// A name without a run folder, a data folder that cannot be read.
pub fn sources(settings: &Settings, named: &[String]) -> Result<Vec<RunSource>, String> {
    let mut diagnoses = diagnoses_below(&settings.data.join(ANALYSES));
    let runs = settings.runs();
    let names = match named {
        [] => names(&runs)?,
        named => named.iter().cloned().collect(),
    };
    let source = |name: String| {
        let folder = runs.join(&name);
        if !is_name(&name) || !is_run(&folder) {
            return Err(format!(
                "expected the name of a run of {}, found {name:?}",
                runs.display()
            ));
        }
        Ok(RunSource {
            diagnoses: diagnoses.remove(&folder).unwrap_or_default(),
            name,
            folder,
        })
    };
    names.into_iter().map(source).collect()
}

fn names(runs: &Path) -> Result<BTreeSet<String>, String> {
    let entries = match fs::read_dir(runs) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(BTreeSet::new()),
        Err(error) => return Err(format!("{}: {error}", runs.display())),
    };
    let folders = entries.flatten().filter(|entry| is_run(&entry.path()));
    let names = folders.filter_map(|entry| entry.file_name().into_string().ok());
    Ok(names.filter(|name| is_name(name)).collect())
}

fn is_run(folder: &Path) -> bool {
    [MANIFEST, JOURNAL]
        .iter()
        .any(|file| folder.join(file).is_file())
}

/// A plain part of a path; hidden folders are nobody's runs.
fn is_name(name: &str) -> bool {
    !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\0'])
}

impl ArchiveNow {
    /// The state of the runs of a data folder, by their receipts; none without an archive.
    ///
    /// # Errors
    /// A receipt or a folder that cannot be read.
    pub fn of(settings: &Settings) -> Result<Option<Self>, String> {
        let Some(archive) = &settings.archive else {
            return Ok(None);
        };
        let failed = |error: ArchiveError| error.to_string();
        let receipts = Receipts::of(&settings.data).map_err(failed)?;
        let mut now = Self {
            store: archive.place.name(),
            site: archive.site.clone(),
            ..Self::default()
        };
        for source in sources(settings, &[])? {
            let receipt = receipts.read(&source.name).map_err(failed)?;
            add(&mut now, &receipt, &source.stamp());
        }
        Ok(Some(now))
    }
}

/// Counts a run.
fn add(now: &mut ArchiveNow, receipt: &Receipt, stamp: &str) {
    let state = receipt.state(&now.store, stamp);
    let count = match state {
        RunState::Archived => &mut now.archived,
        RunState::Pending => &mut now.pending,
        RunState::Failed => &mut now.failed,
        RunState::Refused => &mut now.refused,
        RunState::Waiting => &mut now.waiting,
    };
    *count += 1;
    if let Some(kept) = receipt.kept.as_ref().filter(|_| receipt.store == now.store) {
        now.bytes += kept.bytes;
        now.sent_bytes += kept.sent_bytes;
        now.moved_bytes += kept.moved_bytes;
        let last = now.last_verified_unix_s.unwrap_or(f64::MIN);
        now.last_verified_unix_s = Some(last.max(kept.verified_unix_s));
    }
    let told = matches!(state, RunState::Failed | RunState::Refused);
    let trouble = receipt.trouble.as_ref().filter(|_| told);
    if let Some(trouble) = trouble.filter(|_| now.troubles.len() < MOST_TROUBLES) {
        let kind = match trouble.kind {
            TroubleKind::Failed => "failed",
            TroubleKind::Refused => "refused",
            TroubleKind::Waiting => "waiting",
        };
        now.troubles.push(TroubleNow {
            run: receipt.run.clone(),
            kind: kind.to_owned(),
            why: trouble.why.clone(),
        });
    }
}

/// Runs that are to be sent.
#[derive(Debug, Default)]
struct Wanted {
    /// All that are not in the store yet.
    all: bool,
    /// These.
    runs: BTreeSet<String>,
}

impl Wanted {
    fn is_empty(&self) -> bool {
        !self.all && self.runs.is_empty()
    }

    /// Arguments of a push; all runs where none is named.
    fn arguments(self) -> Vec<String> {
        match self.all {
            true => Vec::new(),
            false => self.runs.into_iter().collect(),
        }
    }
}

/// Keeps the archive of a data folder up to date.
#[derive(Debug, Default)]
pub struct ArchiveKeeper {
    more: Notify,
    wanted: Mutex<Wanted>,
    now: Mutex<ArchiveNow>,
}

impl ArchiveKeeper {
    /// A run has ended: it is sent when that can be done.
    pub fn run_ended(&self, run: &str) {
        self.wanted().runs.insert(run.to_owned());
        self.more.notify_one();
    }

    /// An analysis has ended: the run that it is of is another one with its diagnosis.
    pub fn analysis_ended(&self) {
        self.wanted().all = true;
        self.more.notify_one();
    }

    /// The archive as it was at the last look.
    pub fn now(&self) -> MutexGuard<'_, ArchiveNow> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wanted(&self) -> MutexGuard<'_, Wanted> {
        self.wanted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at the receipts; what is told of the work stays.
    fn look(&self, settings: &Settings) {
        match ArchiveNow::of(settings) {
            Ok(Some(found)) => {
                let mut now = self.now();
                *now = ArchiveNow {
                    in_work: now.in_work,
                    trouble: now.trouble.take(),
                    again_unix_s: now.again_unix_s,
                    ..found
                };
            }
            Ok(None) => {}
            Err(error) => self.now().trouble = Some(error),
        }
    }
}

/// Sends what is not in the store yet, then whatever ends, for ever. Returns at once where no archive is
/// configured.
pub async fn work(server: Arc<Server>) {
    let Some(archive) = &server.settings.archive else {
        return;
    };
    let (keeper, clock) = (&server.archive, &server.clock);
    keeper.wanted().all = true;
    let (mut pause_s, mut thinned_s) = (PAUSES_S[0], None);
    loop {
        let wanted = std::mem::take(&mut *keeper.wanted());
        if !wanted.is_empty() {
            if let Err(trouble) = push(&server, wanted).await {
                let wait_s = pause_s * (0.5 + chance());
                keeper.wanted().all = true;
                tracing::warn!("the archive is not up to date, again in {wait_s:.0} s: {trouble}");
                keeper.now().trouble = Some(trouble);
                keeper.now().again_unix_s = Some(clock::unix_time_s() + wait_s);
                clock.sleep_s(wait_s).await;
                pause_s = (2.0 * pause_s).min(PAUSES_S[1]);
                continue;
            }
            pause_s = PAUSES_S[0];
        }
        let due = thinned_s.is_none_or(|thinned_s| clock.now_s() - thinned_s >= THIN_S);
        if archive.captures_after_s.is_some() && due {
            thinned_s = Some(clock.now_s());
            let thinned = process(&server, "thin", &[]).await;
            if let Err(trouble) = thinned {
                tracing::warn!("captures stay where they are: {trouble}");
            }
            keeper.look(&server.settings);
        }
        tokio::select! {
            () = keeper.more.notified() => {}
            () = clock.sleep_s(THIN_S) => {}
        }
    }
}

async fn push(server: &Server, wanted: Wanted) -> Result<(), String> {
    let keeper = &server.archive;
    keeper.now().in_work = true;
    keeper.look(&server.settings);
    let arguments = wanted.arguments();
    let mut pushing = std::pin::pin!(process(server, "push", &arguments));
    let pushed = loop {
        tokio::select! {
            pushed = &mut pushing => break pushed,
            () = server.clock.sleep_s(LOOK_S) => keeper.look(&server.settings),
        }
    };
    keeper.now().in_work = false;
    keeper.now().trouble = None;
    keeper.now().again_unix_s = None;
    keeper.look(&server.settings);
    pushed
}

/// Runs `eis-bench archive` on the file of the server, with low priority: the cores are the runs' first.
async fn process(server: &Server, act: &str, runs: &[String]) -> Result<(), String> {
    let failed = |error: std::io::Error| error.to_string();
    let output = Command::new("nice")
        .arg("-n10")
        .arg(&server.program)
        .args(["archive", act])
        .arg(&server.settings.file)
        .args(runs)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .process_group(0)
        .env("POLARS_MAX_THREADS", "1")
        .env_remove("NOTIFY_SOCKET")
        .env_remove("WATCHDOG_USEC")
        .output()
        .await
        .map_err(failed)?;
    let text = String::from_utf8_lossy(&output.stderr);
    let mut last = text.lines().rev();
    let last = last.find_map(|line| line.strip_prefix("eis-bench: "));
    match output.status.code() {
        // A run that was refused is told by its receipt, and is not sent again before it changes.
        Some(0 | REFUSED_CODE) => Ok(()),
        _ => Err(last.map_or_else(
            || format!("its process ended with {}", output.status),
            str::to_owned,
        )),
    }
}

/// A number from 0 to 1: servers that lost the same store do not come back together.
pub fn chance() -> f64 {
    let mut byte = [128];
    // Without randomness the pause is the middle one.
    let _ = getrandom::fill(&mut byte);
    f64::from(byte[0]) / 255.0
}
