//! How far a run is in its plan.

use std::collections::BTreeMap;

use bench_plan::plan::Plan;

/// Stages and steps that were begun and done.
#[derive(Debug, Default)]
pub(super) struct Position {
    stages: BTreeMap<usize, StageDone>,
    /// Stage and step in work.
    pub(super) at: Option<Place>,
    /// Stages with the bench time at which each was begun, s, in order.
    begun: Vec<(f64, usize)>,
    /// The active step, as text.
    pub(super) text: String,
}

/// Stage and step in work.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// Number of the stage, from 0.
    pub(super) stage: usize,
    /// Number of the step in it, from 0.
    pub(super) step: usize,
    /// Bench time at which the step was begun, s.
    begun_s: f64,
}

/// Steps of a stage that are done, and whether each is a point of a sweep.
#[derive(Debug, Default)]
struct StageDone {
    steps: BTreeMap<usize, bool>,
    finished: bool,
}

/// Expected bench time of a plan, s.
#[derive(Debug, Clone, Copy)]
pub(super) struct ExpectedTime {
    /// Time of the whole plan, s.
    pub(super) total_s: f64,
    /// Time of the remaining part, s.
    pub(super) left_s: f64,
}

impl ExpectedTime {
    /// Share of the plan that is done.
    pub(super) fn done(&self) -> f64 {
        if self.total_s > 0.0 {
            1.0 - self.left_s / self.total_s
        } else {
            0.0
        }
    }
}

impl Position {
    /// A stage begins, or begins again.
    pub(super) fn begin_stage(&mut self, stage: usize, time_s: f64) {
        self.stages.insert(stage, StageDone::default());
        self.begun.push((time_s, stage));
        self.begin_step(stage, 0, time_s, String::new());
    }

    /// A step begins.
    pub(super) fn begin_step(&mut self, stage: usize, step: usize, time_s: f64, text: String) {
        self.at = Some(Place {
            stage,
            step,
            begun_s: time_s,
        });
        self.text = text;
    }

    /// A step is done; `point` states whether it is a point of a sweep.
    pub(super) fn end_step(&mut self, stage: usize, step: usize, point: bool) {
        let stage = self.stages.entry(stage).or_default();
        stage.steps.insert(step, point);
    }

    /// A stage is done.
    pub(super) fn end_stage(&mut self, stage: usize) {
        self.stages.entry(stage).or_default().finished = true;
    }

    /// Returns the active stage at a bench time, s, as far as the journal contains it.
    pub(super) fn stage_at(&self, time_s: f64) -> Option<usize> {
        let mut last = self.begun.iter().rev();
        last.find(|(begun_s, _)| *begun_s <= time_s)
            .map(|(_, stage)| *stage)
    }

    /// Points that are finished, of all sweeps.
    pub(super) fn points_done(&self) -> usize {
        let steps = self.stages.values().flat_map(|stage| stage.steps.values());
        steps.filter(|point| **point).count()
    }

    /// Returns the expected bench time until the end of the active step at a bench time, s.
    pub(super) fn step_left_s(&self, plan: &Plan, now_s: f64) -> Option<f64> {
        let at = self.at?;
        let step = plan.stages.get(at.stage)?.steps.get(at.step)?;
        Some((step.expected_s().value() - (now_s - at.begun_s)).max(0.0))
    }

    /// Returns the expected bench time of a plan, and of its remaining part at a bench time, s.
    pub(super) fn expected(&self, plan: &Plan, now_s: f64) -> ExpectedTime {
        let (mut total_s, mut left_s) = (0.0, 0.0);
        for (number, stage) in plan.stages.iter().enumerate() {
            let known = self.stages.get(&number);
            for (index, step) in stage.steps.iter().enumerate() {
                let expected_s = step.expected_s().value();
                total_s += expected_s;
                if known.is_some_and(|known| known.finished || known.steps.contains_key(&index)) {
                    continue;
                }
                let spent_s = self
                    .at
                    .filter(|at| (at.stage, at.step) == (number, index))
                    .map_or(0.0, |at| now_s - at.begun_s);
                left_s += (expected_s - spent_s).max(0.0);
            }
        }
        ExpectedTime { total_s, left_s }
    }
}
