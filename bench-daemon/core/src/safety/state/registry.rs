//! Benches that run or ran on this machine, by their files, so that all of them can be switched
//! off without knowing any of them.
//!
//! A bench of mocks is registered only from the beginning of a run until its outputs are read back
//! as off: afterwards its ports may belong to other programs.

use std::{
    fs,
    path::{Path, PathBuf},
};

use instruments::clock;
use serde::{Deserialize, Serialize};

use super::{
    State, StateError,
    files::{json, make, read, remove},
    io,
    place::root,
};
use bench_plan::support::hash;

const FOLDER: &str = "benches";

/// A bench that runs or ran on this machine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KnownBench {
    /// Its name when the last run began.
    pub bench: String,
    /// Its file.
    pub file: PathBuf,
    /// Whether its instruments were mocks.
    pub mocked: bool,
    /// When the last run began, s since 1970.
    pub unix_s: f64,
}

impl KnownBench {
    /// Returns the path of the file that records this bench.
    ///
    /// # Errors
    /// [`StateError::Nowhere`].
    pub fn record(&self) -> Result<PathBuf, StateError> {
        Ok(root()?.join(FOLDER).join(name(&self.file)))
    }

    /// Removes the bench from the registry.
    ///
    /// # Errors
    /// Fails if a file cannot be removed.
    pub fn forget(&self) -> Result<(), StateError> {
        remove(&root()?.join(FOLDER), &name(&self.file))
    }
}

impl State {
    pub(super) fn register(&self) -> Result<(), StateError> {
        let known = KnownBench {
            bench: self.bench.clone(),
            file: self.file.clone(),
            mocked: self.mocked,
            unix_s: clock::unix_time_s(),
        };
        make(&root()?.join(FOLDER))?;
        json(&known.record()?, &known)
    }

    pub(super) fn unregister(&self) {
        if let Err(error) = root().and_then(|root| remove(&root.join(FOLDER), &name(&self.file))) {
            tracing::warn!("{error}");
        }
    }
}

/// Returns the benches that run or ran on this machine, by their files.
///
/// # Errors
/// Fails if a folder or a file cannot be read or parsed: then the list of benches is incomplete.
pub fn known_benches() -> Result<Vec<KnownBench>, StateError> {
    let folder = root()?.join(FOLDER);
    let entries = match fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(io(&folder, "cannot be read")(source)),
    };
    let mut known = Vec::new();
    for entry in entries {
        let path = entry.map_err(io(&folder, "cannot be read"))?.path();
        // Other extensions belong to files that were being written.
        if path.extension().is_none_or(|extension| extension != "json") {
            continue;
        }
        if let Some(found) = read::<KnownBench>(&path)? {
            known.push(found.map_err(|error| io(&path, "cannot be understood")(error.into()))?);
        }
    }
    known.sort_by(|one, other| one.file.cmp(&other.file));
    Ok(known)
}

fn name(file: &Path) -> String {
    let key = hash::sha256(file.to_string_lossy().as_ref());
    format!("{}.json", key.get(..16).unwrap_or_default())
}
