//! The run that is watched, as its journal begins.

use std::path::Path;

use instruments::{clock::TimeMode, fixture::Fixture};

use bench_core::journal::Started;
use bench_evaluate::run::begun_experiment;
use bench_plan::{
    config::Experiment,
    plan::{Plan, Purpose, Stage, Step},
    procedure,
};

/// Experiment and plan of a run.
#[derive(Debug)]
pub(super) struct RunPlan {
    /// Name of the experiment.
    pub(super) name: String,
    /// How bench time runs, as the journal says it.
    pub(super) time: String,
    /// Bench time that passes in one second on the wall, s; none in virtual time.
    factor: Option<f64>,
    /// The experiment, if it can be read.
    pub(super) experiment: Option<Experiment>,
    /// Its plan; without stages if it is unknown.
    pub(super) plan: Plan,
}

impl RunPlan {
    /// Returns an unknown plan.
    pub(super) fn unknown() -> Self {
        Self {
            name: String::new(),
            time: String::new(),
            factor: None,
            experiment: None,
            plan: Plan { stages: Vec::new() },
        }
    }

    /// The run in a folder, by the first entry of its journal.
    pub(super) fn of(folder: &Path, started: &Started) -> Self {
        let time = started.time.parse::<TimeMode>().unwrap_or(TimeMode::Real);
        let experiment = begun_experiment(folder, started).ok();
        let unknown = Self::unknown();
        Self {
            name: started.experiment.clone(),
            time: started.time.clone(),
            factor: match time {
                TimeMode::Real => Some(1.0),
                TimeMode::Scaled(factor) => Some(factor),
                TimeMode::Virtual => None,
            },
            plan: experiment.as_ref().map_or(unknown.plan, procedure::plan),
            experiment,
        }
    }

    /// Bench time, s, as whole seconds on the wall; none in virtual time.
    pub(super) fn on_the_wall_s(&self, bench_s: f64) -> Option<f64> {
        self.factor.map(|factor| (bench_s / factor).round())
    }

    /// Fixture in the jig in a stage.
    pub(super) fn fixture(&self, stage: usize) -> Option<Fixture> {
        match self.plan.stages.get(stage)?.purpose {
            Purpose::Sweep(fixture, _) => Some(fixture),
            _ => Some(Fixture::Cell),
        }
    }

    /// How many points all sweeps have.
    pub(super) fn points(&self) -> usize {
        self.plan.stages.iter().map(points).sum()
    }
}

/// How many points the sweep of a stage has.
pub(super) fn points(stage: &Stage) -> usize {
    let is_point = |step: &&Step| matches!(step, Step::Sine { .. });
    stage.steps.iter().filter(is_point).count()
}
