//! State of the archive of the server's own runs. [`super::archivist`] sends them. Neither a
//! request nor a run waits for it.

use std::{
    collections::BTreeSet,
    fs,
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
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
use serde::Serialize;
use tokio::sync::Notify;
use utoipa::ToSchema;

use super::settings::Settings;

/// Folder of the analyses in the data folder.
const ANALYSES: &str = "analyses";
/// Maximum number of runs with trouble in the list.
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

/// Returns the named runs of a data folder, or all runs if none is named, each with the folders
/// of its diagnoses.
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

/// Checks whether a name is a plain path component. Hidden folders are not runs.
fn is_name(name: &str) -> bool {
    !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\0'])
}

impl ArchiveNow {
    /// Returns the state of the runs of a data folder from their receipts, or `None` without an
    /// archive.
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

/// Runs that are due to be sent.
#[derive(Debug, Default)]
pub(super) struct Wanted {
    /// All that are not in the store yet.
    pub(super) all: bool,
    /// These.
    pub(super) runs: BTreeSet<String>,
}

impl Wanted {
    pub(super) fn is_empty(&self) -> bool {
        !self.all && self.runs.is_empty()
    }

    /// Arguments of a push; all runs where none is named.
    pub(super) fn arguments(self) -> Vec<String> {
        match self.all {
            true => Vec::new(),
            false => self.runs.into_iter().collect(),
        }
    }
}

/// Keeps the archive of a data folder up to date.
#[derive(Debug, Default)]
pub struct ArchiveKeeper {
    pub(super) more: Notify,
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

    /// Returns the state of the archive when it was last read.
    pub fn now(&self) -> MutexGuard<'_, ArchiveNow> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn wanted(&self) -> MutexGuard<'_, Wanted> {
        self.wanted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads the receipts again. The state of the push in progress is kept.
    pub(super) fn look(&self, settings: &Settings) {
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
