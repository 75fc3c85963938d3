//! Readings of the outputs of a bench, kept in the folders of its instruments, so that every
//! process and every bench file that shares an instrument can use them. A run removes the readings
//! before it may switch anything on: only later readings are valid.
//!
//! A process that only reads takes a separate lock. Runs and processes that switch off terminate
//! such a reader: it changes nothing, and instruments accept one client.

use std::{fs::TryLockError, path::Path};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use super::{Lock, State, StateError, files::open, io, output_place::OutputPlace};
use crate::bench::outputs::{KnownReading, OutputReading, OutputState, OutputsState};
use bench_plan::{
    config::ANALOG,
    support::{locks, moment::Moment},
};

const READER_LOCK: &str = "reader.lock";

impl State {
    /// Stores the readings of the outputs.
    ///
    /// # Errors
    /// Fails if a file cannot be written; the remaining files are still written.
    pub fn keep_readings(&self, readings: &[OutputReading]) -> Result<(), StateError> {
        let now = Moment::now();
        let keep = |reading: &OutputReading| {
            let mut places = self.outputs.iter();
            let place = places.find(|place| place.role == reading.role);
            place.map_or(Ok(()), |place| place.keep(reading, &now))
        };
        let kept: Vec<_> = readings.iter().map(keep).collect();
        kept.into_iter().collect()
    }

    /// Removes every reading, because an output may be switched on from this point.
    pub(super) fn forget_readings(&self) -> Result<(), StateError> {
        self.outputs.iter().try_for_each(OutputPlace::forget)
    }

    /// Returns the state of the outputs, as far as it was read back.
    pub fn outputs(&self) -> OutputsState {
        let now = Moment::now();
        let each = self.outputs.iter().filter_map(|place| place.known(&now));
        let mut known: Vec<KnownReading> = each.collect();
        if let Some(oldest) = known.first().filter(|_| self.unswitched) {
            let analog = OutputReading {
                role: "supply4q".to_owned(),
                model: ANALOG.to_owned(),
                state: OutputState::Unswitched,
                volts: None,
                amps: None,
                ..oldest.reading.clone()
            };
            let age_s = oldest.age_s;
            known.insert(
                0,
                KnownReading {
                    reading: analog,
                    age_s,
                },
            );
        }
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

    /// Takes the lock of a process that only reads the outputs. It is refused while a run, a
    /// guardian, a process that switches off, or another reader holds the bench.
    ///
    /// # Errors
    /// [`StateError::Busy`], [`StateError::InUse`], or a file that cannot be opened.
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

    /// Terminates a process that only reads the outputs, and blocks new readers while the returned
    /// lock lives. It never fails: a lock that cannot be taken must not prevent a run or a
    /// shutdown.
    pub fn end_reader(&self) -> Lock {
        let mut files = Vec::new();
        for place in &self.places {
            let path = place.join(READER_LOCK);
            let Ok(file) = open(&path) else {
                continue;
            };
            // The system releases the locks of a killed process.
            let is_free = !matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock))
                || (end_process_of(&path) && file.lock_shared().is_ok());
            files.extend(is_free.then_some(file));
        }
        Lock(files)
    }
}

/// Terminates the process that holds a read lock; it has nothing to finish. Returns whether it was
/// found.
fn end_process_of(path: &Path) -> bool {
    // 0 and 1 are excluded, because they stand for whole process groups.
    locks::holder(path)
        .filter(|reader| *reader > 1)
        .is_some_and(|reader| kill(Pid::from_raw(reader), Signal::SIGKILL).is_ok())
}
