//! Queue of runs: which runs, in which order, on which bench. Each change is written to disk
//! atomically before it takes effect, so that a restarted server knows its requests and what was
//! in progress.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use analysis::dataset::write_atomically;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

const FILE: &str = "queue.json";
/// Maximum number of waiting entries.
const MOST: usize = 1000;

/// Action of a queued run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Run from the beginning.
    Run,
    /// Continue after an interruption.
    Resume,
}

/// An entry of the queue.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Item {
    /// Its number; never reused.
    pub id: u64,
    /// Name of the run and of its folder.
    pub run: String,
    /// Whether to run or to resume.
    pub kind: Kind,
    /// Name of the experiment.
    pub experiment: String,
    /// Name of the bench.
    pub bench: String,
    /// A seed instead of that of the experiment.
    pub seed: Option<u64>,
    /// Expected duration of the whole plan, bench s.
    pub expected_s: f64,
    /// Name of the person who submitted it.
    pub by: String,
    /// Time of submission, s since 1970.
    pub submitted_unix_s: f64,
    /// Its process, after the start.
    pub process: Option<Process>,
    /// Trace of the run (W3C `traceparent`), if its request was traced.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub traceparent: Option<String>,
}

/// A running process.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Process {
    /// Its number.
    pub pid: i32,
    /// When it was started, s since 1970.
    pub started_unix_s: f64,
}

/// Request for a run.
#[derive(Debug, Clone)]
pub struct Wanted {
    /// Whether to run or to resume.
    pub kind: Kind,
    /// Name of the experiment.
    pub experiment: String,
    /// Name of the bench.
    pub bench: String,
    /// Another seed.
    pub seed: Option<u64>,
    /// Expected duration, bench s.
    pub expected_s: f64,
    /// Name of the caller.
    pub by: String,
    /// When, s since 1970.
    pub unix_s: f64,
    /// Trace that it belongs to.
    pub traceparent: Option<String>,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
struct Kept {
    latest: u64,
    /// Benches on which no run may begin, and why.
    held: BTreeMap<String, String>,
    /// Benches that the fleet holds, and why.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    held_by_fleet: BTreeMap<String, String>,
    items: Vec<Item>,
}

impl Kept {
    fn holds(&mut self, by: HeldBy) -> &mut BTreeMap<String, String> {
        match by {
            HeldBy::Here => &mut self.held,
            HeldBy::Fleet => &mut self.held_by_fleet,
        }
    }
}

/// Side that holds a bench. The fleet takes back its own holds only.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum HeldBy {
    /// This server: a person, a stop, or a failed run.
    #[default]
    Here,
    /// The fleet.
    Fleet,
}

/// Why the queue is not changed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum QueueError {
    /// The file system.
    #[error("{path}: the queue {what}: {reason}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Operation that was tried.
        what: &'static str,
        /// Error of the operating system.
        reason: String,
    },
    /// Too many.
    #[error("expected at most {MOST} places in the queue, found as many")]
    Full,
    /// An unknown queue number.
    #[error("expected the number of a place in the queue, found {0}")]
    Unknown(u64),
    /// It is being done.
    #[error("expected a place that waits, found {0}, which is in work: stop it instead")]
    InWork(u64),
    /// A number that was given twice.
    #[error("expected each number once, found {0} twice")]
    Twice(u64),
}

/// The queue of a data folder.
#[derive(Debug)]
pub struct Queue {
    path: PathBuf,
    kept: Kept,
}

impl Queue {
    /// Opens the queue of a data folder, or an empty one.
    ///
    /// # Errors
    /// A file that cannot be read or parsed.
    pub fn open(data: &Path) -> Result<Self, QueueError> {
        let path = data.join(FILE);
        let fail = |what, reason: String| QueueError::Io {
            path: path.clone(),
            what,
            reason,
        };
        let kept = match std::fs::read_to_string(&path) {
            Ok(text) => serde_json::from_str(&text)
                .map_err(|error| fail("cannot be understood", error.to_string()))?,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Kept::default(),
            Err(error) => return Err(fail("cannot be read", error.to_string())),
        };
        Ok(Self { path, kept })
    }

    /// All places, in their order.
    pub fn items(&self) -> &[Item] {
        &self.kept.items
    }

    /// Returns why a bench is held; this server's reason takes precedence.
    pub fn held(&self, bench: &str) -> Option<&str> {
        let here = self.held_by(HeldBy::Here, bench);
        here.or_else(|| self.held_by(HeldBy::Fleet, bench))
    }

    /// Returns the side whose reason for a hold is shown.
    pub fn holder(&self, bench: &str) -> HeldBy {
        match self.kept.held.contains_key(bench) {
            false if self.kept.held_by_fleet.contains_key(bench) => HeldBy::Fleet,
            _ => HeldBy::Here,
        }
    }

    /// Why one side holds a bench.
    pub fn held_by(&self, by: HeldBy, bench: &str) -> Option<&str> {
        let holds = match by {
            HeldBy::Here => &self.kept.held,
            HeldBy::Fleet => &self.kept.held_by_fleet,
        };
        holds.get(bench).map(String::as_str)
    }

    /// Run in work on a bench.
    pub fn in_work(&self, bench: &str) -> Option<&Item> {
        self.kept
            .items
            .iter()
            .find(|item| item.bench == bench && item.process.is_some())
    }

    /// Next run on a bench; `None` while a run is in work there, or the bench is held.
    pub fn next(&self, bench: &str) -> Option<&Item> {
        if self.held(bench).is_some() || self.in_work(bench).is_some() {
            return None;
        }
        self.kept.items.iter().find(|item| item.bench == bench)
    }

    /// The number of the place that is submitted next.
    pub fn next_id(&self) -> u64 {
        self.kept.latest + 1
    }

    /// Appends an entry. `run` makes the name of the run from the number.
    ///
    /// # Errors
    /// A queue that is full or cannot be written: then nothing was changed.
    pub fn submit(
        &mut self,
        wanted: &Wanted,
        run: impl FnOnce(u64) -> String,
    ) -> Result<Item, QueueError> {
        if self.kept.items.len() >= MOST {
            return Err(QueueError::Full);
        }
        let id = self.next_id();
        let wanted = wanted.clone();
        let item = Item {
            id,
            run: run(id),
            kind: wanted.kind,
            experiment: wanted.experiment,
            bench: wanted.bench,
            seed: wanted.seed,
            expected_s: wanted.expected_s,
            by: wanted.by,
            submitted_unix_s: wanted.unix_s,
            process: None,
            traceparent: wanted.traceparent,
        };
        self.change(|kept| {
            kept.latest = id;
            kept.items.push(item.clone());
        })?;
        Ok(item)
    }

    /// Removes a waiting entry.
    ///
    /// # Errors
    /// An unknown number, or that of an active entry.
    pub fn cancel(&mut self, id: u64) -> Result<Item, QueueError> {
        let item = self.item(id)?.clone();
        if item.process.is_some() {
            return Err(QueueError::InWork(id));
        }
        self.change(|kept| kept.items.retain(|item| item.id != id))?;
        Ok(item)
    }

    /// Moves these entries to the front, in this order; the others follow in their present order.
    ///
    /// # Errors
    /// As [`Queue::cancel`]; a number that is named twice.
    pub fn reorder(&mut self, ids: &[u64]) -> Result<(), QueueError> {
        for (place, id) in ids.iter().enumerate() {
            if self.item(*id)?.process.is_some() {
                return Err(QueueError::InWork(*id));
            }
            if ids[..place].contains(id) {
                return Err(QueueError::Twice(*id));
            }
        }
        let place = |item: &Item| match (
            item.process.is_some(),
            ids.iter().position(|id| *id == item.id),
        ) {
            (true, _) => 0,
            (false, Some(place)) => place + 1,
            (false, None) => usize::MAX,
        };
        self.change(|kept| kept.items.sort_by_key(place))
    }

    /// Holds a bench: no run begins on it from now on. The first reason of a side stays.
    ///
    /// # Errors
    /// A queue that cannot be written; the bench is nevertheless held as long as this process
    /// lives.
    pub fn hold(&mut self, by: HeldBy, bench: &str, why: &str) -> Result<(), QueueError> {
        self.kept
            .holds(by)
            .entry(bench.to_owned())
            .or_insert_with(|| why.to_owned());
        self.change(|_| {})
    }

    /// Releases the hold of one side: waiting runs may begin if the other side does not hold the
    /// bench.
    ///
    /// # Errors
    /// A queue that cannot be written.
    pub fn release(&mut self, by: HeldBy, bench: &str) -> Result<(), QueueError> {
        self.change(|kept| drop(kept.holds(by).remove(bench)))
    }

    /// A place is in work.
    ///
    /// # Errors
    /// A queue that cannot be written.
    pub fn begun(&mut self, id: u64, process: Process) -> Result<(), QueueError> {
        // What runs, runs, whether it can be written down or not.
        if let Some(item) = self.kept.items.iter_mut().find(|item| item.id == id) {
            item.process = Some(process);
        }
        self.change(|_| {})
    }

    /// A place is done with.
    ///
    /// # Errors
    /// A queue that cannot be written.
    pub fn done(&mut self, id: u64) -> Result<(), QueueError> {
        self.kept.items.retain(|item| item.id != id);
        self.change(|_| {})
    }

    fn item(&self, id: u64) -> Result<&Item, QueueError> {
        self.kept
            .items
            .iter()
            .find(|item| item.id == id)
            .ok_or(QueueError::Unknown(id))
    }

    fn change(&mut self, change: impl FnOnce(&mut Kept)) -> Result<(), QueueError> {
        let mut kept = self.kept.clone();
        change(&mut kept);
        let fail = |what, reason: String| QueueError::Io {
            path: self.path.clone(),
            what,
            reason,
        };
        let text = serde_json::to_string_pretty(&kept)
            .map_err(|error| fail("cannot be put into JSON", error.to_string()))?;
        write_atomically(&self.path, text.as_bytes())
            .map_err(|error| fail("cannot be written", error.to_string()))?;
        self.kept = kept;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted(bench: &str) -> Wanted {
        let (kind, experiment, by) = (Kind::Run, "demo".to_owned(), "ann".to_owned());
        Wanted {
            kind,
            experiment,
            bench: bench.to_owned(),
            seed: None,
            expected_s: 60.0,
            by,
            unix_s: 1.0,
            traceparent: None,
        }
    }

    fn submit(queue: &mut Queue, bench: &str) -> u64 {
        queue
            .submit(&wanted(bench), |id| format!("demo-{id}"))
            .unwrap()
            .id
    }

    fn ids(queue: &Queue) -> Vec<u64> {
        queue.items().iter().map(|item| item.id).collect()
    }

    #[test]
    fn what_was_asked_for_survives_the_server() {
        let folder = tempfile::tempdir().unwrap();
        let mut queue = Queue::open(folder.path()).unwrap();
        for bench in ["a", "b", "a", "a"] {
            submit(&mut queue, bench);
        }
        queue.reorder(&[4, 3]).unwrap();
        queue.hold(HeldBy::Here, "b", "to look at it").unwrap();
        queue
            .begun(
                4,
                Process {
                    pid: 7,
                    started_unix_s: 2.0,
                },
            )
            .unwrap();
        let mut again = Queue::open(folder.path()).unwrap();
        assert_eq!(again.kept, queue.kept);
        assert_eq!(
            (ids(&again), again.held("b")),
            (vec![4, 3, 1, 2], Some("to look at it"))
        );
        assert_eq!(
            (
                again.next("a"),
                again.next("b"),
                again.in_work("a").unwrap().id
            ),
            (None, None, 4)
        );
        again.done(4).unwrap();
        again.release(HeldBy::Here, "b").unwrap();
        assert_eq!(
            (again.next("a").unwrap().id, again.next("b").unwrap().id),
            (3, 2)
        );
        again.cancel(3).unwrap();
        // A number is never used again.
        assert_eq!((submit(&mut again, "a"), ids(&again)), (5, vec![1, 2, 5]));
    }

    #[test]
    fn the_fleet_takes_back_its_own_holds_only_whichever_came_first() {
        for sides in [[HeldBy::Fleet, HeldBy::Here], [HeldBy::Here, HeldBy::Fleet]] {
            let folder = tempfile::tempdir().unwrap();
            let mut queue = Queue::open(folder.path()).unwrap();
            for side in sides {
                queue.hold(side, "a", &format!("{side:?}")).unwrap();
            }
            let mut again = Queue::open(folder.path()).unwrap();
            again.release(HeldBy::Fleet, "a").unwrap();
            assert_eq!(again.held("a"), Some("Here"));
            queue.release(HeldBy::Here, "a").unwrap();
            assert_eq!(queue.held("a"), Some("Fleet"));
            queue.release(HeldBy::Fleet, "a").unwrap();
            assert_eq!(queue.held("a"), None);
        }
    }

    #[test]
    fn what_cannot_be_is_reported_and_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut queue = Queue::open(folder.path()).unwrap();
        for _ in 0..2 {
            submit(&mut queue, "a");
        }
        queue
            .begun(
                1,
                Process {
                    pid: 7,
                    started_unix_s: 2.0,
                },
            )
            .unwrap();
        let before = queue.kept.clone();
        let message = |result: Result<(), QueueError>| result.unwrap_err().to_string();
        assert_eq!(
            message(queue.reorder(&[2, 2])),
            "expected each number once, found 2 twice"
        );
        assert_eq!(
            message(queue.reorder(&[9])),
            "expected the number of a place in the queue, found 9"
        );
        assert_eq!(
            message(queue.cancel(1).map(drop)),
            "expected a place that waits, found 1, which is in work: stop it instead"
        );
        assert_eq!(queue.kept, before);
        std::fs::write(folder.path().join(FILE), "{").unwrap();
        assert!(
            Queue::open(folder.path())
                .unwrap_err()
                .to_string()
                .contains("queue.json: the queue cannot be understood: ")
        );
    }
}
