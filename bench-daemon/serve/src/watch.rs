//! Watches a run from outside through its folder: journal, readings and transcripts are read as
//! they grow. The run does not depend on this and never waits for it.

mod condition;
mod measured;
mod position;
mod run_files;
mod run_plan;

use std::{collections::BTreeMap, path::Path};

use analysis::run_folder::{self, EnvelopeRow, ReadingRow};

use super::{
    live::{PointNow, QuestionNow, ReadingNow, RunNow, Soc},
    transcript_monitor::TranscriptMonitor,
};
use bench_core::{
    journal::{Entry, Line},
    operator::run_control::RunAction,
};
use bench_plan::{config::Experiment, plan::Step};
use condition::Condition;
use measured::Measured;
use position::Position;
use run_files::RunFiles;
use run_plan::{RunPlan, points};

/// A run folder that is watched.
#[derive(Debug)]
pub struct Watch {
    files: RunFiles,
    run: RunPlan,
    position: Position,
    condition: Condition,
    measured: Measured,
    /// Bench time of the last entry or reading, s.
    latest_s: f64,
    monitors: BTreeMap<&'static str, TranscriptMonitor>,
}

impl Watch {
    /// A run folder that may not be there yet.
    pub fn new(folder: &Path) -> Self {
        Self::of(RunFiles::new(folder))
    }

    fn of(files: RunFiles) -> Self {
        Self {
            files,
            run: RunPlan::unknown(),
            position: Position::default(),
            condition: Condition::default(),
            measured: Measured::default(),
            latest_s: 0.0,
            monitors: BTreeMap::new(),
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        self.files.folder()
    }

    /// Returns the active experiment once the journal contains it.
    pub fn experiment(&self) -> Option<&Experiment> {
        self.run.experiment.as_ref()
    }

    /// The instrument of a role.
    pub fn monitor(&self, role: &str) -> Option<&TranscriptMonitor> {
        self.monitors.get(role)
    }

    /// Reads on.
    pub fn look(&mut self) {
        if let Some(files) = self.files.replaced() {
            // The run was simulated again from its seed: earlier state is no longer valid.
            *self = Self::of(files);
        }
        while let Some(lines) = self.files.journal() {
            lines
                .iter()
                .filter_map(|line| serde_json::from_str::<Line>(line).ok())
                .for_each(|line| self.entry(line));
        }
        while let Some(rows) = self.files.readings() {
            rows.iter().for_each(|row| self.read(row));
        }
        if let Some(bounds) = self.files.envelope() {
            self.measured.bounds = Some(bounds);
        }
        self.files.read_request();
        self.monitors.values_mut().for_each(TranscriptMonitor::look);
    }

    fn entry(&mut self, line: Line) {
        self.latest_s = self.latest_s.max(line.time_s.0);
        self.condition.take(&line);
        match line.entry {
            Entry::Started(started) => {
                let folder = self.files.folder();
                self.run = RunPlan::of(folder, &started);
                let experiment = self.run.experiment.iter();
                self.monitors = experiment
                    .flat_map(|experiment| experiment.bench.instruments.addressed())
                    .map(|(role, instrument)| {
                        let monitor = TranscriptMonitor::new(folder, role, &instrument.model);
                        (role, monitor)
                    })
                    .collect();
            }
            Entry::Stage { stage } => self.position.begin_stage(stage, line.time_s.0),
            Entry::Intent {
                stage, step, text, ..
            } => self.position.begin_step(stage, step, line.time_s.0, text),
            Entry::Done { stage, step } => self.position.end_step(stage, step, false),
            Entry::Point(point) => self.position.end_step(point.stage, point.step, true),
            Entry::StageDone { stage } => self.position.end_stage(stage),
            Entry::Paused
            | Entry::Asked(_)
            | Entry::Answered(_)
            | Entry::GoneOn
            | Entry::Resumed { .. }
            | Entry::Ended { .. }
            | Entry::Safe
            | Entry::Note(_)
            | Entry::Charge { .. }
            | Entry::ChargeUnknown { .. }
            | Entry::Instruments(_)
            | Entry::Found(_) => {}
        }
    }

    fn read(&mut self, line: &str) {
        let Some(row) = ReadingRow::parse(line) else {
            return;
        };
        // The journal is read before the readings, and may be ahead of them.
        let stage = self.position.stage_at(row.time_s);
        let fixture = stage.and_then(|stage| self.run.fixture(stage));
        let cell = self.run.experiment.as_ref();
        let cell = cell.map(|experiment| &experiment.cell);
        self.measured.take(&row, fixture, cell);
        self.latest_s = self.latest_s.max(row.time_s);
    }

    /// Returns the last reading; `going` states whether the run's process lives. A reading of an
    /// earlier process is not fresh.
    pub fn reading(&self, going: bool) -> Option<ReadingNow> {
        self.measured
            .reading(going.then_some(self.condition.process_s))
    }

    /// Returns the bounds of the readings in the present step of the process that lives.
    pub fn envelope(&self) -> Option<&EnvelopeRow> {
        let is_present = |row: &&EnvelopeRow| row.time_s >= self.condition.process_s;
        self.measured.bounds.as_ref().filter(is_present)
    }

    /// The state of charge, while the cell is in the jig.
    pub fn soc(&self) -> Option<Soc> {
        self.measured.soc()
    }

    /// It waits on request.
    pub fn paused(&self) -> bool {
        self.condition.paused
    }

    /// The question that waits for a person.
    pub fn question(&self) -> Option<QuestionNow> {
        self.condition.question.clone()
    }

    /// How it ended, if it did.
    pub fn ended(&self) -> Option<&str> {
        self.condition.ended.as_deref()
    }

    /// Returns the state of the run; `going` states whether its process lives.
    pub fn now(&self, run: Option<String>, going: bool) -> RunNow {
        let stages = &self.run.plan.stages;
        let at = self.position.at;
        let (stage_number, step_number) = at.map_or((0, 0), |at| (at.stage + 1, at.step + 1));
        let stage = at.and_then(|at| stages.get(at.stage));
        let step = at.and_then(|at| stage?.steps.get(at.step));
        let point = match (stage, step) {
            (Some(stage), Some(Step::Sine { index, freq_hz, .. })) => Some(PointNow {
                number: index + 1,
                of: points(stage),
                freq_hz: freq_hz.0,
            }),
            _ => None,
        };
        let expected = self.position.expected(&self.run.plan, self.latest_s);
        // A person may take as long as that takes.
        let is_known = going && expected.total_s > 0.0 && self.condition.question.is_none();
        let is_waiting = self.condition.paused || self.condition.question.is_some();
        let pausing = going && !is_waiting && self.files.request() == RunAction::Pause;
        let step_left_s = self.position.step_left_s(&self.run.plan, self.latest_s);
        let ended = self.condition.ended.clone();
        RunNow {
            run,
            experiment: self.run.name.clone(),
            going,
            stopped: ended.as_deref().is_some_and(run_folder::is_stopped),
            ended,
            pausing,
            step_left_s: step_left_s
                .and_then(|left_s| self.run.on_the_wall_s(left_s))
                .filter(|_| going),
            stage: stage.map_or_else(String::new, |stage| stage.purpose.to_string()),
            stage_number,
            stages: stages.len(),
            step: self.position.text.clone(),
            step_number,
            steps: stage.map_or(0, |stage| stage.steps.len()),
            point,
            points_done: self.position.points_done(),
            points: self.run.points(),
            done: expected.done(),
            left_s: self.run.on_the_wall_s(expected.left_s).filter(|_| is_known),
            bench_time_s: self.latest_s,
            time: self.run.time.clone(),
            safe: self.condition.safe,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::plan::{Plan, Purpose};
    use instruments::fixture::Fixture;
    use instruments::units::Seconds;

    /// The fake cell from 10 s on, the cell from 20 s on.
    fn changed() -> Watch {
        let stage = |fixture, number| bench_plan::plan::Stage {
            purpose: Purpose::Sweep(fixture, number),
            steps: Vec::new(),
        };
        let plan = Plan {
            stages: vec![stage(Fixture::FakeCell, 0), stage(Fixture::Cell, 1)],
        };
        let mut watch = Watch::new(Path::new("none"));
        watch.run.plan = plan;
        tell(&mut watch, 10.0, Entry::Stage { stage: 0 });
        tell(&mut watch, 20.0, Entry::Stage { stage: 1 });
        watch
    }

    fn tell(watch: &mut Watch, time_s: f64, entry: Entry) {
        watch.entry(Line {
            number: 1,
            time_s: Seconds(time_s),
            entry,
        });
    }

    #[test]
    fn what_was_read_of_one_fixture_is_never_shown_of_another() {
        let mut watch = changed();
        let mut read = |line: &str| {
            watch.read(line);
            let reading = watch.reading(true).unwrap();
            (
                reading.fixture,
                reading.voltage_v,
                reading.current_a,
                reading.temperature_degc,
            )
        };
        let fake = || "fake_cell".to_owned();
        // The journal is ahead of the readings.
        assert_eq!(
            read("18,sine,0.01,1.5,"),
            (fake(), Some(0.01), Some(1.5), None)
        );
        assert_eq!(
            read("19,sine,,,25.0"),
            (fake(), Some(0.01), Some(1.5), Some(25.0))
        );
        assert_eq!(
            read("21,rest,,,25.1"),
            ("cell".to_owned(), None, None, Some(25.1))
        );
        assert_eq!(
            read("22,rest,3.6,0,"),
            ("cell".to_owned(), Some(3.6), Some(0.0), Some(25.1))
        );
    }

    #[test]
    fn an_end_after_safe_state_is_safe_and_another_process_makes_readings_old() {
        let mut watch = changed();
        let ended = || Entry::Ended {
            how: "stopped".to_owned(),
        };
        tell(&mut watch, 30.0, ended());
        assert!(
            !watch.now(None, false).safe,
            "no entry says that it is safe"
        );
        tell(&mut watch, 31.0, Entry::Safe);
        tell(&mut watch, 32.0, ended());
        assert!(watch.now(None, false).safe);
        watch.read("29,rest,3.6,0,25");
        assert!(watch.reading(true).unwrap().fresh && !watch.reading(false).unwrap().fresh);
        tell(
            &mut watch,
            40.0,
            Entry::Resumed {
                text: String::new(),
            },
        );
        assert!(!watch.reading(true).unwrap().fresh && !watch.now(None, true).safe);
        watch.read("41,rest,3.6,0,25");
        assert!(watch.reading(true).unwrap().fresh);
    }
}
