//! Fault in the state of a bench.

use std::path::{Path, PathBuf};

use super::latched::Latched;

/// Fault in the state of a bench.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The file system.
    #[error("{path}: the state of the bench {what}: {source}; state_folder in the bench file names \
    another place", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Operation that was tried.
        what: &'static str,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// No account, no folder.
    #[error(
        "expected a folder for the state of the instruments in {VARIABLE}, for neither \
        XDG_STATE_HOME nor HOME is set"
    )]
    Nowhere,
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
    /// Whoever would only ask must wait.
    #[error("expected a bench that can be asked, found {by} at work on {bench}")]
    InUse {
        /// The bench.
        bench: String,
        /// Who has it.
        by: &'static str,
    },
    /// A person has to look first.
    #[error("{bench} is latched: {trip}. Look at the bench and the cell, then `eis-bench clear \
    {}`", path.display())]
    Latched {
        /// The bench.
        bench: String,
        /// Its file.
        path: PathBuf,
        /// Why.
        trip: Box<Latched>,
    },
}

pub(super) fn io(path: &Path, what: &'static str) -> impl Fn(std::io::Error) -> StateError + use<> {
    let path = path.to_owned();
    move |source| StateError::Io {
        path: path.clone(),
        what,
        source,
    }
}

/// Names the folder of all instruments; several accounts that run the same bench name one that all
/// may write.
pub const VARIABLE: &str = "EIS_BENCH_STATE";
