//! Errors in the stored state of a bench.

use std::path::{Path, PathBuf};

use super::latched::Latched;

/// Error in the stored state of a bench.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The file system reported an error.
    #[error("{path}: the state of the bench {what}: {source}; state_folder in the bench file names \
    another place", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Operation that failed.
        what: &'static str,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// There is neither a configured folder nor an account that would give one.
    #[error(
        "expected a folder for the state of the instruments in {VARIABLE}, for neither \
        XDG_STATE_HOME nor HOME is set"
    )]
    Nowhere,
    /// Another daemon runs the bench.
    #[error("expected a bench that is not in use: process {pid} runs {bench} for {run}", run = run.display())]
    Busy {
        /// The bench.
        bench: String,
        /// The other process.
        pid: i32,
        /// Its run folder.
        run: PathBuf,
    },
    /// A process that only reads must wait.
    #[error("expected a bench that can be asked, found {by} at work on {bench}")]
    InUse {
        /// The bench.
        bench: String,
        /// What holds it.
        by: &'static str,
    },
    /// A person must inspect the bench first.
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

/// Environment variable that names the folder of all instruments. Accounts that run the same bench
/// must name one folder that all of them can write.
pub const VARIABLE: &str = "EIS_BENCH_STATE";
