//! The state of a bench that outlives a process: who runs it (`lock`), why it must not be run (`trip.json`, `trips.jsonl`), and what the guardian
//! did (`guardian.json`, `guardian.log`). One folder per bench. A bench that is simulated in this process has none: nothing of it is left afterwards.

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io::{Seek, Write},
    path::{Path, PathBuf},
};

use analysis::dataset::write_atomically;
use instruments::clock;
use serde::{Deserialize, Serialize};

use crate::{config, interlock::Trip};

const LOCK: &str = "lock";
const GUARDIAN_LOCK: &str = "guardian.lock";
const TRIP: &str = "trip.json";
const HISTORY: &str = "trips.jsonl";

/// What is wrong with the state of a bench.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The file system.
    #[error("{path}: the state of the bench {what}: {source}; state_folder in the bench file names another place", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was tried.
        what: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
    /// Another daemon runs the bench.
    #[error("expected a bench that nobody runs: process {pid} runs {bench} for {run}", run = run.display())]
    Busy {
        /// The bench.
        bench: String,
        /// The other process.
        pid: i32,
        /// Its run folder.
        run: PathBuf,
    },
    /// A person has to look first.
    #[error("{bench} is latched: {trip}. Look at the bench and the cell, then `eis-bench clear {}`", path.display())]
    Latched {
        /// The bench.
        bench: String,
        /// Its file.
        path: PathBuf,
        /// Why.
        trip: Box<Latched>,
    },
}

/// Why a bench must not be run until a person has cleared it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Latched {
    /// In words.
    pub cause: String,
    /// What left its limits, where it was a reading.
    pub quantity: Option<String>,
    /// Its value.
    pub value: Option<f64>,
    /// Its unit.
    pub unit: Option<String>,
    /// Its limits; one that is infinite is none.
    pub limits: Option<(Option<f64>, Option<f64>)>,
    /// Bench time of the run, s.
    pub bench_time_s: Option<f64>,
    /// The run folder.
    pub run: Option<PathBuf>,
    /// The step in work.
    pub step: Option<String>,
    /// Which process found it: `daemon`, `guardian` or `safe`.
    pub by: String,
    /// When, s since 1970.
    pub unix_s: f64,
}

impl std::fmt::Display for Latched {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.cause)?;
        if let Some(step) = self.step.as_ref().filter(|step| !step.is_empty()) {
            write!(f, " in step \"{step}\"")?;
        }
        self.run.as_ref().map_or(Ok(()), |run| write!(f, " of {}", run.display()))
    }
}

impl Latched {
    /// A cause that is no reading.
    pub fn new(by: &str, cause: &str) -> Self {
        Self {
            cause: cause.to_owned(),
            quantity: None,
            value: None,
            unit: None,
            limits: None,
            bench_time_s: None,
            run: None,
            step: None,
            by: by.to_owned(),
            unix_s: clock::unix_time_s(),
        }
    }

    /// What the interlock found.
    pub fn of_trip(by: &str, trip: &Trip) -> Self {
        let latched = Self::new(by, &format!("interlock: {trip}"));
        match trip {
            Trip::Chiller { time_s, .. } => Self { bench_time_s: Some(*time_s), ..latched },
            Trip::Limit { what, value, unit, least, greatest, time_s } => {
                let finite = |value: f64| Some(value).filter(|value| value.is_finite());
                Self {
                    quantity: Some((*what).to_owned()),
                    value: finite(*value),
                    unit: Some((*unit).to_owned()),
                    limits: Some((finite(*least), finite(*greatest))),
                    bench_time_s: Some(*time_s),
                    ..latched
                }
            }
        }
    }

    /// The same in a run and a step.
    #[must_use]
    pub fn during(self, run: &Path, step: &str) -> Self {
        Self { run: Some(run.to_owned()), step: Some(step.to_owned()), ..self }
    }
}

/// Who runs a bench.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Holder {
    /// The process.
    pub pid: i32,
    /// Its run folder.
    pub run: PathBuf,
}

/// Held as long as the process runs the bench; the system takes it back when the process ends, however it ends.
#[derive(Debug)]
pub struct Lock(#[expect(dead_code, reason = "held open")] File);

/// The folder of a bench.
#[derive(Debug, Clone)]
pub struct State {
    folder: PathBuf,
    bench: String,
    file: PathBuf,
}

impl State {
    /// The folder of a bench, made if it is not there; none for one that is simulated in this process.
    ///
    /// # Errors
    /// A folder that cannot be made or written.
    pub fn of(bench: &config::Bench) -> Result<Option<Self>, StateError> {
        if bench.in_process() {
            return Ok(None);
        }
        let folder = bench.state_folder.clone();
        fs::create_dir_all(&folder).map_err(io(&folder, "has no folder, and none can be made"))?;
        let state = Self { folder, bench: bench.name.clone(), file: bench.path.clone() };
        // Whatever is wrong with the folder is to show before anything is energised.
        state.open(LOCK)?;
        Ok(Some(state))
    }

    /// A file in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Takes the bench for a run.
    ///
    /// # Errors
    /// [`StateError::Busy`] when another process has it.
    pub fn lock(&self, run: &Path) -> Result<Lock, StateError> {
        let mut file = self.open(LOCK)?;
        let path = self.path(LOCK);
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(self.busy(self.named_holder())),
            Err(TryLockError::Error(source)) => return Err(io(&path, "cannot be locked")(source)),
        }
        let holder = Holder { pid: pid(), run: run.to_owned() };
        let text = serde_json::to_string(&holder).unwrap_or_default();
        file.set_len(0)
            .and_then(|()| file.rewind())
            .and_then(|()| file.write_all(text.as_bytes()))
            .map_err(io(&path, "cannot be written"))?;
        Ok(Lock(file))
    }

    /// Who runs the bench at present.
    ///
    /// # Errors
    /// A file that cannot be opened.
    pub fn holder(&self) -> Result<Option<Holder>, StateError> {
        match self.open(LOCK)?.try_lock() {
            Err(TryLockError::WouldBlock) => Ok(Some(self.named_holder())),
            _ => Ok(None),
        }
    }

    /// Refuses a bench that somebody runs.
    ///
    /// # Errors
    /// [`StateError::Busy`].
    pub fn refuse_busy(&self) -> Result<(), StateError> {
        self.holder()?.map_or(Ok(()), |holder| Err(self.busy(holder)))
    }

    fn busy(&self, Holder { pid, run }: Holder) -> StateError {
        StateError::Busy { bench: self.bench.clone(), pid, run }
    }

    /// Takes the guardian's place; `None` when there is a guardian at work.
    ///
    /// # Errors
    /// A file that cannot be opened.
    pub fn lock_guardian(&self) -> Result<Option<Lock>, StateError> {
        let file = self.open(GUARDIAN_LOCK)?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Lock(file))),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(source)) => Err(io(&self.path(GUARDIAN_LOCK), "cannot be locked")(source)),
        }
    }

    /// Whether the folder is still there: a person who takes it away ends a guardian that cannot succeed.
    pub fn exists(&self) -> bool {
        self.folder.is_dir()
    }

    /// Refuses a bench that is latched.
    ///
    /// # Errors
    /// [`StateError::Latched`] with its cause.
    pub fn refuse_latched(&self) -> Result<(), StateError> {
        match self.latched()? {
            None => Ok(()),
            Some(trip) => Err(StateError::Latched { bench: self.bench.clone(), path: self.file.clone(), trip: Box::new(trip) }),
        }
    }

    /// Why the bench is latched, if it is. A file that cannot be understood latches too.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn latched(&self) -> Result<Option<Latched>, StateError> {
        let path = self.path(TRIP);
        match fs::read_to_string(&path) {
            Ok(text) => Ok(Some(
                serde_json::from_str(&text)
                    .unwrap_or_else(|error| Latched::new("daemon", &format!("{} cannot be understood: {error}", path.display()))),
            )),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(source) => Err(io(&path, "cannot be read")(source)),
        }
    }

    /// Latches the bench. The first cause stays until it is cleared; each is in the history.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn latch(&self, trip: &Latched) -> Result<(), StateError> {
        // The latch counts, the history comes after it: where one of two cannot be written, it is not to be this one.
        let latched = if self.latched()?.is_some() { Ok(()) } else { self.json(TRIP, trip) };
        latched.and(self.remember(&serde_json::json!({ "what": "latched", "trip": trip })))
    }

    /// Clears the latch and remembers who did.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn clear(&self, trip: &Latched) -> Result<(), StateError> {
        self.remember(&serde_json::json!({ "what": "cleared", "who": who(), "unix_s": clock::unix_time_s(), "trip": trip }))?;
        let path = self.path(TRIP);
        fs::remove_file(&path).map_err(io(&path, "cannot be removed"))?;
        self.sync()
    }

    /// Writes a structure as JSON, whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), StateError> {
        let path = self.path(name);
        let mut text = serde_json::to_string_pretty(value).map_err(|error| io(&path, "cannot be put into JSON")(error.into()))?;
        text.push('\n');
        write_atomically(&path, text.as_bytes()).map_err(|error| io(&path, "cannot be written")(std::io::Error::other(error)))
    }

    /// The run whose guardian neither was dismissed nor verified that the bench is off; none where the report says otherwise or cannot be read.
    pub fn unsettled(&self) -> Option<String> {
        let text = fs::read_to_string(self.path("guardian.json")).ok()?;
        let report: serde_json::Value = serde_json::from_str(&text).ok()?;
        let open = report["status"] == "watching" || report["status"] == "switching off";
        open.then(|| report["run"].as_str().unwrap_or_default().to_owned())
    }

    /// Adds a line to the history.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn remember(&self, entry: &serde_json::Value) -> Result<(), StateError> {
        let path = self.path(HISTORY);
        let mut file = OpenOptions::new().create(true).append(true).open(&path).map_err(io(&path, "cannot be written"))?;
        writeln!(file, "{entry}").and_then(|()| file.sync_all()).map_err(io(&path, "cannot be written"))
    }

    /// A name that was removed is gone from the disk only when its folder is written.
    fn sync(&self) -> Result<(), StateError> {
        File::open(&self.folder).and_then(|folder| folder.sync_all()).map_err(io(&self.folder, "cannot be written"))
    }

    fn named_holder(&self) -> Holder {
        let text = fs::read_to_string(self.path(LOCK)).unwrap_or_default();
        serde_json::from_str(&text).unwrap_or_else(|_| Holder { pid: 0, run: PathBuf::new() })
    }

    fn open(&self, name: &str) -> Result<File, StateError> {
        let path = self.path(name);
        let opened = OpenOptions::new().create(true).truncate(false).read(true).write(true).open(&path);
        opened.map_err(io(&path, "cannot be written"))
    }
}

/// The number of this process.
pub fn pid() -> i32 {
    nix::unistd::Pid::this().as_raw()
}

/// The person at the machine, by the name of their account.
pub fn who() -> String {
    let uid = nix::unistd::Uid::current();
    nix::unistd::User::from_uid(uid).ok().flatten().map_or_else(|| format!("uid {uid}"), |user| user.name)
}

fn io(path: &Path, what: &'static str) -> impl Fn(std::io::Error) -> StateError + use<> {
    let path = path.to_owned();
    move |source| StateError::Io { path: path.clone(), what, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(folder: &Path) -> State {
        State { folder: folder.to_owned(), bench: "b".to_owned(), file: "b.toml".into() }
    }

    #[test]
    fn one_process_runs_a_bench_and_the_next_is_told_which() {
        let folder = tempfile::tempdir().unwrap();
        let state = state(folder.path());
        assert_eq!(state.holder().unwrap(), None);
        let lock = state.lock(Path::new("runs/a")).unwrap();
        assert_eq!(state.holder().unwrap(), Some(Holder { pid: pid(), run: "runs/a".into() }));
        let refused = state.lock(Path::new("runs/b")).unwrap_err().to_string();
        assert_eq!(refused, format!("expected a bench that nobody runs: process {} runs b for runs/a", pid()));
        drop(lock);
        state.lock(Path::new("runs/b")).unwrap();
    }

    #[test]
    fn the_first_cause_stays_until_a_person_clears_it_and_all_are_remembered() {
        let folder = tempfile::tempdir().unwrap();
        let state = state(folder.path());
        let trip = Trip::Limit { what: "cell voltage", value: 4.3, unit: "V", least: 2.5, greatest: 4.2, time_s: 12.0 };
        let first = Latched::of_trip("daemon", &trip).during(Path::new("runs/a"), "charge");
        state.latch(&first).unwrap();
        state.latch(&Latched::new("guardian", "later")).unwrap();
        assert_eq!(state.latched().unwrap().as_ref(), Some(&first));
        let refused = state.refuse_latched().unwrap_err().to_string();
        let words = "b is latched: interlock: cell voltage 4.3000 V left its limits (2.5 V to 4.2 V) at 12.0 s in step \"charge\" of runs/a. \
                     Look at the bench and the cell, then `eis-bench clear b.toml`";
        assert_eq!(refused, words);
        state.clear(&first).unwrap();
        state.refuse_latched().unwrap();
        let history = fs::read_to_string(state.path(HISTORY)).unwrap();
        let whats: Vec<_> = history.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["what"].clone()).collect();
        assert_eq!(whats, ["latched", "latched", "cleared"]);
        assert!(history.contains(&format!("\"who\":\"{}\"", who())), "{history}");
    }

    #[test]
    fn a_history_that_cannot_be_written_loses_no_latch() {
        let folder = tempfile::tempdir().unwrap();
        let state = state(folder.path());
        fs::create_dir(state.path(HISTORY)).unwrap();
        let cause = Latched::new("daemon", "too warm");
        assert!(state.latch(&cause).is_err());
        assert_eq!(state.latched().unwrap(), Some(cause));
    }

    #[test]
    fn a_latch_that_cannot_be_understood_is_a_latch() {
        let folder = tempfile::tempdir().unwrap();
        let state = state(folder.path());
        fs::write(state.path(TRIP), "{\"cause\":").unwrap();
        assert!(state.refuse_latched().unwrap_err().to_string().contains("cannot be understood"));
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        let state = state(Path::new("/proc/no-such-folder"));
        let message = state.lock(Path::new("r")).unwrap_err().to_string();
        assert!(message.starts_with("/proc/no-such-folder/lock: the state of the bench cannot be written: "), "{message}");
    }
}
