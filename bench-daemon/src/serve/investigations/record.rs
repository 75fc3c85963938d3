//! The record of an investigation.

use instruments::clock;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::investigate::closed_loop::{Budget, End};

/// An investigation that is asked for.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct InvestigationRequest {
    /// The run that it begins with: one that has finished, of one cell, with a model.
    pub run: String,
    /// Another bench than that of the run.
    #[serde(default)]
    pub bench: Option<String>,
    /// Time on the bench that its experiments may take, min; 0 or more.
    pub budget_minutes: f64,
    /// Charge that they may move in either direction, Ah; 0 or more.
    pub budget_ah: f64,
}

/// State of an investigation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum InvestigationState {
    /// All data so far are diagnosed.
    Diagnosing,
    /// Its experiment waits in the queue.
    WaitingForBench,
    /// Its experiment runs.
    Measuring,
    /// Nothing more happens.
    Ended,
}

/// An investigation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Investigation {
    /// Its name.
    pub id: String,
    /// The run that it began with.
    pub run: String,
    /// The bench of its experiments.
    pub bench: String,
    /// Budget of its experiments.
    pub budget: Budget,
    /// Part of it that is spent. The experiment in work counts when it has ended.
    pub spent: Budget,
    /// Who asked for it.
    pub by: String,
    /// When, s since 1970.
    pub submitted_unix_s: f64,
    /// State.
    pub state: InvestigationState,
    /// Runs in order, each with the diagnosis of all data up to it.
    pub steps: Vec<InvestigationStep>,
    /// How it ended; none while it goes on.
    pub ended: Option<InvestigationEnded>,
}

/// A run, and the diagnosis that follows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct InvestigationStep {
    /// The run.
    pub run: String,
    /// The recommended experiment that it plays; none for the run that was there before.
    pub experiment: Option<FollowUp>,
    /// The diagnosis of this run and all before it, once it is asked for.
    pub analysis: Option<String>,
    /// Its verdict, in words.
    pub verdict: Option<String>,
    /// The same in a sentence.
    pub summary: Option<String>,
}

/// A recommended experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FollowUp {
    /// Its name.
    pub name: String,
    /// Number of its place in the queue.
    pub place: u64,
    /// Time and charge of its plan.
    pub expected: Budget,
    /// Time that it took, with the charge of its plan, once it has ended.
    pub spent: Option<Budget>,
}

/// The end of an investigation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct InvestigationEnded {
    /// Kind of the end.
    pub end: End,
    /// The same in words.
    pub why: String,
    /// When, s since 1970.
    pub unix_s: f64,
}

impl InvestigationStep {
    /// Creates a step for a run without results yet.
    pub(in crate::serve) fn of(run: &str) -> Self {
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
    pub(in crate::serve) fn experiments(&self) -> impl Iterator<Item = &FollowUp> {
        self.steps
            .iter()
            .filter_map(|step| step.experiment.as_ref())
    }

    /// Returns the investigation as ended.
    pub(in crate::serve) fn closed(mut self, end: End, why: &str) -> Self {
        self.state = InvestigationState::Ended;
        self.ended = Some(InvestigationEnded {
            end,
            why: why.to_owned(),
            unix_s: clock::unix_time_s(),
        });
        self
    }
}
