//! Reasons why a command ended without its result, with their exit codes.

use std::path::Path;

use crate::{
    bench::{BenchError, Unsafe},
    config::ConfigError,
    executor::ExecuteError,
    plan::PlanError,
    record::RecordError,
    safety::guardian::GuardianError,
    safety::state::StateError,
    sim::SimError,
    support::present::quoted,
    support::sums::SumsError,
};

/// A path as a person pastes it into a shell: no way that goes up and down again, and short where
/// it lies below the folder of this process.
pub(crate) fn pasted(path: &Path) -> String {
    let whole = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let here = std::env::current_dir().and_then(std::fs::canonicalize).ok();
    let short = here.and_then(|here| whole.strip_prefix(here).ok().map(Path::to_owned));
    quoted(
        &short
            .filter(|short| !short.as_os_str().is_empty())
            .unwrap_or(whole),
    )
}

/// How [`Failure::Refused`] begins.
pub const GATE_REFUSED: &str = "the quality gate refused";

/// Exit code of a bench that another process has.
pub const BUSY_CODE: u8 = 8;
/// Exit code of [`Failure::Refused`].
pub const REFUSED_CODE: u8 = 11;
/// Exit code of [`Failure::Invalid`].
pub const INVALID_CODE: u8 = 12;

/// Why a command ended without its result.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// A file or an argument.
    #[error("{0}")]
    Usage(String),
    /// A configuration file.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A plan that would leave the limits.
    #[error("the plan is refused: {0}")]
    Plan(#[from] PlanError),
    /// A bench that cannot be used.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// Not every instrument is there, or of a known model.
    #[error(
        "{wrong} of {asked} instruments did not answer, or are not the model that was expected: \
        {listed}"
    )]
    Unidentified {
        /// How many were asked.
        asked: usize,
        /// How many are wrong.
        wrong: usize,
        /// Their roles or addresses.
        listed: String,
    },
    /// A simulation that cannot be made.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// A file that cannot be written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A step that failed.
    #[error(transparent)]
    Execute(#[from] ExecuteError),
    /// The fixture check.
    #[error("fixture check failed: {0}")]
    FixtureCheck(String),
    /// The doctor found something wrong.
    #[error("the doctor found what must be mended first: {0}")]
    Doctor(String),
    /// Ctrl-C, or another request to stop.
    #[error(
        "stopped on request; the bench is in safe state, finished points are in {folder}, and \
        `eis-bench resume {folder}` goes on",
        folder = pasted(Path::new(.0))
    )]
    Interrupted(String),
    /// A mistake of the program.
    #[error("a mistake of the program ended the run, please report it: {0}")]
    Panic(String),
    /// The outputs may be on.
    #[error("LOOK AT THE BENCH: {failures}{cause}")]
    Unsafe {
        /// Currents that still flow or are not known, and what to unplug.
        failures: String,
        /// Error that ended the run before.
        cause: String,
    },
    /// A bench that is in use, or latched, or whose state cannot be written.
    #[error(transparent)]
    State(StateError),
    /// A run folder that a process works in.
    #[error("{0}")]
    Going(String),
    /// The guardian.
    #[error(transparent)]
    Guardian(#[from] GuardianError),
    /// A run folder that is not what it was, or whose numbers do not follow from its captures.
    #[error("{0}")]
    Differs(String),
    /// A store that does not do what it is asked for.
    #[error("{0}")]
    Store(String),
    /// Hashes that cannot be written.
    #[error(transparent)]
    Sums(#[from] SumsError),
    /// A result that cannot be computed or drawn.
    #[error("{0}")]
    Analysis(String),
    /// A run that went to its end, and whose quality gate has refused points to the end.
    #[error(
        "{GATE_REFUSED} {count} points: they are flagged in the spectra, left out of the models \
        unless that was asked for, and of the correction"
    )]
    Refused {
        /// How many.
        count: usize,
    },
    /// A diagnosis of data that cannot be diagnosed.
    #[error("the data are invalid: {0}")]
    Invalid(String),
    /// The machine.
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
    /// Puts a bench that could not be switched off before every other failure. The error that ended
    /// the run is told behind it.
    ///
    /// # Errors
    /// [`Failure::Unsafe`], or that of the outcome.
    pub fn unsafe_first<T>(safe: Result<(), Unsafe>, outcome: Result<T, Self>) -> Result<T, Self> {
        let Err(unproven) = safe else { return outcome };
        let after = match outcome.err() {
            None => String::new(),
            // The same words would stand there twice.
            Some(
                Self::Unsafe { .. }
                | Self::Bench(BenchError::Unsafe(_))
                | Self::Execute(ExecuteError::Bench(BenchError::Unsafe(_))),
            ) => String::new(),
            // That of a request says that the bench is off: it is not.
            Some(Self::Interrupted(_)) => " (after a request to stop)".to_owned(),
            Some(failure) => format!(" (after: {failure})"),
        };
        Err(Self::Unsafe {
            failures: unproven.to_string(),
            cause: after,
        })
    }

    /// A temperature, or what makes it, ended the run: the bath must not go on.
    pub fn is_of_temperature(&self) -> bool {
        matches!(self, Self::Execute(error) if error.is_of_temperature())
    }

    /// The exit code; `eis-bench --help` lists them.
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
            Self::Interrupted(_) => 130,
        }
    }
}
