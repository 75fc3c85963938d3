//! Crash injection: the process kills itself (SIGKILL) at a chosen point, or the disk is full for
//! a file, so that the remains can be inspected. For simulated benches only.
//!
//! `EIS_BENCH_DRILL=exchange:N` dies at the N-th line of all transcripts together: before a
//! message is sent, or after a reply has arrived. `EIS_BENCH_DRILL=journal:N` dies at the N-th
//! end of a write to the journal, the even ones after it, the odd ones before it.
//! `EIS_BENCH_DRILL=full:NAME:N` makes the N-th write to files of the run folder whose names
//! begin with `NAME` fail, and all writes after it.

use std::{
    io::{self, Write},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use nix::sys::signal::{Signal, raise};

/// The variable of the environment.
pub const VARIABLE: &str = "EIS_BENCH_DRILL";

/// When the process is to die; clones count together.
#[derive(Debug, Clone, Default)]
pub struct Drill(Option<Arc<Inner>>);

#[derive(Debug)]
struct Inner {
    kind: Kind,
    left: AtomicU64,
}

#[derive(Debug, PartialEq)]
enum Kind {
    Exchange,
    Journal,
    /// Names that begin so have no room.
    Full(String),
}

/// Error number of the operating system for a full disk (ENOSPC).
const NO_SPACE: i32 = 28;

impl Drill {
    /// Never.
    pub fn none() -> Self {
        Self(None)
    }

    /// Reads the crash point from the environment.
    ///
    /// # Errors
    /// In words: an invalid text, or a bench that is not simulated.
    pub fn from_environment(simulated: bool) -> Result<Self, String> {
        match std::env::var(VARIABLE) {
            Ok(text) if simulated => Self::parse(&text),
            Ok(_) => Err(format!(
                "{VARIABLE}: expected a bench with a section [simulation]: nothing else may die in \
                the middle"
            )),
            Err(_) => Ok(Self::none()),
        }
    }

    fn parse(text: &str) -> Result<Self, String> {
        let at = |number: &str| number.parse::<u64>().ok().filter(|number| *number > 0);
        let found = text.split_once(':').and_then(|(kind, number)| match kind {
            "exchange" => Some((Kind::Exchange, at(number)?)),
            "journal" => Some((Kind::Journal, at(number)?)),
            "full" => number
                .rsplit_once(':')
                .and_then(|(name, number)| Some((Kind::Full(name.to_owned()), at(number)?))),
            _ => None,
        });
        let (kind, number) = found.ok_or_else(|| {
            format!(
                "{VARIABLE}: expected `exchange:NUMBER`, `journal:NUMBER` or \
            `full:NAME:NUMBER`, numbers from 1, found {text:?}"
            )
        })?;
        Ok(Self(Some(Arc::new(Inner {
            kind,
            left: AtomicU64::new(number),
        }))))
    }

    /// A message goes out or an answer has come.
    pub fn exchange(&self) {
        self.count(&Kind::Exchange);
    }

    /// A write to the journal begins or has ended.
    pub fn journal(&self) {
        self.count(&Kind::Journal);
    }

    /// Checks whether the simulated disk has room for a write to a file of the run folder.
    ///
    /// # Errors
    /// The system's error of a full disk.
    pub fn room(&self, name: &str) -> io::Result<()> {
        let full = |inner: &&Arc<Inner>| matches!(&inner.kind, Kind::Full(prefix) if name.starts_with(prefix));
        let Some(inner) = self.0.as_ref().filter(full) else {
            return Ok(());
        };
        let less = |left: u64| (left > 1).then(|| left - 1);
        let left = inner
            .left
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
        left.map_or_else(|_| Err(io::Error::from_raw_os_error(NO_SPACE)), |_| Ok(()))
    }

    fn count(&self, kind: &Kind) {
        let Some(inner) = self.0.as_ref().filter(|inner| inner.kind == *kind) else {
            return;
        };
        if inner.left.fetch_sub(1, Ordering::Relaxed) == 1 {
            // Nothing that comes after this is reached: no destructor, no flush, no safe state.
            let _ = raise(Signal::SIGKILL);
        }
    }

    /// Wraps a transcript so that each line is a crash point once it is written.
    pub fn transcript<W: Write + Send + 'static>(
        &self,
        file: W,
        name: String,
    ) -> impl Write + Send + 'static + use<W> {
        Drilled {
            file,
            name,
            drill: self.clone(),
        }
    }
}

struct Drilled<W> {
    file: W,
    name: String,
    drill: Drill,
}

impl<W: Write> Write for Drilled<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.drill.room(&self.name)?;
        self.file.write(bytes)
    }

    // A tap flushes after every line.
    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()?;
        self.drill.exchange();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_kind_and_a_number_are_a_drill() {
        for text in ["exchange:1", "journal:2000", "full:captures/cell:1"] {
            assert!(Drill::parse(text).is_ok(), "{text}");
        }
        for text in [
            "",
            "exchange",
            "exchange:0",
            "exchange:-1",
            "spoon:1",
            "journal:x",
            "full:1",
            "full:events.csv:0",
        ] {
            let message = Drill::parse(text).map(|_| ()).unwrap_err();
            assert!(
                message.starts_with(
                    "EIS_BENCH_DRILL: expected `exchange:NUMBER`, `journal:NUMBER` or \
                    `full:NAME:NUMBER`, numbers from 1, found "
                ),
                "{message}"
            );
        }
    }

    #[test]
    fn a_drill_of_one_kind_does_not_count_the_other() {
        let drill = Drill::parse("exchange:2").unwrap();
        for _ in 0..10 {
            drill.journal();
        }
        drill.exchange();
        assert_eq!(
            drill.0.map(|inner| inner.left.load(Ordering::Relaxed)),
            Some(1)
        );
    }

    #[test]
    fn a_disk_is_full_for_the_named_files_from_the_named_write_on() {
        let drill = Drill::parse("full:raw_:2").unwrap();
        let full = |name: &str| drill.room(name).is_err();
        assert_eq!(
            [
                full("events.csv"),
                full("raw_cell.csv"),
                full("raw_shunt.csv"),
                full("raw_cell.csv")
            ],
            [false, false, true, true]
        );
        assert!(
            drill
                .room("raw_cell.csv")
                .unwrap_err()
                .to_string()
                .starts_with("No space left on device")
        );
    }
}
