//! Receipts of runs in a store: one small file for each run, in the data folder.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use analysis_files::dataset::write_atomically;
use serde::{Deserialize, Serialize};

use crate::{
    ArchiveError,
    layout::{FileEntry, Placed},
};

/// Folder of the receipts in the data folder.
pub const FOLDER: &str = "archive";
/// Folder in it of files that are being fetched.
const PARTIAL: &str = "partial";
/// Lock file in it, held by the process that works on the archive.
const LOCK: &str = "lock";

/// State of a run in the archive.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Receipt {
    /// Name of the run.
    pub run: String,
    /// The store that this receipt refers to.
    pub store: String,
    /// The verified run in the store; `None` before.
    pub kept: Option<Kept>,
    /// The run that is being sent: its rows may already be in the store.
    pub going: Option<Placed>,
    /// Rows of earlier states of the run that are still to be removed.
    pub stale: Vec<Placed>,
    /// Why the last push has failed; `None` if it succeeded.
    pub trouble: Option<Trouble>,
}

/// A run in the store; every byte was read back.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// Its location.
    #[serde(flatten)]
    pub placed: Placed,
    /// State of the run folder at that time ([`crate::snapshot::RunSource::stamp`]).
    pub stamp: String,
    /// Number of its files.
    pub files: usize,
    /// Size of its files.
    pub bytes: u64,
    /// Bytes that were sent, without the files that already existed.
    pub sent_bytes: u64,
    /// When it was verified, s since 1970.
    pub verified_unix_s: f64,
    /// Its previous identity, if it has changed.
    pub supersedes: Option<String>,
    /// Its rows.
    pub tables: Vec<FileEntry>,
    /// Whether it has ended; its captures may then be moved by policy.
    pub finished: bool,
    /// Number of its files that are only in the store.
    pub moved_files: usize,
    /// Their size.
    pub moved_bytes: u64,
}

/// A failed push.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trouble {
    /// Size and hash in words.
    pub why: String,
    /// Its time, s since 1970.
    pub unix_s: f64,
    /// Its kind.
    pub kind: TroubleKind,
    /// State of the run folder at that time; empty if a process worked in it.
    pub stamp: String,
}

/// Kind of a failed push.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TroubleKind {
    /// A retry may succeed.
    Failed,
    /// The folder does not match its list of hashes.
    Refused,
    /// The run is in progress, or its journal contains no end.
    Waiting,
}

/// State of a run in the archive.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RunState {
    /// In the store in its present state, verified.
    Archived,
    /// Not in the store yet, or not in its present state.
    Pending,
    /// The last push has failed.
    Failed,
    /// The store does not accept it in its present state.
    Refused,
    /// Its journal contains no end.
    Waiting,
}

impl Receipt {
    /// Returns the state of the run from the present state of its folder.
    pub fn state(&self, store: &str, stamp: &str) -> RunState {
        let here = self.store == store;
        let kept = self.kept.as_ref().filter(|_| here);
        let kept = kept.is_some_and(|kept| kept.stamp == stamp);
        if kept && self.stale.is_empty() && self.going.is_none() {
            return RunState::Archived;
        }
        let trouble = self.trouble.as_ref().filter(|_| here);
        match trouble.map(|trouble| (trouble.kind, trouble.stamp == stamp)) {
            Some((TroubleKind::Refused, true)) => RunState::Refused,
            Some((TroubleKind::Waiting, true)) => RunState::Waiting,
            Some((TroubleKind::Failed, _)) => RunState::Failed,
            _ => RunState::Pending,
        }
    }

    /// Marks the run as due to be sent to a store in its present state. Its earlier content in
    /// the store becomes stale after that. State of another store is discarded.
    pub(crate) fn begin(&mut self, store: &str, going: Placed) {
        if self.store != store {
            *self = Self {
                run: std::mem::take(&mut self.run),
                store: store.to_owned(),
                ..Self::default()
            };
        }
        let before = self.kept.as_ref().map(|kept| kept.placed.clone());
        self.stale.extend(before);
        self.stale.extend(self.going.take());
        self.stale.retain(|placed| *placed != going);
        self.stale.dedup();
        self.going = Some(going);
    }

    /// Returns the hash of the run before it changed.
    pub(crate) fn before(&self, run_sha256: &str) -> Option<String> {
        let kept = self.kept.as_ref().map(|kept| &kept.placed.run_sha256);
        kept.filter(|before| *before != run_sha256).cloned()
    }
}

/// The receipts of a data folder.
#[derive(Debug, Clone)]
pub struct Receipts {
    folder: PathBuf,
}

impl Receipts {
    /// Opens the receipts of a data folder, and creates the folder if it does not exist.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub fn of(data: &Path) -> Result<Self, ArchiveError> {
        let folder = data.join(FOLDER);
        let made = fs::create_dir_all(&folder);
        made.map_err(ArchiveError::io(&folder, "make the folder"))?;
        Ok(Self { folder })
    }

    fn path(&self, run: &str) -> PathBuf {
        self.folder.join(format!("{run}.json"))
    }

    /// Reads the receipt of a run, or returns an empty one if none exists.
    ///
    /// # Errors
    /// The file cannot be read or is not a receipt; it never counts as missing.
    pub fn read(&self, run: &str) -> Result<Receipt, ArchiveError> {
        let path = self.path(run);
        let text = match fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Ok(Receipt {
                    run: run.to_owned(),
                    ..Receipt::default()
                });
            }
            Err(error) => return Err(ArchiveError::io(path, "read the receipt")(error)),
        };
        serde_json::from_slice(&text).map_err(|error| {
            let path = path.display();
            ArchiveError::Record(format!("{path}: expected a receipt, found {error}"))
        })
    }

    /// Writes a receipt atomically.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, receipt: &Receipt) -> Result<(), ArchiveError> {
        let text = serde_json::to_vec_pretty(receipt).unwrap_or_default();
        Ok(write_atomically(&self.path(&receipt.run), &text)?)
    }

    /// Returns all receipts, by name of the run.
    ///
    /// # Errors
    /// A receipt cannot be read.
    pub fn all(&self) -> Result<Vec<Receipt>, ArchiveError> {
        let failed = || ArchiveError::io(&self.folder, "read the folder");
        let mut names = Vec::new();
        for entry in fs::read_dir(&self.folder).map_err(failed())? {
            let name = entry.map_err(failed())?.file_name();
            let name = name.to_string_lossy();
            names.extend(name.strip_suffix(".json").map(str::to_owned));
        }
        names.retain(|name| !name.starts_with('.'));
        names.sort_unstable();
        names.iter().map(|name| self.read(name)).collect()
    }

    /// Returns whether another run shares the location of its rows: two runs with equal content
    /// have the same identity.
    pub(crate) fn is_shared(&self, run: &str, placed: &Placed) -> Result<bool, ArchiveError> {
        let is_there = |receipt: &Receipt| {
            let kept = receipt.kept.as_ref().map(|kept| &kept.placed);
            receipt.run != run && (kept == Some(placed) || receipt.going.as_ref() == Some(placed))
        };
        Ok(self.all()?.iter().any(is_there))
    }

    /// Creates an empty folder for files that are being fetched.
    pub(crate) fn partial(&self) -> Result<PathBuf, ArchiveError> {
        let folder = self.folder.join(PARTIAL);
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).map_err(ArchiveError::io(&folder, "make the folder"))?;
        Ok(folder)
    }

    /// Waits for the exclusive lock on the archive of this data folder, and takes it.
    ///
    /// # Errors
    /// The file cannot be created.
    pub fn lock(&self) -> Result<File, ArchiveError> {
        let path = self.folder.join(LOCK);
        let made = File::options().create(true).append(true).open(&path);
        let lock = made.and_then(|file| file.lock().map(|()| file));
        lock.map_err(ArchiveError::io(path, "lock the archive"))
    }
}
