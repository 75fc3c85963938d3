//! The state of a bench that outlives a process: which process runs it (`lock`), why it must not
//! be run (`trip.json`, `trips.jsonl`), which run may have left it on (`open.json`), and what the
//! guardian did (`guardian.json`, `guardian.log`).
//!
//! A bench has its own folder, and so does each of its instruments (`place`). Lock, latch and open
//! run are kept in all of these folders, so that every user of an instrument finds them, whatever
//! bench file is used. A bench that is simulated in this process has no folder, because nothing of
//! it remains afterwards.

mod error;
mod files;
mod latched;
mod output_place;
mod outputs;
mod place;
mod process;
mod registry;

use std::{
    fs::{self, File, OpenOptions, TryLockError},
    io::{Read, Seek, Write},
    path::{Path, PathBuf},
};

use instruments::clock;
use serde::Serialize;

pub use files::{Holder, OpenRun, Settled};
use files::{Latch, close_open, json, make, named_holder, open, read, read_open, remove};
pub use latched::Latched;
use output_place::OutputPlace;
pub use process::{began, is_stopped, pid};
pub use registry::{KnownBench, known_benches};

use bench_plan::{config, support::account};
use error::io;
pub use error::{StateError, VARIABLE};

const LOCK: &str = "lock";
const GUARDIAN_LOCK: &str = "guardian.lock";
const TRIP: &str = "trip.json";
const OPEN: &str = "open.json";
const SETTLED: &str = "settled.json";
const HISTORY: &str = "trips.jsonl";

/// Lock of a bench, held as long as the process runs the bench. The system releases it when the
/// process ends for any reason.
#[derive(Debug)]
pub struct Lock(#[expect(dead_code, reason = "held open")] Vec<File>);

/// The folders of a bench.
#[derive(Debug, Clone)]
pub struct State {
    folder: PathBuf,
    bench: String,
    file: PathBuf,
    /// The folders of the bench and of its instruments, in the order in which every process locks
    /// them.
    places: Vec<PathBuf>,
    outputs: Vec<OutputPlace>,
    mocked: bool,
    /// Whether the bipolar supply is analog, of which no reading can be kept.
    unswitched: bool,
}

/// Files of an open run, held open so that the end of the run can be recorded even if no file can
/// be opened any more.
#[derive(Debug)]
pub struct OpenFiles(Vec<File>);

impl State {
    /// Returns the folders of a bench and creates missing ones. Returns `None` for a bench that is
    /// simulated in this process.
    ///
    /// # Errors
    /// Fails if a folder cannot be created or written.
    pub fn of(bench: &config::Bench) -> Result<Option<Self>, StateError> {
        if bench.in_process() {
            return Ok(None);
        }
        let folder = bench.state_folder.clone();
        make(&folder)?;
        // Different spellings of a path must lead to the same folder.
        let own = fs::canonicalize(&folder).map_err(io(&folder, "cannot be found"))?;
        let instruments = place::places(bench)?;
        let outputs = instruments.iter().filter_map(OutputPlace::of).collect();
        let mut places: Vec<PathBuf> = instruments
            .into_iter()
            .flat_map(|instrument| instrument.folders)
            .collect();
        places.iter().try_for_each(|place| make(place))?;
        places.push(own);
        places.sort_unstable();
        places.dedup();
        // Different paths to a file must lead to the same file.
        let file = fs::canonicalize(&bench.path)
            .or_else(|_| std::path::absolute(&bench.path))
            .unwrap_or_else(|_| bench.path.clone());
        let state = Self {
            folder,
            bench: bench.name.clone(),
            file,
            places,
            outputs,
            mocked: bench.is_mocked(),
            unswitched: bench.wiring.analog.is_some(),
        };
        // Any fault of a folder must be found before an output is energised.
        state
            .places
            .iter()
            .try_for_each(|place| open(&place.join(LOCK)).map(|_| ()))?;
        Ok(Some(state))
    }

    /// Returns the path of a file in the bench's own folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Locks the bench and each of its instruments for a run.
    ///
    /// # Errors
    /// [`StateError::Busy`] if another process holds one of them.
    pub fn lock(&self, run: &Path) -> Result<Lock, StateError> {
        let mut files = Vec::new();
        for place in &self.places {
            let path = place.join(LOCK);
            let file = open(&path)?;
            match file.try_lock() {
                Ok(()) => files.push((path, file)),
                Err(TryLockError::WouldBlock) => return Err(self.busy(named_holder(&path))),
                Err(TryLockError::Error(source)) => {
                    return Err(io(&path, "cannot be locked")(source));
                }
            }
        }
        let text = serde_json::to_string(&self.own(run)).unwrap_or_default();
        for (path, file) in &mut files {
            let written = file
                .set_len(0)
                .and_then(|()| file.rewind())
                .and_then(|()| file.write_all(text.as_bytes()));
            written.map_err(io(path, "cannot be written"))?;
        }
        Ok(Lock(files.into_iter().map(|(_, file)| file).collect()))
    }

    fn own(&self, run: &Path) -> Holder {
        Holder {
            pid: pid(),
            began: began(pid()),
            run: run.to_owned(),
            bench: self.bench.clone(),
            file: self.file.clone(),
        }
    }

    /// Returns the process that runs the bench, or another bench that shares an instrument with
    /// it.
    ///
    /// # Errors
    /// Fails if a file cannot be opened.
    pub fn holder(&self) -> Result<Option<Holder>, StateError> {
        for place in &self.places {
            let path = place.join(LOCK);
            // Two processes that only query the lock must not block each other.
            if matches!(
                open(&path)?.try_lock_shared(),
                Err(TryLockError::WouldBlock)
            ) {
                return Ok(Some(named_holder(&path)));
            }
        }
        Ok(None)
    }

    /// Returns an error if a process runs the bench.
    ///
    /// # Errors
    /// [`StateError::Busy`].
    pub fn refuse_busy(&self) -> Result<(), StateError> {
        self.holder()?
            .map_or(Ok(()), |holder| Err(self.busy(holder)))
    }

    fn busy(
        &self,
        Holder {
            pid,
            run,
            bench,
            file,
            ..
        }: Holder,
    ) -> StateError {
        let other = format!(
            "{bench} ({}), which shares an instrument with {},",
            file.display(),
            self.bench
        );
        StateError::Busy {
            bench: if file == self.file {
                self.bench.clone()
            } else {
                other
            },
            pid,
            run,
        }
    }

    /// Takes the guardian's lock. Returns `None` if a guardian is already working on one of the
    /// instruments.
    ///
    /// # Errors
    /// Fails if a file cannot be opened.
    pub fn lock_guardian(&self) -> Result<Option<Lock>, StateError> {
        let mut files = Vec::new();
        for place in &self.places {
            let path = place.join(GUARDIAN_LOCK);
            let file = open(&path)?;
            match file.try_lock() {
                Ok(()) => files.push(file),
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(source)) => {
                    return Err(io(&path, "cannot be locked")(source));
                }
            }
        }
        Ok(Some(Lock(files)))
    }

    /// Checks whether the folder still exists. A person can remove it to end a guardian that
    /// cannot succeed.
    pub fn exists(&self) -> bool {
        self.folder.is_dir()
    }

    /// Returns an error if the bench is latched.
    ///
    /// # Errors
    /// [`StateError::Latched`] with its cause.
    pub fn refuse_latched(&self) -> Result<(), StateError> {
        let Some(trip) = self.trip()? else {
            return Ok(());
        };
        let elsewhere = format!(
            "{}, for it shares an instrument with {}, which",
            self.bench,
            trip.file.display()
        );
        let bench = if trip.file == self.file {
            self.bench.clone()
        } else {
            elsewhere
        };
        Err(StateError::Latched {
            bench,
            path: self.file.clone(),
            trip: Box::new(trip.latched),
        })
    }

    /// Returns why the bench or one of its instruments is latched, if so. A latch file that cannot
    /// be parsed latches, too.
    ///
    /// # Errors
    /// Fails if a file cannot be read.
    pub fn latched(&self) -> Result<Option<Latched>, StateError> {
        Ok(self.trip()?.map(|trip| trip.latched))
    }

    fn trip(&self) -> Result<Option<Latch>, StateError> {
        for place in &self.places {
            let path = place.join(TRIP);
            let unknown = |error| Latch {
                latched: Latched::new(
                    "daemon",
                    &format!("{} cannot be understood: {error}", path.display()),
                ),
                file: self.file.clone(),
                places: vec![place.clone()],
            };
            if let Some(read) = read::<Latch>(&path)? {
                return Ok(Some(read.unwrap_or_else(unknown)));
            }
        }
        Ok(None)
    }

    /// Latches the bench and its instruments. The first cause stays until it is cleared; every
    /// cause is added to the history.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn latch(&self, trip: &Latched) -> Result<(), StateError> {
        self.latch_also(trip, &[])
    }

    /// As [`Self::latch`], but also latches the instruments of an open run of another bench.
    ///
    /// # Errors
    /// As [`Self::latch`].
    pub fn latch_with(&self, trip: &Latched, open: &OpenRun) -> Result<(), StateError> {
        self.latch_also(trip, &open.places)
    }

    fn latch_also(&self, trip: &Latched, others: &[PathBuf]) -> Result<(), StateError> {
        let places: Vec<PathBuf> = self.places.iter().chain(others).cloned().collect();
        let whole = Latch {
            latched: trip.clone(),
            file: self.file.clone(),
            places,
        };
        let mut outcome = Ok(());
        for place in &whole.places {
            let path = place.join(TRIP);
            // A latch file that cannot be written must not prevent the others from being written.
            let latched = if path.exists() {
                Ok(())
            } else {
                json(&path, &whole)
            };
            outcome = outcome.and(latched);
        }
        // The latch matters more than the history and is written first, so that it succeeds if
        // only one of the two can be written.
        outcome.and(self.remember(&serde_json::json!({ "what": "latched", "trip": trip })))
    }

    /// Clears the latch in every folder and records who cleared it: the holder of the token with
    /// this name, or else the account of this process.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn clear(
        &self,
        trip: &Latched,
        token: Option<&str>,
        found: Option<&str>,
    ) -> Result<(), StateError> {
        let who = token.map_or_else(account::who, |name| format!("{name}, by token"));
        self.remember(&serde_json::json!({
            "what": "cleared",
            "who": who,
            "found": found,
            "unix_s": clock::unix_time_s(),
            "trip": trip,
        }))?;
        let Some(found) = self.trip()? else {
            return Ok(());
        };
        for place in found.places.iter().chain(&self.places) {
            let path = place.join(TRIP);
            let same = match read::<Latch>(&path)? {
                Some(Ok(other)) => other.latched == found.latched,
                Some(Err(_)) => self.places.contains(place),
                None => false,
            };
            if same {
                remove(place, TRIP)?;
            }
        }
        Ok(())
    }

    /// Records that a run may switch outputs on from this point. This discards all earlier
    /// readings of the outputs.
    ///
    /// # Errors
    /// Fails if a file cannot be written; then nothing may be switched on.
    pub fn begin(&self, run: &Path) -> Result<OpenFiles, StateError> {
        self.forget_readings()?;
        if let Err(error) = self.register() {
            tracing::warn!("`eis-bench safe` without a bench file will not find it: {error}");
        }
        let open = OpenRun {
            holder: self.own(run),
            unix_s: clock::unix_time_s(),
            places: self.places.clone(),
        };
        let files = self.places.iter().map(|place| {
            let path = place.join(OPEN);
            json(&path, &open)?;
            files::open(&path)
        });
        Ok(OpenFiles(files.collect::<Result<_, _>>()?))
    }

    /// Records that every output is off and was read back.
    ///
    /// # Errors
    /// Fails if a file cannot be removed. Even then, the end of the run is written into the file
    /// if possible.
    pub fn settled(&self) -> Result<(), StateError> {
        let existing = self.places.iter().map(|place| place.join(OPEN));
        let files = existing
            .filter(|path| path.exists())
            .filter_map(|path| files::open(&path).ok());
        self.settled_by(&mut OpenFiles(files.collect()))
    }

    /// As [`Self::settled`], through files that were opened when the run began.
    ///
    /// # Errors
    /// As [`Self::settled`].
    pub fn settled_by(&self, files: &mut OpenFiles) -> Result<(), StateError> {
        for file in &mut files.0 {
            if let Err(error) = close_open(file) {
                tracing::warn!("the end of the run cannot be written behind it: {error}");
            }
        }
        if self.mocked {
            self.unregister();
        }
        // A file that cannot be removed must not prevent the removal of the others.
        let places = self.places.iter();
        let removed: Vec<_> = places.map(|place| remove(place, OPEN)).collect();
        removed.into_iter().collect()
    }

    /// As [`Self::settled`], for an open run that was found, in every folder that contains it. The
    /// identity of the run is kept, because the report of the run's own guardian does not show
    /// that it was settled.
    ///
    /// # Errors
    /// As [`Self::settled`].
    pub fn settle(&self, open: &OpenRun) -> Result<(), StateError> {
        self.settled()?;
        open.places
            .iter()
            .try_for_each(|place| remove(place, OPEN))?;
        let settled = Settled {
            run: open.holder.run.clone(),
            unix_s: clock::unix_time_s(),
            read: self.outputs().words,
        };
        for place in self.places.iter().chain(&open.places) {
            // The run is settled even if this file cannot be written.
            if let Err(error) = json(&place.join(SETTLED), &settled) {
                tracing::warn!("{error}");
            }
        }
        Ok(())
    }

    /// Returns the last run that was settled after it and its guardian had died, if it can be
    /// read.
    pub fn last_settled(&self) -> Option<Settled> {
        read(&self.path(SETTLED)).ok().flatten()?.ok()
    }

    /// Returns the run after which no process has verified a safe state. A file that cannot be
    /// parsed counts as such a run.
    ///
    /// # Errors
    /// Fails if a file cannot be read.
    pub fn open_run(&self) -> Result<Option<OpenRun>, StateError> {
        for place in &self.places {
            if let Some(found) = read_open(&place.join(OPEN))? {
                let holder = Holder {
                    pid: 0,
                    began: None,
                    run: PathBuf::new(),
                    bench: self.bench.clone(),
                    file: self.file.clone(),
                };
                return Ok(Some(found.unwrap_or(OpenRun {
                    holder,
                    unix_s: 0.0,
                    places: vec![place.clone()],
                })));
            }
        }
        Ok(None)
    }

    /// Writes a structure as JSON into the bench's own folder, atomically.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), StateError> {
        json(&self.path(name), value)
    }

    /// Appends a line to the history. A line that was left incomplete when a process died remains
    /// a line of its own.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn remember(&self, entry: &serde_json::Value) -> Result<(), StateError> {
        let path = self.path(HISTORY);
        let mut file = OpenOptions::new()
            .create(true)
            .read(true)
            .append(true)
            .open(&path)
            .map_err(io(&path, "cannot be written"))?;
        let mut last = [b'\n'];
        if file.seek(std::io::SeekFrom::End(-1)).is_ok() {
            file.read_exact(&mut last)
                .map_err(io(&path, "cannot be read"))?;
        }
        let torn = if last == [b'\n'] { "" } else { "\n" };
        writeln!(file, "{torn}{entry}")
            .and_then(|()| file.sync_all())
            .map_err(io(&path, "cannot be written"))
    }
}

#[cfg(test)]
mod tests;
