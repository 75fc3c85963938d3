//! Record of a bench for the fleet, and queries to a bench.

use serde::{Deserialize, Serialize};

use crate::{
    job::Place,
    local::{BenchState, Capabilities, Condition},
    standing::Said,
};

/// Record that a bench reports of itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct BenchRecord {
    /// The bench.
    #[serde(flatten)]
    pub(crate) place: Place,
    /// Number of its process.
    pub(crate) nonce: String,
    /// Number of its data folder.
    pub(crate) home: String,
    /// Its properties.
    pub(crate) capabilities: Capabilities,
    /// Its state.
    pub(crate) state: BenchState,
    /// Why no run may begin on it.
    pub(crate) held: Option<String>,
    /// It takes no further job.
    pub(crate) draining: bool,
    /// The run in work.
    pub(crate) run: Option<String>,
    /// The job that it has.
    pub(crate) job: Option<String>,
    /// Time left of the run, s.
    pub(crate) left_s: Option<f64>,
    /// Whether every output is known to be off; `None` while a run is active.
    pub(crate) verified: Option<bool>,
    /// Lease time, s; heartbeats are sent three times per lease.
    pub(crate) lease_s: f64,
    /// Its process has signed off.
    pub(crate) left: bool,
}

impl BenchRecord {
    /// Adds what the bench itself reports. Its own reason for a hold takes precedence.
    pub(crate) fn with(self, condition: &Condition) -> Self {
        let state = match condition.state {
            BenchState::Idle if self.held.is_some() => BenchState::Held,
            state => state,
        };
        Self {
            held: condition.held.clone().or(self.held),
            run: condition.run.clone(),
            left_s: condition.left_s,
            verified: condition.verified,
            state,
            ..self
        }
    }
}

/// A query to a bench.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Question {
    /// Query of its state; the bench reads its standing orders first.
    Look,
    /// Stop now.
    Stop(Said),
}

/// The answer of a bench.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct BenchAnswer {
    /// The present state of the bench.
    pub(crate) record: BenchRecord,
    /// Jobs that it has begun or is about to begin; `None` if it does not know.
    pub(crate) jobs: Option<Vec<String>>,
    /// Report of a stop.
    pub(crate) report: Option<serde_json::Value>,
}
