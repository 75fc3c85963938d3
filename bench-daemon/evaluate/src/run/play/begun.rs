//! A run in progress.

use analysis::calibration::Correction;
use instruments::clock::Clock;

use super::super::ResumeContext;
use bench_core::{operator::Operator, record::Recorder, sim::Simulation};
use bench_plan::{config::Experiment, plan::Checked};

pub(crate) struct Run<'a> {
    pub(crate) experiment: &'a Experiment,
    pub(crate) plan: &'a Checked,
    pub(crate) clock: Clock,
    pub(crate) operator: Operator,
    pub(crate) recorder: Recorder,
    /// The simulated world, and the correction if that of an earlier run is to be kept.
    pub(crate) before: (Option<Simulation>, Option<Correction>),
    /// Whether an earlier run has used this simulated world.
    pub(crate) inherited_world: bool,
    /// Finished part of this run, if its process died or was stopped before.
    pub(crate) context: Option<ResumeContext>,
}
