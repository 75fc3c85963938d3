//! An investigation as it is written.

use analysis::diagnosis::{Diagnosis, NextExperiment, Verdict};
use serde::Serialize;

/// Budget after the first campaign.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Budget {
    /// Time on the bench, min.
    pub minutes: f64,
    /// Charge moved in either direction, Ah.
    pub charge_ah: f64,
}

/// How an investigation ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum End {
    /// The missing effect has a name.
    Explained,
    /// Nothing is missing.
    AtNoiseFloor,
    /// The data cannot be used.
    Invalid,
    /// No run of the menu that this bench can play and that was not played yet would tell more.
    NoExperiment,
    /// The rest of the budget does not pay for a run that might tell more.
    Budget,
}

/// A run that was bought to settle what was open.
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
    /// The experiment; none for the first campaign.
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
#[derive(Debug, Clone, Serialize)]
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
    /// The end in words.
    pub end_text: String,
    /// Points that the quality gate has refused to the end, of all runs.
    pub refused_points: usize,
    /// The last diagnosis.
    pub diagnosis: Diagnosis,
}

impl Step {
    /// Name of the run that was bought.
    pub(super) fn bought(&self) -> Option<&'static str> {
        self.bought.as_ref().map(|bought| bought.experiment.name)
    }
}
