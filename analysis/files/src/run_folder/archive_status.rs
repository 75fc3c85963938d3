//! State of the archive of a data folder. `eis-archive` writes it; the server shows it.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};

/// State of the archive of a data folder.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ArchiveStatus {
    /// The store.
    pub store: String,
    /// Name of this site in the store.
    pub site: String,
    /// Number of runs that the store has in their present state, every byte read back.
    pub archived: usize,
    /// Number of runs that are not in the store yet, or have changed since.
    pub pending: usize,
    /// Number of runs whose last push failed.
    pub failed: usize,
    /// Number of runs that differ from their list of hashes and are not sent.
    pub refused: usize,
    /// Number of runs that are in progress, or whose journal has no end.
    pub waiting: usize,
    /// Size of the archived runs.
    pub bytes: u64,
    /// Bytes that were sent for them. Files that the store had already were not sent.
    pub sent_bytes: u64,
    /// Size of the captures that are in the store only.
    pub moved_bytes: u64,
    /// Time of the latest verification, s since 1970.
    pub last_verified_unix_s: Option<f64>,
    /// Runs that failed or were refused, at most 20.
    pub troubles: Vec<ArchiveTrouble>,
    /// Runs are being sent.
    pub in_work: bool,
    /// Why the last push ended early; `None` if it completed.
    pub trouble: Option<String>,
    /// Time of the next attempt after a push that ended early, s since 1970.
    pub again_unix_s: Option<f64>,
    /// Time at which `eis-archive` wrote this, s since 1970. An old time means that it has stopped.
    pub written_unix_s: f64,
}

/// A run that is not archived.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ArchiveTrouble {
    /// The run.
    pub run: String,
    /// `failed` or `refused`.
    pub kind: String,
    /// The reason.
    pub why: String,
}

impl ArchiveStatus {
    /// Returns the path of the status in a data folder.
    pub fn path(data: &Path) -> PathBuf {
        data.join("archive.json")
    }

    /// Reads the status of a data folder; `None` if no archive has written one.
    ///
    /// # Errors
    /// In words: a file that cannot be read or is not a status.
    pub fn read(data: &Path) -> Result<Option<Self>, String> {
        let path = Self::path(data);
        let text = match fs::read(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(format!("{}: {error}", path.display())),
        };
        let status = serde_json::from_slice(&text);
        let status = status.map_err(|error| {
            format!(
                "{}: expected the status of an archive, found {error}",
                path.display()
            )
        })?;
        Ok(Some(status))
    }
}
