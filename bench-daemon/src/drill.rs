//! The crash drill: the process kills itself (SIGKILL) at a chosen point, so that what remains can be looked at. For simulated benches only.
//!
//! `EIS_BENCH_DRILL=exchange:N` dies at the N-th line of all transcripts together: a message that is just about to be sent, or an answer that has just
//! arrived. `EIS_BENCH_DRILL=journal:N` dies at the N-th end of a write to the journal, the even ones after it, the odd ones before it.

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
    exchange: bool,
    left: AtomicU64,
}

impl Drill {
    /// Never.
    pub fn none() -> Self {
        Self(None)
    }

    /// As the environment says.
    ///
    /// # Errors
    /// In words: a text that is none, or a bench that is not simulated.
    pub fn from_environment(simulated: bool) -> Result<Self, String> {
        match std::env::var(VARIABLE) {
            Ok(text) if simulated => Self::parse(&text),
            Ok(_) => Err(format!("{VARIABLE}: expected a bench with a section [simulation]: nothing else may die in the middle")),
            Err(_) => Ok(Self::none()),
        }
    }

    fn parse(text: &str) -> Result<Self, String> {
        let at = |number: &str| number.parse::<u64>().ok().filter(|number| *number > 0);
        let found = text.split_once(':').and_then(|(kind, number)| match kind {
            "exchange" => Some((true, at(number)?)),
            "journal" => Some((false, at(number)?)),
            _ => None,
        });
        let (exchange, number) =
            found.ok_or_else(|| format!("{VARIABLE}: expected `exchange:NUMBER` or `journal:NUMBER` from 1, found {text:?}"))?;
        Ok(Self(Some(Arc::new(Inner { exchange, left: AtomicU64::new(number) }))))
    }

    /// A message goes out or an answer has come.
    pub fn exchange(&self) {
        self.count(true);
    }

    /// A write to the journal begins or has ended.
    pub fn journal(&self) {
        self.count(false);
    }

    fn count(&self, exchange: bool) {
        let Some(inner) = self.0.as_ref().filter(|inner| inner.exchange == exchange) else { return };
        if inner.left.fetch_sub(1, Ordering::Relaxed) == 1 {
            // Nothing that comes after this is reached: no destructor, no flush, no safe state.
            let _ = raise(Signal::SIGKILL);
        }
    }

    /// A transcript each of whose lines is a point of the drill, once it is written.
    pub fn transcript<W: Write + Send + 'static>(&self, file: W) -> impl Write + Send + 'static + use<W> {
        Drilled { file, drill: self.clone() }
    }
}

struct Drilled<W> {
    file: W,
    drill: Drill,
}

impl<W: Write> Write for Drilled<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
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
        for text in ["exchange:1", "journal:2000"] {
            assert!(Drill::parse(text).is_ok(), "{text}");
        }
        for text in ["", "exchange", "exchange:0", "exchange:-1", "spoon:1", "journal:x"] {
            let message = Drill::parse(text).map(|_| ()).unwrap_err();
            assert!(message.starts_with("EIS_BENCH_DRILL: expected `exchange:NUMBER` or `journal:NUMBER` from 1, found "), "{message}");
        }
    }

    #[test]
    fn a_drill_of_one_kind_does_not_count_the_other() {
        let drill = Drill::parse("exchange:2").unwrap();
        for _ in 0..10 {
            drill.journal();
        }
        drill.exchange();
        assert_eq!(drill.0.map(|inner| inner.left.load(Ordering::Relaxed)), Some(1));
    }
}
