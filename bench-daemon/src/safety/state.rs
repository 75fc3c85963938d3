//! The state of a bench that outlives a process: who runs it (`lock`), why it must not be run
//! (`trip.json`, `trips.jsonl`), which run may have left it on (`open.json`), and what the guardian
//! did (`guardian.json`, `guardian.log`).
//!
//! A bench has a folder of its own, and each of its instruments has one (`place`). Lock, latch and
//! open run are kept in all of them, so that whoever uses one of the instruments meets them,
//! through whatever bench file. A bench that is simulated in this process has none: nothing of it
//! is left afterwards.

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

use crate::{config, support::account};
use error::io;
pub use error::{StateError, VARIABLE};

const LOCK: &str = "lock";
const GUARDIAN_LOCK: &str = "guardian.lock";
const TRIP: &str = "trip.json";
const OPEN: &str = "open.json";
const SETTLED: &str = "settled.json";
const HISTORY: &str = "trips.jsonl";

/// Held as long as the process runs the bench; the system takes it back when the process ends,
/// however it ends.
#[derive(Debug)]
pub struct Lock(#[expect(dead_code, reason = "held open")] Vec<File>);

/// The folders of a bench.
#[derive(Debug, Clone)]
pub struct State {
    folder: PathBuf,
    bench: String,
    file: PathBuf,
    /// Its own folder and those of its instruments, in the order in which everybody locks them.
    places: Vec<PathBuf>,
    outputs: Vec<OutputPlace>,
    mocked: bool,
}

/// Files of an open run, held open: that it is over gets there where no file can be opened any more.
#[derive(Debug)]
pub struct OpenFiles(Vec<File>);

impl State {
    /// The folders of a bench, made if they are not there; none for one that is simulated in this
    /// process.
    ///
    /// # Errors
    /// A folder that cannot be made or written.
    pub fn of(bench: &config::Bench) -> Result<Option<Self>, StateError> {
        if bench.in_process() {
            return Ok(None);
        }
        let folder = bench.state_folder.clone();
        make(&folder)?;
        // However the way to it was typed, it is one folder.
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
        // However a file is reached, it is one file.
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
        };
        // Whatever is wrong with a folder is to show before anything is energised.
        state
            .places
            .iter()
            .try_for_each(|place| open(&place.join(LOCK)).map(|_| ()))?;
        Ok(Some(state))
    }

    /// A file in the bench's own folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Takes the bench, and each of its instruments, for a run.
    ///
    /// # Errors
    /// [`StateError::Busy`] when another process has one of them.
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

    /// Who runs the bench, or another one that shares an instrument with it.
    ///
    /// # Errors
    /// A file that cannot be opened.
    pub fn holder(&self) -> Result<Option<Holder>, StateError> {
        for place in &self.places {
            let path = place.join(LOCK);
            // Two that only ask are not in each other's way.
            if matches!(
                open(&path)?.try_lock_shared(),
                Err(TryLockError::WouldBlock)
            ) {
                return Ok(Some(named_holder(&path)));
            }
        }
        Ok(None)
    }

    /// Refuses a bench that somebody runs.
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

    /// Takes the guardian's place; `None` when there is a guardian at work on one of the
    /// instruments.
    ///
    /// # Errors
    /// A file that cannot be opened.
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

    /// Whether the folder is still there: a person who takes it away ends a guardian that cannot
    /// succeed.
    pub fn exists(&self) -> bool {
        self.folder.is_dir()
    }

    /// Refuses a bench that is latched.
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

    /// Why the bench is latched, or an instrument of it, if it is. A file that cannot be understood
    /// latches too.
    ///
    /// # Errors
    /// A file that cannot be read.
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

    /// Latches the bench and its instruments. The first cause stays until it is cleared; each is in
    /// the history.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn latch(&self, trip: &Latched) -> Result<(), StateError> {
        self.latch_also(trip, &[])
    }

    /// As [`Self::latch`], together with what an open run of another bench had.
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
            // One that cannot be written must not keep the others from it.
            let latched = if path.exists() {
                Ok(())
            } else {
                json(&path, &whole)
            };
            outcome = outcome.and(latched);
        }
        // The latch counts, the history comes after it: where one of two cannot be written, it is
        // not to be this one.
        outcome.and(self.remember(&serde_json::json!({ "what": "latched", "trip": trip })))
    }

    /// Clears the latch, wherever it is, and remembers who did: whoever has the token of this name,
    /// or else the account of this process.
    ///
    /// # Errors
    /// A file that cannot be written.
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

    /// Says that a run may switch outputs on from here on: what was read of them before no longer
    /// stands.
    ///
    /// # Errors
    /// A file that cannot be written: then nothing may be switched on.
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

    /// Says that every output is off and was read back.
    ///
    /// # Errors
    /// A file that cannot be removed; that it is over is written into it all the same, if it can
    /// be.
    pub fn settled(&self) -> Result<(), StateError> {
        let existing = self.places.iter().map(|place| place.join(OPEN));
        let files = existing
            .filter(|path| path.exists())
            .filter_map(|path| files::open(&path).ok());
        self.settled_by(&mut OpenFiles(files.collect()))
    }

    /// As [`Self::settled`], by files that were opened when the run began.
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
        // One that cannot be removed must not keep the others.
        let places = self.places.iter();
        let removed: Vec<_> = places.map(|place| remove(place, OPEN)).collect();
        removed.into_iter().collect()
    }

    /// The same of a run that was found, wherever it says so. Which run that was stays written
    /// down: its own guardian's report does not say it.
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
            // It is settled without this, too.
            if let Err(error) = json(&place.join(SETTLED), &settled) {
                tracing::warn!("{error}");
            }
        }
        Ok(())
    }

    /// The last run that was settled after it and its guardian had died, if it can be read.
    pub fn last_settled(&self) -> Option<Settled> {
        read(&self.path(SETTLED)).ok().flatten()?.ok()
    }

    /// The run after which nobody has verified safe state. What cannot be understood is one too.
    ///
    /// # Errors
    /// A file that cannot be read.
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

    /// Writes a structure as JSON into the bench's own folder, whole or not at all.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn json<T: Serialize>(&self, name: &str, value: &T) -> Result<(), StateError> {
        json(&self.path(name), value)
    }

    /// Adds a line to the history. What is left of a line that was being written when a process
    /// died stays a line of its own.
    ///
    /// # Errors
    /// A file that cannot be written.
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
