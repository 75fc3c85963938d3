//! Investigations that users have requested: alternating diagnoses and recommended experiments,
//! until it is clear what a model lacks or the budget is spent. Each investigation has a record
//! in a separate file; [`super::investigator`] continues them.

mod record;

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

use analysis::dataset::write_atomically;

use super::hub::Hub;
pub use record::{
    FollowUp, Investigation, InvestigationEnded, InvestigationRequest, InvestigationState,
    InvestigationStep,
};

/// Maximum number of investigations in the list.
const MOST_LISTED: usize = 200;

/// All investigations of a server.
#[derive(Debug)]
pub struct Investigations {
    folder: PathBuf,
    all: Mutex<Vec<Investigation>>,
    /// Investigations that an earlier server has left and that have not been checked yet.
    left: Mutex<BTreeSet<String>>,
    /// Lets one change be made after the other.
    turn: Mutex<()>,
}

impl Investigations {
    /// Opens the investigations of a data folder.
    pub fn open(data: &Path) -> Self {
        let folder = data.join("investigations");
        let entries = std::fs::read_dir(&folder).into_iter().flatten().flatten();
        let read = |entry: std::fs::DirEntry| -> Option<Investigation> {
            let path = entry.path();
            let text = std::fs::read_to_string(&path).ok()?;
            let read = serde_json::from_str(&text);
            read.inspect_err(|error| tracing::error!("{}: {error}", path.display()))
                .ok()
        };
        let json =
            |entry: &std::fs::DirEntry| entry.path().extension().is_some_and(|end| end == "json");
        let mut all: Vec<Investigation> = entries.filter(json).filter_map(read).collect();
        all.sort_by(|a, b| a.submitted_unix_s.total_cmp(&b.submitted_unix_s));
        let going = all.iter().filter(|one| one.ended.is_none());
        let left = going.map(|one| one.id.clone()).collect();
        Self {
            folder,
            all: Mutex::new(all),
            left: Mutex::new(left),
            turn: Mutex::default(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Investigation>> {
        self.all.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks out other changes of investigations until the guard is dropped.
    pub(super) fn turn(&self) -> MutexGuard<'_, ()> {
        self.turn.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The latest first.
    pub fn list(&self) -> Vec<Investigation> {
        self.lock()
            .iter()
            .rev()
            .take(MOST_LISTED)
            .cloned()
            .collect()
    }

    /// One by its name.
    pub fn find(&self, id: &str) -> Option<Investigation> {
        self.lock().iter().find(|one| one.id == id).cloned()
    }

    /// Returns the names of active investigations.
    pub(super) fn going(&self) -> Vec<String> {
        let all = self.lock();
        let going = all.iter().filter(|one| one.ended.is_none());
        going.map(|one| one.id.clone()).collect()
    }

    /// Returns the active investigation of a run.
    pub(super) fn going_about(&self, run: &str) -> Option<String> {
        let all = self.lock();
        let found = all
            .iter()
            .find(|one| one.ended.is_none() && one.run == run)?;
        Some(found.id.clone())
    }

    /// Returns whether an earlier server has left it; true only for the first query.
    pub(super) fn was_left(&self, id: &str) -> bool {
        let mut left = self.left.lock().unwrap_or_else(PoisonError::into_inner);
        left.remove(id)
    }

    /// The name of the next one.
    pub(super) fn next_id(&self) -> String {
        // By the files: a record that could not be read is not written over.
        let files = std::fs::read_dir(&self.folder)
            .into_iter()
            .flatten()
            .flatten();
        let latest = files
            .filter_map(|file| {
                let name = file.file_name().into_string().ok()?;
                name.strip_suffix(".json")?.rsplit('-').next()?.parse().ok()
            })
            .max();
        format!("investigation-{}", latest.unwrap_or(0_u64) + 1)
    }

    /// Writes the record of an investigation atomically.
    ///
    /// # Errors
    /// In words: a file that cannot be written.
    pub(super) fn keep(&self, one: &Investigation) -> Result<(), String> {
        std::fs::create_dir_all(&self.folder).map_err(|error| error.to_string())?;
        let text = serde_json::to_string_pretty(one).map_err(|error| error.to_string())?;
        let path = self.folder.join(format!("{}.json", one.id));
        write_atomically(&path, text.as_bytes()).map_err(|error| error.to_string())
    }

    /// Saves, shows and publishes an investigation in its present state.
    ///
    /// # Errors
    /// As [`Self::keep`]: then it is not shown.
    pub(super) fn put(&self, hub: &Hub, one: &Investigation) -> Result<(), String> {
        self.keep(one)?;
        self.show(hub, one);
        Ok(())
    }

    /// Shows and publishes an investigation in its present state.
    pub(super) fn show(&self, hub: &Hub, one: &Investigation) {
        let mut all = self.lock();
        match all.iter_mut().find(|known| known.id == one.id) {
            Some(known) => known.clone_from(one),
            None => all.push(one.clone()),
        }
        drop(all);
        hub.tell("investigation", one);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_evaluate::investigate::closed_loop::{Budget, End};

    #[test]
    fn what_was_asked_for_survives_the_server() {
        let folder = tempfile::tempdir().unwrap();
        let (hub, data) = (Hub::new(1), folder.path());
        let investigations = Investigations::open(data);
        let one = Investigation {
            id: investigations.next_id(),
            run: "demo-1".to_owned(),
            bench: "demo".to_owned(),
            budget: Budget {
                minutes: 60.0,
                charge_ah: 2.0,
            },
            spent: Budget::default(),
            by: "ann".to_owned(),
            submitted_unix_s: 1.0,
            state: InvestigationState::Diagnosing,
            steps: vec![InvestigationStep::of("demo-1")],
            ended: None,
        };
        investigations.put(&hub, &one).unwrap();
        // Half a file of a server that died is none.
        std::fs::write(data.join("investigations/x.json.part"), "{").unwrap();
        let again = Investigations::open(data);
        assert_eq!(again.list(), std::slice::from_ref(&one));
        assert_eq!(
            again.going_about("demo-1").as_deref(),
            Some("investigation-1")
        );
        assert_eq!(
            [0, 1].map(|_| again.was_left("investigation-1")),
            [true, false]
        );
        assert_eq!(again.next_id(), "investigation-2");
        let one = one.closed(End::Cancelled, "cancelled by ann");
        again.put(&hub, &one).unwrap();
        let last = Investigations::open(data);
        assert!(last.going().is_empty() && !last.was_left("investigation-1"));
        assert_eq!(last.find("investigation-1"), Some(one));
    }
}
