//! Where the readings of one output are kept, and in which format.

use std::path::PathBuf;

use instruments::transport::Address;
use serde::{Deserialize, Serialize};

use super::{
    StateError,
    files::{json, read, remove},
    place::InstrumentPlace,
};
use crate::bench::outputs::{DRIVES, KnownReading, OutputReading};
use bench_plan::support::{hash, moment::Moment};

const OUTPUT: &str = "output.json";

/// A reading as it is stored on disk.
#[derive(Serialize, Deserialize)]
struct Kept {
    #[serde(flatten)]
    reading: OutputReading,
    at: Moment,
}

/// An output of a bench, and where its readings are kept.
#[derive(Debug, Clone)]
pub(super) struct OutputPlace {
    pub(super) role: &'static str,
    name: String,
    folders: Vec<PathBuf>,
}

impl OutputPlace {
    /// Returns the output of an instrument that can move charge, or the relays of a bath, and
    /// `None` for any other instrument. Instruments behind one GPIB adapter share a folder and are
    /// distinguished by their file names.
    pub(super) fn of(place: &InstrumentPlace) -> Option<Self> {
        if !DRIVES.contains(&place.role) && place.role != "chiller" {
            return None;
        }
        let name = match &place.address {
            Address::Gpib { .. } => {
                let key = hash::sha256(place.address.to_string());
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

    /// Returns the latest reading of the output, with its age.
    pub(super) fn known(&self, now: &Moment) -> Option<KnownReading> {
        let kept = self
            .folders
            .iter()
            .filter_map(|folder| read::<Kept>(&folder.join(&self.name)).ok().flatten()?.ok())
            .max_by(|one, other| one.reading.unix_s.total_cmp(&other.reading.unix_s))?;
        Some(KnownReading {
            age_s: kept.at.age_s(now),
            reading: OutputReading {
                role: self.role.to_owned(),
                ..kept.reading
            },
        })
    }

    /// Stores a reading in every folder of the output.
    ///
    /// # Errors
    /// Fails if a file cannot be written; the remaining files are still written.
    pub(super) fn keep(&self, reading: &OutputReading, at: &Moment) -> Result<(), StateError> {
        let kept = Kept {
            reading: reading.clone(),
            at: at.clone(),
        };
        let folders = self.folders.iter();
        let written: Vec<_> = folders
            .map(|folder| json(&folder.join(&self.name), &kept))
            .collect();
        written.into_iter().collect()
    }

    /// Removes every reading.
    ///
    /// # Errors
    /// Fails if a file cannot be removed.
    pub(super) fn forget(&self) -> Result<(), StateError> {
        self.folders
            .iter()
            .try_for_each(|folder| remove(folder, &self.name))
    }
}
