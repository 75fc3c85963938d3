//! Intents: what this daemon is about to begin or has begun for the fleet, written to disk before
//! the broker is informed. After a restart the daemon continues only with the intents it finds
//! here.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use serde::{Deserialize, Serialize};

use crate::{error::FleetError, local::Order};

/// A job that a bench of this daemon has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Intent {
    /// Its name.
    pub job: String,
    /// Its turn.
    pub turn: u32,
    /// The run.
    pub run: String,
    /// Name of the experiment.
    pub name: String,
    /// Seed that replaces the seed of the experiment.
    pub seed: Option<u64>,
    /// Name of the caller.
    pub by: String,
    /// Text of the experiment. Intents of versions before 0.2 have none.
    #[serde(default)]
    pub text: String,
    /// Whether the bench has received the request to begin it.
    pub begun: bool,
}

impl Intent {
    /// The run that the bench is to begin.
    pub fn order(&self) -> Order {
        Order {
            job: self.job.clone(),
            run: self.run.clone(),
            name: self.name.clone(),
            text: self.text.clone(),
            seed: self.seed,
            by: self.by.clone(),
        }
    }
}

/// The standing orders that a bench has followed.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Followed {
    /// Number of the last stop.
    pub stop: Option<String>,
    /// Number of the last hold.
    pub hold: Option<String>,
    /// Number of the last drain.
    pub drain: Option<String>,
    /// Number of the last release.
    pub release: Option<String>,
}

/// The folder of the intents of one bench. Only this process writes to it, so it is read only once.
#[derive(Debug, Clone)]
pub(crate) struct Desk {
    folder: PathBuf,
    /// The intents on disk, by job; `None` before they were read.
    read: Arc<Mutex<Option<BTreeMap<String, Intent>>>>,
}

const FOLLOWED: &str = "followed.json";

impl Desk {
    /// Opens the folder of a bench in the fleet's folder of the daemon.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub(crate) fn of(folder: &Path, bench: &str) -> Result<Self, FleetError> {
        let folder = folder.join(bench);
        fs::create_dir_all(folder.join("intents")).map_err(|error| failed(&folder, &error))?;
        Ok(Self {
            folder,
            read: Arc::default(),
        })
    }

    fn path(&self, job: &str) -> PathBuf {
        self.folder.join("intents").join(format!("{job}.json"))
    }

    /// Returns all intents.
    ///
    /// # Errors
    /// A folder or a file cannot be read; no run begins then.
    pub(crate) fn all(&self) -> Result<Vec<Intent>, FleetError> {
        let mut read = self.intents();
        let intents = match &*read {
            Some(intents) => intents,
            None => read.insert(self.read()?),
        };
        Ok(intents.values().cloned().collect())
    }

    fn intents(&self) -> MutexGuard<'_, Option<BTreeMap<String, Intent>>> {
        self.read.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn read(&self) -> Result<BTreeMap<String, Intent>, FleetError> {
        let folder = self.folder.join("intents");
        let entries = fs::read_dir(&folder).map_err(|error| failed(&folder, &error))?;
        let mut found = BTreeMap::new();
        for entry in entries {
            let path = entry.map_err(|error| failed(&folder, &error))?.path();
            if path.extension().is_some_and(|end| end == "json") {
                let intent: Intent = read(&path)?;
                found.insert(intent.job.clone(), intent);
            }
        }
        Ok(found)
    }

    /// Writes an intent, and syncs it to disk before returning.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn keep(&self, intent: &Intent) -> Result<(), FleetError> {
        let mut read = self.intents();
        write(&self.path(&intent.job), intent)?;
        if let Some(intents) = &mut *read {
            intents.insert(intent.job.clone(), intent.clone());
        }
        Ok(())
    }

    /// Removes a finished intent.
    pub(crate) fn drop(&self, job: &str) {
        let path = self.path(job);
        let mut read = self.intents();
        match (fs::remove_file(&path), &mut *read) {
            (Err(error), _) => tracing::error!("{}", failed(&path, &error)),
            (Ok(()), Some(intents)) => {
                intents.remove(job);
            }
            (Ok(()), None) => {}
        }
    }

    /// Reads the orders that were followed.
    ///
    /// # Errors
    /// The file cannot be read.
    pub(crate) fn followed(&self) -> Result<Followed, FleetError> {
        let path = self.folder.join(FOLLOWED);
        if path.exists() {
            read(&path)
        } else {
            Ok(Followed::default())
        }
    }

    /// Writes the orders that were followed.
    ///
    /// # Errors
    /// The file cannot be written.
    pub(crate) fn keep_followed(&self, followed: &Followed) -> Result<(), FleetError> {
        write(&self.folder.join(FOLLOWED), followed)
    }
}

fn failed(path: &Path, error: &dyn std::fmt::Display) -> FleetError {
    FleetError::File(format!("{}: {error}", path.display()))
}

pub(crate) fn read<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, FleetError> {
    let text = fs::read_to_string(path).map_err(|error| failed(path, &error))?;
    serde_json::from_str(&text).map_err(|error| failed(path, &error))
}

/// Writes a file atomically: to a temporary file, synced and renamed.
pub(crate) fn write(path: &Path, value: &impl Serialize) -> Result<(), FleetError> {
    let beside = path.with_extension("new");
    let text = serde_json::to_string_pretty(value).map_err(|error| failed(path, &error))?;
    let kept = || {
        let mut file = File::create(&beside)?;
        file.write_all(text.as_bytes())?;
        file.sync_all()?;
        fs::rename(&beside, path)?;
        File::open(path.parent().unwrap_or(path))?.sync_all()
    };
    kept().map_err(|error| failed(path, &error))
}
