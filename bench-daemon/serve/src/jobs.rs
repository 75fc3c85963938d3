//! Record of each run that this server began: one small file each, beside the run folders. It is
//! written when the run begins and when it has ended.

use std::{
    cmp::Ordering,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use analysis::{dataset::write_atomically, run_folder};
use instruments::clock;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::queue::{Item, Queue};

/// Exit code of a run that was ended on request.
const STOPPED: i32 = 130;

/// A run that this server started.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Job {
    /// Request for the run.
    pub item: Item,
    /// Its end; null while it is in progress.
    pub ended: Option<Ended>,
}

/// The end of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Ended {
    /// Exit code of its process; null if it was killed, or ended while no server was running.
    pub code: Option<i32>,
    /// True if nothing of it is left to do.
    pub finished: bool,
    /// True if a person stopped it.
    #[serde(default)]
    pub stopped: bool,
    /// Who stopped it, if it was stopped with its bench.
    #[serde(default)]
    pub stopped_by: Option<String>,
    /// Description of the end.
    pub how: String,
    /// Time at which the end was noticed, s since 1970.
    pub unix_s: f64,
}

impl Ended {
    /// Creates an end at the present time of a run that has no exit code and did not finish.
    pub fn now(how: String) -> Self {
        Self {
            code: None,
            finished: false,
            stopped: false,
            stopped_by: None,
            how,
            unix_s: clock::unix_time_s(),
        }
    }

    /// Determines whether a person stopped the run: by a stop of its bench, or by another request.
    /// A trip or outputs that were not verified off during a stop are a failure.
    #[must_use]
    pub fn stopped(self, stopper: Option<String>) -> Self {
        // Without a code, as after a restart of the server, the journal says how the run ended.
        let is_no_failure = match self.code {
            Some(code) => code == STOPPED,
            None => {
                !self.how.starts_with(run_folder::ENDED_EARLY)
                    && !self.how.contains("LOOK AT THE BENCH")
            }
        };
        let is_by_stop = stopper.is_some() && is_no_failure;
        let stopped = !self.finished && (is_by_stop || run_folder::is_stopped(&self.how));
        Self {
            stopped,
            stopped_by: stopper.filter(|_| stopped),
            ..self
        }
    }
}

fn path(data: &Path, run: &str) -> PathBuf {
    data.join("jobs").join(format!("{run}.json"))
}

/// The runs that were begun here. Which they are, in which order, and whether they have ended is in
/// memory; the rest is read from their records when it is asked for.
#[derive(Debug)]
pub struct Jobs {
    data: PathBuf,
    /// The latest first.
    begun: Mutex<Vec<Begun>>,
}

/// A run that was begun here.
#[derive(Debug, Clone)]
pub struct Begun {
    /// Its name.
    pub run: Arc<str>,
    /// When it ended, s since 1970.
    pub ended_unix_s: Option<f64>,
    submitted_unix_s: f64,
    id: u64,
}

impl Begun {
    fn of(job: &Job) -> Self {
        Self {
            run: job.item.run.as_str().into(),
            ended_unix_s: job.ended.as_ref().map(|ended| ended.unix_s),
            submitted_unix_s: job.item.submitted_unix_s,
            id: job.item.id,
        }
    }

    /// The latest first.
    fn order(&self, other: &Self) -> Ordering {
        let by_time = other.submitted_unix_s.total_cmp(&self.submitted_unix_s);
        by_time.then(other.id.cmp(&self.id))
    }
}

impl Jobs {
    /// Opens the records of a data folder. Each record is read once.
    pub fn of(data: &Path) -> Self {
        let mut begun: Vec<Begun> = every(data).map(|job| Begun::of(&job)).collect();
        begun.sort_by(Begun::order);
        Self {
            data: data.to_path_buf(),
            begun: Mutex::new(begun),
        }
    }

    /// Returns all records, the latest first.
    pub fn begun(&self) -> Vec<Begun> {
        self.lock().clone()
    }

    /// Their records, the latest first, each read when it is come to.
    pub fn latest(&self) -> impl Iterator<Item = Job> {
        let data = self.data.clone();
        self.begun()
            .into_iter()
            .filter_map(move |begun| read(&data, &begun.run))
    }

    /// Writes the record of a run atomically.
    ///
    /// # Errors
    /// In words: a file that cannot be written.
    pub fn write(&self, job: &Job) -> Result<(), String> {
        let text = serde_json::to_string_pretty(job).map_err(|error| error.to_string())?;
        write_atomically(&path(&self.data, &job.item.run), text.as_bytes())
            .map_err(|error| error.to_string())?;
        let new = Begun::of(job);
        let mut begun = self.lock();
        begun.retain(|one| one.run != new.run);
        let place = begun.partition_point(|one| one.order(&new) == Ordering::Less);
        begun.insert(place, new);
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Begun>> {
        self.begun.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Reads the record of a run; `run` must be a plain name.
pub fn read(data: &Path, run: &str) -> Option<Job> {
    serde_json::from_str(&std::fs::read_to_string(path(data, run)).ok()?).ok()
}

/// Returns the request for a run that was submitted before, whether the run waits, is in work or
/// has ended.
pub fn submitted(data: &Path, queue: &Queue, run: &str) -> Option<Item> {
    let waits = queue.items().iter().find(|item| item.run == run).cloned();
    waits.or_else(|| read(data, run).map(|job| job.item))
}

/// Every record, in no order.
fn every(data: &Path) -> impl Iterator<Item = Job> {
    let entries = std::fs::read_dir(data.join("jobs"));
    let entries = entries.into_iter().flatten().flatten();
    entries
        .filter(|entry| entry.path().extension().is_some_and(|end| end == "json"))
        .filter_map(|entry| serde_json::from_str(&std::fs::read_to_string(entry.path()).ok()?).ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::queue::Kind;

    fn job(id: u64, ended_unix_s: Option<f64>) -> Job {
        let ended = |unix_s| Ended {
            code: Some(0),
            finished: true,
            unix_s,
            ..Ended::now("finished".to_owned())
        };
        Job {
            item: Item {
                id,
                kind: Kind::Run,
                run: format!("demo-{id}"),
                experiment: "demo".to_owned(),
                bench: "demo".to_owned(),
                seed: None,
                expected_s: 60.0,
                by: "ann".to_owned(),
                submitted_unix_s: 1.0,
                process: None,
                traceparent: None,
            },
            ended: ended_unix_s.map(ended),
        }
    }

    #[test]
    fn a_run_that_a_person_stopped_is_stopped_and_any_other_is_not() {
        use bench_core::{executor::ExecuteError, safety::failure::Failure};
        let early = |failure: Failure| format!("{}{failure}", run_folder::ENDED_EARLY);
        let interrupted = || Failure::Interrupted("runs/a".to_owned());
        let ann = || Some("ann".to_owned());
        for (code, how, stopper, stopped) in [
            (Some(130), early(interrupted()), None, true),
            (Some(130), early(ExecuteError::Aborted.into()), None, true),
            (Some(130), interrupted().to_string(), ann(), true),
            (
                None,
                "its process was killed or died".to_owned(),
                ann(),
                true,
            ),
            (
                None,
                "its process was killed or died".to_owned(),
                None,
                false,
            ),
            (
                Some(5),
                "interlock: cell voltage 4.3 V".to_owned(),
                ann(),
                false,
            ),
            (Some(6), "LOOK AT THE BENCH: load".to_owned(), ann(), false),
        ] {
            let ended = Ended {
                code,
                ..Ended::now(how.clone())
            };
            let ended = ended.stopped(stopper.clone());
            assert_eq!(ended.stopped, stopped, "{code:?} {how}");
            assert_eq!(ended.stopped_by, stopper.filter(|_| stopped));
        }
        let finished = Ended {
            finished: true,
            ..Ended::now("finished".to_owned())
        };
        assert!(!finished.stopped(ann()).stopped);
        // A record of an earlier version.
        let old = r#"{"code":1,"finished":false,"how":"x","unix_s":1.0}"#;
        assert!(!serde_json::from_str::<Ended>(old).unwrap().stopped);
    }

    #[test]
    fn the_order_in_memory_is_that_of_the_records_and_outlives_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("jobs")).unwrap();
        let jobs = Jobs::of(folder.path());
        for id in [2, 3, 1] {
            jobs.write(&job(id, None)).unwrap();
        }
        jobs.write(&job(2, Some(9.0))).unwrap();
        for jobs in [jobs, Jobs::of(folder.path())] {
            let begun: Vec<_> = jobs.begun();
            let runs = begun.iter().map(|one| (&*one.run, one.ended_unix_s));
            assert_eq!(
                runs.collect::<Vec<_>>(),
                [("demo-3", None), ("demo-2", Some(9.0)), ("demo-1", None)]
            );
            let read: Vec<u64> = jobs.latest().map(|job| job.item.id).collect();
            assert_eq!(read, [3, 2, 1]);
        }
    }
}
