//! The result file of an investigation.

use analysis::diagnosis::{Diagnosis, NextExperiment, Verdict};
use serde::Serialize;

use super::rule::{Budget, End};
use crate::support::present::significant;
use bench_core::safety::failure::Failure;

/// Reason why a run was not executed in the end. Later variants are closer to execution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WhyNot {
    /// It can be executed, but gives no information on the open questions.
    TellsNothing,
    /// It was executed as often as allowed.
    Played,
    /// It costs more than the remaining budget.
    Cost,
    /// Bench, cell or experiment file do not allow it.
    Limit,
}

impl WhyNot {
    /// In words.
    pub fn label(self) -> &'static str {
        match self {
            Self::Cost => "cost",
            Self::Limit => "limit",
            Self::Played => "played already",
            Self::TellsNothing => "adds no information",
        }
    }
}

/// A run of the menu that was not executed in the end.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NotPlayed {
    /// Name in the menu.
    pub run: String,
    /// Kind of reason.
    pub why: WhyNot,
    /// The reason in words.
    pub detail: String,
}

impl NotPlayed {
    /// Returns the cells of the table: run, reason, detail, without names of the code, the
    /// position in the plan and superfluous digits.
    pub fn cells(&self) -> [String; 3] {
        let detail = match self.detail.split_once("): ") {
            Some((place, reason)) if place.starts_with("stage ") => reason,
            _ => self.detail.as_str(),
        };
        let word = |word: &str| match word.parse::<f64>() {
            Ok(value) if word.contains('.') => significant(value, 3),
            _ => word.to_owned(),
        };
        [
            self.run.replace('_', " "),
            self.why.label().to_owned(),
            detail.split(' ').map(word).collect::<Vec<_>>().join(" "),
        ]
    }
}

/// A run that was executed to settle open questions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FollowUpRun {
    /// Experiment that was recommended.
    pub experiment: NextExperiment,
    /// Time that it took on the bench, min.
    pub minutes: f64,
}

/// One measurement and what follows from everything measured until then.
#[derive(Debug, Clone, Serialize)]
pub struct Step {
    /// Run folder beside the investigation's files.
    pub folder: String,
    /// The experiment; `None` for the first campaign.
    pub bought: Option<FollowUpRun>,
    /// Verdict.
    pub verdict: Verdict,
    /// Names given.
    pub effects: Vec<&'static str>,
    /// Names that could stand for them.
    pub rivals: Vec<&'static str>,
    /// In words.
    pub summary: String,
}

/// An investigation as it is written.
#[derive(Debug, Serialize)]
pub struct Investigation {
    /// Name of the schema.
    pub schema: &'static str,
    /// Name of the experiment.
    pub name: String,
    /// Budget that might be spent.
    pub budget: Budget,
    /// Part of it that was spent.
    pub spent: Budget,
    /// Measurements and verdicts in order.
    pub steps: Vec<Step>,
    /// How it ended.
    pub end: End,
    /// The end in one sentence.
    pub end_text: String,
    /// Runs of the menu that were not executed in the end; empty if no question was open.
    pub not_played: Vec<NotPlayed>,
    /// Points that the quality gate has refused to the end, of all runs.
    pub refused_points: usize,
    /// The last diagnosis.
    pub diagnosis: Diagnosis,
    /// Error of a run that ended early, which ended the investigation.
    #[serde(skip)]
    pub failure: Option<Failure>,
}

impl Step {
    /// Name of the run that was bought.
    pub(super) fn bought(&self) -> Option<&'static str> {
        self.bought.as_ref().map(|bought| bought.experiment.name)
    }
}
