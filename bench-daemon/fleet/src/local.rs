//! Abilities that a bench must have for the fleet, and the state that it reports.

use futures_util::future::BoxFuture;
use serde::{Deserialize, Serialize};

use crate::error::FleetError;

/// Properties of a bench that requirements of jobs are held against.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Capabilities {
    /// Greatest current that its instruments can drive through a cell, A.
    pub current_a: f64,
    /// Minimum and maximum temperature that its bath can hold, °C; `None` without a bath.
    pub temperature_c: Option<[f64; 2]>,
    /// Fixtures that its jig can take.
    pub fixtures: Vec<String>,
    /// Every instrument is simulated.
    pub simulated: bool,
}

/// State of a bench as the fleet sees it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BenchState {
    /// Nothing runs.
    Idle,
    /// A run is in work.
    Running,
    /// Nothing is begun on it.
    #[default]
    Held,
    /// A person must inspect it and clear it, at its own server.
    Latched,
    /// A run waits for a person at the jig.
    Asking,
}

/// A reading of a run in work.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// Voltage, V.
    pub voltage_v: Option<f64>,
    /// Current, A; positive for charge.
    pub current_a: Option<f64>,
    /// Temperature of the cell, °C.
    pub temperature_c: Option<f64>,
}

/// Present state of a bench.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Condition {
    /// Its state.
    pub state: BenchState,
    /// Nothing runs or waits on it, and nothing keeps a run from beginning.
    pub free: bool,
    /// Why no run may begin on it.
    pub held: Option<String>,
    /// The run in work.
    pub run: Option<String>,
    /// Time left of it, s.
    pub left_s: Option<f64>,
    /// Every output is known to be off; none while a run is in work.
    pub verified: Option<bool>,
    /// The last reading of the run in work.
    pub reading: Option<Reading>,
    /// Why it is latched.
    pub trip: Option<String>,
}

impl Condition {
    /// Returns the state of a bench whose server does not answer: nothing is known of it.
    pub fn away(away: &Away) -> Self {
        Self {
            held: Some(away.to_string()),
            ..Self::default()
        }
    }
}

/// The server of a bench does not answer, or not as expected. Whether a request has taken effect is
/// unknown.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Away(pub String);

impl From<Away> for FleetError {
    fn from(away: Away) -> Self {
        Self::Bench(away.to_string())
    }
}

/// A run that the fleet wants of a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// The job.
    pub job: String,
    /// Name that the run must get. It follows from the job: a second begin finds the first.
    pub run: String,
    /// Name of the experiment.
    pub name: String,
    /// Text of the experiment.
    pub text: String,
    /// Another seed than the experiment's.
    pub seed: Option<u64>,
    /// Name of the caller.
    pub by: String,
}

/// How a run has ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct End {
    /// Nothing of it is left to do.
    pub finished: bool,
    /// How, in words.
    pub words: String,
    /// SHA-256 of its `SHA256SUMS`, if it has one.
    pub content_sha256: Option<String>,
}

/// Fate of a run of the fleet on this bench.
#[derive(Debug, Clone, PartialEq)]
pub enum Fate {
    /// The bench knows nothing of it.
    Unknown,
    /// It waits, or is in work.
    Going,
    /// It has ended.
    Ended(End),
}

/// Why a bench does not take a job, in words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotTaken {
    /// The job does not fit this bench; another one may take it.
    Unfit(String),
    /// This bench can take nothing now, such as on a full disk.
    NotNow(String),
}

/// Why a bench does not do something.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotDone {
    /// Its server has refused, and nothing was done.
    Refused(String),
    /// Whether it was done is unknown.
    Away(Away),
}

/// A bench of this daemon. All functions but the stop may wait for a disk or a server: they are
/// called on a thread for work that waits.
pub trait LocalBench: Send + Sync + 'static {
    /// Its name.
    fn name(&self) -> String;

    /// Its properties.
    fn capabilities(&self) -> Capabilities;

    /// Returns the present state of the bench. Must not block.
    ///
    /// # Errors
    /// A server that does not answer.
    fn condition(&self) -> Result<Condition, Away>;

    /// Checks an experiment like any submission to the bench. Does not begin a run.
    ///
    /// # Errors
    /// Why this bench does not take it.
    fn check(&self, order: &Order) -> Result<(), NotTaken>;

    /// Begins a checked run as soon as the bench is free. Does nothing if the bench knows a run of
    /// this name.
    ///
    /// # Errors
    /// Why it does not begin, or that this is unknown.
    fn begin(&self, order: &Order) -> Result<(), NotDone>;

    /// Removes a waiting run from the queue of the bench. Returns `false` if it does not wait.
    ///
    /// # Errors
    /// A server that does not answer.
    fn withdraw(&self, run: &str, by: &str) -> Result<bool, Away>;

    /// Returns the fate of a run.
    ///
    /// # Errors
    /// A server that does not answer.
    fn fate(&self, run: &str) -> Result<Fate, Away>;

    /// Holds the bench: no run begins from now on, and an active run continues.
    ///
    /// # Errors
    /// Why it is not held.
    fn hold(&self, by: &str, why: &str) -> Result<(), NotDone>;

    /// Releases a hold of the fleet. A hold by its own server stays, as does a latch.
    ///
    /// # Errors
    /// Why it stays held.
    fn release(&self, by: &str, why: &str) -> Result<(), NotDone>;

    /// Stops the bench and reads its outputs back; the report in JSON has at least `verified`.
    ///
    /// # Errors
    /// A server that does not answer.
    fn stop<'a>(&'a self, by: &'a str) -> BoxFuture<'a, Result<serde_json::Value, Away>>;

    /// Records an action on this bench through the fleet in the audit trail.
    ///
    /// # Errors
    /// A server that does not answer.
    fn audit(&self, by: &str, what: &str, outcome: &str) -> Result<(), Away>;
}
