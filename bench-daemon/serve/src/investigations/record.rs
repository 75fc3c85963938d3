//! The record of an investigation.

use instruments::clock;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use bench_evaluate::investigate::closed_loop::{Budget, End};

/// Request for an investigation.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct InvestigationRequest {
    /// The first run: it must be finished, of one cell, and have a fitted model.
    pub run: String,
    /// A bench instead of that of the run.
    #[serde(default)]
    pub bench: Option<String>,
    /// Limit of the time of its experiments on the bench, min; 0 or more.
    pub budget_minutes: f64,
    /// Limit of the charge that they move in either direction, Ah; 0 or more.
    pub budget_ah: f64,
}

/// State of an investigation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum InvestigationState {
    /// All data so far are being diagnosed.
    Diagnosing,
    /// Its experiment waits in the queue.
    WaitingForBench,
    /// Its experiment runs.
    Measuring,
    /// It has ended.
    Ended,
}

/// An investigation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Investigation {
    /// Its name.
    pub id: String,
    /// The first run.
    pub run: String,
    /// The bench of its experiments.
    pub bench: String,
    /// Budget of its experiments.
    pub budget: Budget,
    /// Part of the budget that is spent. The experiment in progress counts after its end.
    pub spent: Budget,
    /// Name of the person who submitted it.
    pub by: String,
    /// Time of submission, s since 1970.
    pub submitted_unix_s: f64,
    /// State.
    pub state: InvestigationState,
    /// Runs in order, each with the diagnosis of all data up to it.
    pub steps: Vec<InvestigationStep>,
    /// Its end; null while it is in progress.
    pub ended: Option<InvestigationEnded>,
}

/// A run, and the diagnosis that follows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct InvestigationStep {
    /// The run.
    pub run: String,
    /// The recommended experiment of this run; null for the first run.
    pub experiment: Option<FollowUp>,
    /// The diagnosis of this run and all previous ones, after it was requested.
    pub analysis: Option<String>,
    /// Verdict of the diagnosis.
    pub verdict: Option<String>,
    /// The verdict in a sentence.
    pub summary: Option<String>,
}

/// A recommended experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FollowUp {
    /// Its name.
    pub name: String,
    /// Its queue number.
    pub place: u64,
    /// Planned time and charge.
    pub expected: Budget,
    /// Actual time and planned charge, after its end.
    pub spent: Option<Budget>,
}

/// The end of an investigation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct InvestigationEnded {
    /// Kind of the end.
    pub end: End,
    /// The reason in words.
    pub why: String,
    /// Time, s since 1970.
    pub unix_s: f64,
}

impl InvestigationStep {
    /// Creates a step for a run without results yet.
    pub(crate) fn of(run: &str) -> Self {
        Self {
            run: run.to_owned(),
            experiment: None,
            analysis: None,
            verdict: None,
            summary: None,
        }
    }
}

impl Investigation {
    /// Its experiments so far.
    pub(crate) fn experiments(&self) -> impl Iterator<Item = &FollowUp> {
        self.steps
            .iter()
            .filter_map(|step| step.experiment.as_ref())
    }

    /// Returns the investigation as ended.
    pub(crate) fn closed(mut self, end: End, why: &str) -> Self {
        self.state = InvestigationState::Ended;
        self.ended = Some(InvestigationEnded {
            end,
            why: why.to_owned(),
            unix_s: clock::unix_time_s(),
        });
        self
    }
}
