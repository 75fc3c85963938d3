//! Abilities that a bench must have for the fleet, and the state that it reports.

use futures_util::future::BoxFuture;
use serde::{Deserialize, Serialize};

use crate::error::FleetError;

/// Properties of a bench, for comparison with the requirements of jobs.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Capabilities {
    /// Maximum current that its instruments can drive through a cell, A.
    pub current_a: f64,
    /// Minimum and maximum temperature that its bath can hold, °C; `None` without a bath.
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<[f64; 2]>,
    /// Fixtures that its jig can take.
    pub fixtures: Vec<String>,
    /// Every instrument is simulated.
    pub simulated: bool,
}

/// State of a bench as the fleet sees it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BenchState {
    /// No run is active.
    Idle,
    /// A run is in work.
    Running,
    /// No run begins on it.
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
    #[serde(rename = "temperature_c")]
    pub temperature_degc: Option<f64>,
}

/// Present state of a bench.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Condition {
    /// Its state.
    pub state: BenchState,
    /// Whether no run is active or waiting, and no reason prevents a run.
    pub free: bool,
    /// Why no run may begin on it.
    pub held: Option<String>,
    /// The run in work.
    pub run: Option<String>,
    /// Time left of it, s.
    pub left_s: Option<f64>,
    /// Whether every output is known to be off; `None` while a run is active.
    pub verified: Option<bool>,
    /// The last reading of the run in work.
    pub reading: Option<Reading>,
    /// Why it is latched.
    pub trip: Option<String>,
}

impl Condition {
    /// Returns the unknown state of a bench whose server does not answer.
    pub fn away(away: &Away) -> Self {
        Self {
            held: Some(away.to_string()),
            ..Self::default()
        }
    }
}

/// The server of a bench does not answer, or its answer is invalid. It is unknown whether a request
/// has taken effect.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Away(pub String);

impl From<Away> for FleetError {
    fn from(away: Away) -> Self {
        Self::Bench(away.to_string())
    }
}

/// A run that the fleet requests from a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Order {
    /// The job.
    pub job: String,
    /// Name of the run. It is derived from the job, so that a repeated begin finds the first run.
    pub run: String,
    /// Name of the experiment.
    pub name: String,
    /// Text of the experiment.
    pub text: String,
    /// Seed that replaces the seed of the experiment.
    pub seed: Option<u64>,
    /// Name of the caller.
    pub by: String,
}

/// Result of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct End {
    /// Whether it is complete.
    pub finished: bool,
    /// Description of the end.
    pub words: String,
    /// SHA-256 of its `SHA256SUMS`, if it has one.
    pub content_sha256: Option<String>,
}

/// Fate of a run of the fleet on this bench.
#[derive(Debug, Clone, PartialEq)]
pub enum Fate {
    /// The bench does not know it.
    Unknown,
    /// It is waiting or active.
    Going,
    /// It has ended.
    Ended(End),
}

/// Reason why a bench does not take a job.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotTaken {
    /// The job does not fit this bench; another one may take it.
    Unfit(String),
    /// This bench can take nothing now, such as on a full disk.
    NotNow(String),
}

/// Reason why a bench does not execute a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum NotDone {
    /// Its server has refused the request without any effect.
    Refused(String),
    /// It is unknown whether it was executed.
    Away(Away),
}

/// A bench of this daemon. All functions except the stop may wait for a disk or a server, so they
/// are called on a blocking thread.
pub trait LocalBench: Send + Sync + 'static {
    /// Its name.
    fn name(&self) -> String;

    /// Its properties.
    fn capabilities(&self) -> Capabilities;

    /// Returns the present state of the bench. Must not block.
    ///
    /// # Errors
    /// The server does not answer.
    fn condition(&self) -> Result<Condition, Away>;

    /// Checks an experiment like any submission to the bench. Does not begin a run.
    ///
    /// # Errors
    /// The reason why this bench does not take it.
    fn check(&self, order: &Order) -> Result<(), NotTaken>;

    /// Begins a checked run as soon as the bench is free. Does nothing if the bench knows a run of
    /// this name.
    ///
    /// # Errors
    /// The reason why it does not begin, or that the outcome is unknown.
    fn begin(&self, order: &Order) -> Result<(), NotDone>;

    /// Removes a waiting run from the queue of the bench. Returns `false` if it does not wait.
    ///
    /// # Errors
    /// The server does not answer.
    fn withdraw(&self, run: &str, by: &str) -> Result<bool, Away>;

    /// Returns the fate of a run.
    ///
    /// # Errors
    /// The server does not answer.
    fn fate(&self, run: &str) -> Result<Fate, Away>;

    /// Holds the bench: no run begins from now on, and an active run continues.
    ///
    /// # Errors
    /// The reason why it is not held.
    fn hold(&self, by: &str, why: &str) -> Result<(), NotDone>;

    /// Releases a hold of the fleet. A hold by its own server stays, as does a latch.
    ///
    /// # Errors
    /// The reason why it stays held.
    fn release(&self, by: &str, why: &str) -> Result<(), NotDone>;

    /// Stops the bench and reads its outputs back; the report in JSON has at least `verified`.
    ///
    /// # Errors
    /// The server does not answer.
    fn stop<'a>(&'a self, by: &'a str) -> BoxFuture<'a, Result<serde_json::Value, Away>>;

    /// Records an action on this bench through the fleet in the audit trail.
    ///
    /// # Errors
    /// The server does not answer.
    fn audit(&self, by: &str, what: &str, outcome: &str) -> Result<(), Away>;
}
