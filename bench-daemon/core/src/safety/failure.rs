//! Reasons why a command ends without a result, with their exit codes.

use std::path::Path;

use crate::{
    bench::{BenchError, Unsafe},
    executor::ExecuteError,
    record::RecordError,
    safety::guardian::GuardianError,
    safety::state::StateError,
    sim::SimError,
};
use bench_plan::{
    config::ConfigError,
    plan::PlanError,
    support::{quoted::quoted, sums::SumsError},
};

/// Returns a path that a person can paste into a shell: without redundant `..` components, and
/// relative if the path is below the current directory.
pub fn pasted(path: &Path) -> String {
    let whole = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let here = std::env::current_dir().and_then(std::fs::canonicalize).ok();
    let short = here.and_then(|here| whole.strip_prefix(here).ok().map(Path::to_owned));
    quoted(
        &short
            .filter(|short| !short.as_os_str().is_empty())
            .unwrap_or(whole),
    )
}

/// Prefix of the message of [`Failure::Refused`].
pub const GATE_REFUSED: &str = "the quality gate refused";

/// Exit code if another process holds the bench.
pub const BUSY_CODE: u8 = 8;
/// Exit code of [`Failure::Refused`].
pub const REFUSED_CODE: u8 = 11;
/// Exit code of [`Failure::Invalid`].
pub const INVALID_CODE: u8 = 12;

/// Reason why a command ended without a result.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// A file or an argument is invalid.
    #[error("{0}")]
    Usage(String),
    /// A configuration file is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The plan would exceed the limits.
    #[error("the plan is refused: {0}")]
    Plan(#[from] PlanError),
    /// The bench cannot be used.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// An instrument does not answer or is not of a known model.
    #[error(
        "{wrong} of {asked} instruments did not answer, or are not the model that was expected: \
        {listed}"
    )]
    Unidentified {
        /// Number of instruments that were queried.
        asked: usize,
        /// Number of instruments that failed.
        wrong: usize,
        /// Their roles or addresses.
        listed: String,
    },
    /// The simulation cannot be created.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// A file cannot be written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A step failed.
    #[error(transparent)]
    Execute(#[from] ExecuteError),
    /// The fixture check failed.
    #[error("fixture check failed: {0}")]
    FixtureCheck(String),
    /// The doctor found a fault.
    #[error("the doctor found what must be mended first: {0}")]
    Doctor(String),
    /// Ctrl-C or another stop request ended the run.
    #[error(
        "stopped on request; the bench is in safe state, finished points are in {folder}, and \
        `eis-bench resume {folder}` goes on",
        folder = pasted(Path::new(.0))
    )]
    Interrupted(String),
    /// A stop request came while no run was in progress.
    #[error("{0}")]
    Stopped(String),
    /// A bug in the program.
    #[error("a mistake of the program ended the run, please report it: {0}")]
    Panic(String),
    /// Outputs may be on.
    #[error("LOOK AT THE BENCH: {failures}{cause}")]
    Unsafe {
        /// Currents that still flow or are unknown, and what to unplug.
        failures: String,
        /// Error that ended the run before.
        cause: String,
    },
    /// The bench is in use or latched, or its state cannot be written.
    #[error(transparent)]
    State(StateError),
    /// Another process works in the run folder.
    #[error("{0}")]
    Going(String),
    /// The guardian failed.
    #[error(transparent)]
    Guardian(#[from] GuardianError),
    /// The run folder has changed, or its numbers do not follow from its captures.
    #[error("{0}")]
    Differs(String),
    /// A store does not fulfil a request.
    #[error("{0}")]
    Store(String),
    /// Hashes cannot be written.
    #[error(transparent)]
    Sums(#[from] SumsError),
    /// A result cannot be computed or drawn.
    #[error("{0}")]
    Analysis(String),
    /// The run completed, but its quality gate has rejected points until the end.
    #[error(
        "{GATE_REFUSED} {count} points: they are flagged in the spectra, left out of the models \
        unless that was asked for, and of the correction"
    )]
    Refused {
        /// Number of points.
        count: usize,
    },
    /// The data cannot be diagnosed.
    #[error("the data are invalid: {0}")]
    Invalid(String),
    /// The operating system reported an error.
    #[error("{0}")]
    System(#[from] std::io::Error),
}

impl From<Unsafe> for Failure {
    fn from(unproven: Unsafe) -> Self {
        Self::Unsafe {
            failures: unproven.to_string(),
            cause: String::new(),
        }
    }
}

impl Failure {
    /// Gives a bench that could not be switched off precedence over every other failure. The error
    /// that ended the run is appended to the message.
    ///
    /// # Errors
    /// [`Failure::Unsafe`], or the failure of the outcome.
    pub fn unsafe_first<T>(safe: Result<(), Unsafe>, outcome: Result<T, Self>) -> Result<T, Self> {
        let Err(unproven) = safe else { return outcome };
        let after = match outcome.err() {
            None => String::new(),
            // Do not print the same text twice.
            Some(
                Self::Unsafe { .. }
                | Self::Bench(BenchError::Unsafe(_))
                | Self::Execute(ExecuteError::Bench(BenchError::Unsafe(_))),
            ) => String::new(),
            // The message of a stop request states that the bench is off, which would be wrong
            // here.
            Some(Self::Interrupted(_)) => " (after a request to stop)".to_owned(),
            Some(failure) => format!(" (after: {failure})"),
        };
        Err(Self::Unsafe {
            failures: unproven.to_string(),
            cause: after,
        })
    }

    /// Checks whether a temperature, or the device that controls it, ended the run. If so, the
    /// bath must not continue.
    pub fn is_of_temperature(&self) -> bool {
        matches!(self, Self::Execute(error) if error.is_of_temperature())
    }

    /// Returns the exit code; `eis-bench --help` lists them.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) | Self::Config(_) | Self::Plan(_) => 2,
            Self::Sim(SimError::Config(_) | SimError::Real { .. } | SimError::Model { .. }) => 2,
            Self::Record(RecordError::NotEmpty { .. }) => 2,
            Self::Bench(BenchError::Unsafe(_)) => 6,
            Self::Bench(_) | Self::Unidentified { .. } | Self::Sim(SimError::Port { .. }) => 3,
            Self::Execute(ExecuteError::Trip(_) | ExecuteError::CellLeftIn { .. }) => 5,
            Self::Execute(ExecuteError::Record(_))
            | Self::Record(_)
            | Self::Sums(_)
            | Self::Store(_)
            | Self::Analysis(_)
            | Self::Panic(_)
            | Self::System(_) => 1,
            Self::Execute(ExecuteError::Aborted) => 130,
            Self::Execute(_) => 3,
            Self::FixtureCheck(_) | Self::Doctor(_) => 4,
            Self::Unsafe { .. } => 6,
            Self::State(StateError::Latched { .. }) => 7,
            Self::Going(_)
            | Self::State(StateError::Busy { .. } | StateError::InUse { .. })
            | Self::Guardian(GuardianError::Busy(_) | GuardianError::Another) => BUSY_CODE,
            Self::State(StateError::Io { .. } | StateError::Nowhere)
            | Self::Guardian(GuardianError::State(_)) => 2,
            Self::Guardian(
                GuardianError::Bench(_) | GuardianError::Refused(_) | GuardianError::Unreached(_),
            ) => 3,
            Self::Guardian(_) => 9,
            Self::Differs(_) => 10,
            Self::Refused { .. } => REFUSED_CODE,
            Self::Invalid(_) => INVALID_CODE,
            Self::Interrupted(_) | Self::Stopped(_) => 130,
        }
    }
}
