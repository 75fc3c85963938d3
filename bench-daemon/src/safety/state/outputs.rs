//! What was read of the outputs of a bench, kept in the folders of its instruments, so that every
//! process and every bench file that shares an instrument knows it. A run removes the readings
//! before it may switch anything on: only a later one stands.
//!
//! Whoever only reads takes a lock of its own. Runs, and whoever switches off, end it: it changes
//! nothing, and instruments take one client.

use std::{
    fs::TryLockError,
    path::{Path, PathBuf},
};

use instruments::transport::Address;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use serde::{Deserialize, Serialize};

use super::{
    Lock, State, StateError,
    files::{json, open, read, remove},
    io,
    place::InstrumentPlace,
};
use crate::{
    bench::outputs::{DRIVES, KnownReading, OutputReading, OutputsState},
    support::{hash, locks, moment::Moment},
};

const OUTPUT: &str = "output.json";
const READER_LOCK: &str = "reader.lock";

/// A reading as it is on disk.
#[derive(Serialize, Deserialize)]
struct Kept {
    #[serde(flatten)]
    reading: OutputReading,
    at: Moment,
}

/// An output of a bench, and where its readings are kept.
#[derive(Debug, Clone)]
pub(super) struct OutputPlace {
    role: &'static str,
    name: String,
    folders: Vec<PathBuf>,
}

impl OutputPlace {
    /// The output of an instrument that can move charge, or the relays of a bath; none for any
    /// other. Instruments behind one GPIB adapter share a folder, and are told apart by the names
    /// of their files.
    pub(super) fn of(place: &InstrumentPlace) -> Option<Self> {
        if !DRIVES.contains(&place.role) && place.role != "chiller" {
            return None;
        }
        let name = match &place.address {
            Address::Gpib { .. } => {
                let key = hash::sha256(&place.address.to_string());
                format!("output_{}.json", key.get(..8).unwrap_or_default())
            }
            _ => OUTPUT.to_owned(),
        };
        Some(Self {
            role: place.role,
            name,
            folders: place.folders.clone(),
        })
    }

    #[cfg(test)]
    pub(super) fn at(role: &'static str, folder: PathBuf) -> Self {
        Self {
            role,
            name: OUTPUT.to_owned(),
            folders: vec![folder],
        }
    }

    /// The latest reading of it.
    fn latest(&self) -> Option<Kept> {
        self.folders
            .iter()
            .filter_map(|folder| read::<Kept>(&folder.join(&self.name)).ok().flatten()?.ok())
            .max_by(|one, other| one.reading.unix_s.total_cmp(&other.reading.unix_s))
    }
}

impl State {
    /// Keeps what was read of the outputs.
    ///
    /// # Errors
    /// A file that cannot be written; the others are written.
    pub fn keep_readings(&self, readings: &[OutputReading]) -> Result<(), StateError> {
        let now = Moment::now();
        let mut outcome = Ok(());
        for reading in readings {
            let Some(place) = self.outputs.iter().find(|place| place.role == reading.role) else {
                continue;
            };
            let kept = Kept {
                reading: reading.clone(),
                at: now.clone(),
            };
            for folder in &place.folders {
                outcome = outcome.and(json(&folder.join(&place.name), &kept));
            }
        }
        outcome
    }

    /// Forgets every reading, for an output may be switched on from here on.
    pub(super) fn forget_readings(&self) -> Result<(), StateError> {
        self.outputs.iter().try_for_each(|place| {
            let mut folders = place.folders.iter();
            folders.try_for_each(|folder| remove(folder, &place.name))
        })
    }

    /// State of the outputs, as far as it was read back.
    pub fn outputs(&self) -> OutputsState {
        let now = Moment::now();
        let known: Vec<KnownReading> = self
            .outputs
            .iter()
            .filter_map(|place| {
                let kept = place.latest()?;
                Some(KnownReading {
                    age_s: kept.at.age_s(&now),
                    reading: OutputReading {
                        role: place.role.to_owned(),
                        ..kept.reading
                    },
                })
            })
            .collect();
        let drives: Vec<&str> = self
            .outputs
            .iter()
            .map(|place| place.role)
            .filter(|role| *role != "chiller")
            .collect();
        let begun_unix_s = self.open_run().ok().flatten().map(|open| open.unix_s);
        OutputsState::of(
            &drives,
            &known,
            begun_unix_s.filter(|begun_s| *begun_s > 0.0),
            now.unix_s,
        )
    }

    /// Takes the place of whoever only reads the outputs; refused while a run, a guardian, somebody
    /// who switches off, or another reader has the bench.
    ///
    /// # Errors
    /// [`StateError::Busy`], [`StateError::InUse`]; a file that cannot be opened.
    pub fn lock_reader(&self) -> Result<Lock, StateError> {
        let mut files = Vec::new();
        for place in &self.places {
            let path = place.join(READER_LOCK);
            let file = open(&path)?;
            match file.try_lock() {
                Ok(()) => files.push(file),
                Err(TryLockError::WouldBlock) => {
                    return Err(self.in_use("another reading of its outputs, or a switching off"));
                }
                Err(TryLockError::Error(source)) => {
                    return Err(io(&path, "cannot be locked")(source));
                }
            }
        }
        self.refuse_busy()?;
        if self.lock_guardian()?.is_none() {
            return Err(self.in_use("the guardian of a run"));
        }
        Ok(Lock(files))
    }

    fn in_use(&self, by: &'static str) -> StateError {
        StateError::InUse {
            bench: self.bench.clone(),
            by,
        }
    }

    /// Ends whoever only reads the outputs, and keeps others from beginning to as long as the lock
    /// lives. It never fails: what cannot be locked must not hinder a run or a switching off.
    pub fn end_reader(&self) -> Lock {
        let mut files = Vec::new();
        for place in &self.places {
            let path = place.join(READER_LOCK);
            let Ok(file) = open(&path) else {
                continue;
            };
            // A process that is killed frees its locks.
            let is_free = !matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
                || (end_process_of(&path) && file.lock_shared().is_ok());
            files.extend(is_free.then_some(file));
        }
        Lock(files)
    }
}

/// Ends the process that holds a lock by reading: it has nothing to finish. Whether it was found.
fn end_process_of(path: &Path) -> bool {
    // Not 0 and not 1: those are whole groups.
    locks::holder(path)
        .filter(|reader| *reader > 1)
        .is_some_and(|reader| kill(Pid::from_raw(reader), Signal::SIGKILL).is_ok())
}
