//! Watches a run from outside through its folder: journal, readings and transcripts are read as
//! they grow. The run knows nothing of it and never waits for it.

use std::{
    collections::BTreeMap,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
};

use analysis::run_folder::{JOURNAL, READINGS, ReadingRow};
use instruments::{clock::TimeMode, fixture::Fixture};

use super::{
    follow::Follow,
    live::{PointNow, ReadingNow, RunNow, Soc},
    transcript_monitor::TranscriptMonitor,
};
use crate::{
    config::Experiment,
    interlock::NO_CURRENT_A,
    journal::{Entry, Line},
    plan::{Plan, Purpose, Step, fixture_name},
    procedure,
    run::begun_experiment,
};

/// A run folder that is watched.
#[derive(Debug)]
pub struct Watch {
    folder: PathBuf,
    inode: u64,
    journal: Follow,
    readings: Follow,
    /// Experiment that runs, once the journal tells it.
    pub experiment: Option<Experiment>,
    plan: Option<Plan>,
    factor: Option<f64>,
    time: String,
    name: String,
    stages: BTreeMap<usize, Stage>,
    /// Stage and step in work, and the bench time at which the step was begun, s.
    at: Option<(usize, usize, f64)>,
    /// Stages with the bench time at which each was begun, s, in order.
    begun: Vec<(f64, usize)>,
    /// Bench time at which the process that runs it, or ran it last, began, s.
    process_s: f64,
    latest_s: f64,
    paused: bool,
    safe: bool,
    ended: Option<String>,
    last_text: String,
    reading: Option<ReadingNow>,
    soc: Option<Soc>,
    /// The instruments, by role.
    pub monitors: BTreeMap<&'static str, TranscriptMonitor>,
}

#[derive(Debug, Default)]
struct Stage {
    done: BTreeMap<usize, bool>,
    finished: bool,
}

impl Watch {
    /// A run folder that may not be there yet.
    pub fn new(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            inode: 0,
            journal: Follow::new(folder.join(JOURNAL)),
            readings: Follow::new(folder.join(READINGS)),
            experiment: None,
            plan: None,
            factor: None,
            time: String::new(),
            name: String::new(),
            stages: BTreeMap::new(),
            at: None,
            begun: Vec::new(),
            process_s: 0.0,
            latest_s: 0.0,
            paused: false,
            safe: false,
            ended: None,
            last_text: String::new(),
            reading: None,
            soc: None,
            monitors: BTreeMap::new(),
        }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Reads on.
    pub fn look(&mut self) {
        let inode = std::fs::metadata(self.folder.join(JOURNAL)).map_or(0, |meta| meta.ino());
        if inode != self.inode && self.inode != 0 {
            // Played again from its seed: another run stands in its place.
            *self = Self::new(&self.folder.clone());
        }
        self.inode = inode;
        // What cannot be read now is read at the next look.
        while let Some(lines) = grown(&mut self.journal) {
            lines
                .iter()
                .filter_map(|line| serde_json::from_str::<Line>(line).ok())
                .for_each(|line| self.entry(line));
        }
        while let Some(lines) = grown(&mut self.readings) {
            lines.iter().for_each(|line| self.read(line));
        }
        self.monitors.values_mut().for_each(TranscriptMonitor::look);
    }

    fn entry(&mut self, line: Line) {
        self.latest_s = self.latest_s.max(line.time_s);
        self.ended = None;
        self.safe = matches!(line.entry, Entry::Safe | Entry::Paused)
            || (self.safe && matches!(line.entry, Entry::Note(_) | Entry::Ended { .. }));
        match line.entry {
            Entry::Started(started) => {
                let time = started.time.parse::<TimeMode>().unwrap_or(TimeMode::Real);
                self.factor = match time {
                    TimeMode::Real => Some(1.0),
                    TimeMode::Scaled(factor) => Some(factor),
                    TimeMode::Virtual => None,
                };
                (self.time, self.name) = (started.time.clone(), started.experiment.clone());
                self.experiment = begun_experiment(&self.folder, &started).ok();
                self.plan = self.experiment.as_ref().map(procedure::plan);
                let roles = self
                    .experiment
                    .iter()
                    .flat_map(|experiment| experiment.bench.instruments.addressed());
                self.monitors = roles
                    .map(|(role, _)| (role, TranscriptMonitor::new(&self.folder, role)))
                    .collect();
            }
            Entry::Stage { stage } => {
                *self.stages.entry(stage).or_default() = Stage::default();
                self.begun.push((line.time_s, stage));
                (self.at, self.last_text) = (Some((stage, 0, line.time_s)), String::new());
            }
            Entry::Intent {
                stage, step, text, ..
            } => (self.at, self.last_text) = (Some((stage, step, line.time_s)), text),
            Entry::Done { stage, step } => drop(
                self.stages
                    .entry(stage)
                    .or_default()
                    .done
                    .insert(step, false),
            ),
            Entry::Point(point) => drop(
                self.stages
                    .entry(point.stage)
                    .or_default()
                    .done
                    .insert(point.step, true),
            ),
            Entry::StageDone { stage } => self.stages.entry(stage).or_default().finished = true,
            Entry::Paused => self.paused = true,
            Entry::GoneOn => self.paused = false,
            Entry::Resumed { .. } => (self.paused, self.process_s) = (false, line.time_s),
            Entry::Ended { how } => self.ended = Some(how),
            Entry::Safe | Entry::Note(_) | Entry::Found(_) => {}
        }
    }

    fn read(&mut self, line: &str) {
        let Some(row) = ReadingRow::parse(line) else {
            return;
        };
        let (time_s, phase) = (row.time_s, row.phase);
        let (voltage_v, current_a, temperature_c) =
            (row.voltage_v, row.current_a, row.temperature_c);
        let before = self.reading.take();
        let fixture = self.fixture_at(time_s).map_or("cell", fixture_name);
        let now = ReadingNow {
            time_s,
            phase: phase.to_owned(),
            fixture: fixture.to_owned(),
            voltage_v,
            current_a,
            temperature_c,
            fresh: true,
        };
        self.count(&now, before.as_ref());
        self.latest_s = self.latest_s.max(time_s);
        let kept_c = before.as_ref().and_then(|before| before.temperature_c);
        let (voltage_v, current_a) = match (voltage_v, current_a, &before) {
            // Some readings are of the temperature only. What was read of another thing in the jig
            // says nothing of this one.
            (None, None, Some(before)) if before.fixture == fixture => {
                (before.voltage_v, before.current_a)
            }
            _ => (voltage_v, current_a),
        };
        self.reading = Some(ReadingNow {
            voltage_v,
            current_a,
            temperature_c: temperature_c.or(kept_c),
            ..now
        });
    }

    /// The state of charge: from the voltage at rest, and from there on by the charge that was
    /// read. In a sweep no net charge flows, and its readings are means over a part of a period.
    fn count(&mut self, now: &ReadingNow, before: Option<&ReadingNow>) {
        let (time_s, phase) = (now.time_s, now.phase.as_str());
        let Some(experiment) = self.experiment.as_ref().filter(|_| {
            self.fixture_at(time_s)
                .is_none_or(|fixture| fixture == Fixture::Cell)
        }) else {
            return;
        };
        let (Some(volts), Some(amps)) = (now.voltage_v, now.current_a) else {
            return;
        };
        let rests = matches!(phase, "rest" | "idle" | "paused") && amps.abs() < NO_CURRENT_A;
        let found = experiment
            .cell
            .ocv
            .as_ref()
            .filter(|_| rests)
            .and_then(|curve| curve.soc_at(volts));
        if let Some(share) = found {
            self.soc = Some(Soc {
                share,
                counted_c: 0.0,
            });
        } else if let (Some(soc), Some(before)) = (&mut self.soc, before)
            && phase != "sine"
            && before.phase == phase
        {
            let moved_c =
                0.5 * (amps + before.current_a.unwrap_or(amps)) * (time_s - before.time_s);
            soc.share += moved_c / experiment.cell.capacity_c;
            soc.counted_c += moved_c;
        }
    }

    /// The last reading; `going` states whether the run's process lives. One of an earlier process
    /// is not fresh.
    pub fn reading(&self, going: bool) -> Option<ReadingNow> {
        let reading = self.reading.clone()?;
        Some(ReadingNow {
            fresh: going && reading.time_s >= self.process_s,
            ..reading
        })
    }

    /// The state of charge, while the cell is in the jig.
    pub fn soc(&self) -> Option<Soc> {
        self.soc
    }

    /// Fixture in the jig at a bench time in s, as far as the stages tell. The journal is read
    /// before the readings, and may be ahead of them.
    fn fixture_at(&self, time_s: f64) -> Option<Fixture> {
        let (_, stage) = self
            .begun
            .iter()
            .rev()
            .find(|(begun_s, _)| *begun_s <= time_s)?;
        match self.plan.as_ref()?.stages.get(*stage)?.purpose {
            Purpose::Sweep(fixture, _) => Some(fixture),
            _ => Some(Fixture::Cell),
        }
    }

    /// It waits on request.
    pub fn paused(&self) -> bool {
        self.paused
    }

    /// How it ended, if it did.
    pub fn ended(&self) -> Option<&str> {
        self.ended.as_deref()
    }

    /// Where it is; `going` states whether its process lives.
    pub fn now(&self, run: Option<String>, going: bool) -> RunNow {
        let none = Plan { stages: Vec::new() };
        let plan = self.plan.as_ref().unwrap_or(&none);
        let (stage_number, step_number) = self
            .at
            .map_or((0, 0), |(stage, step, _)| (stage + 1, step + 1));
        let stage = self.at.and_then(|(stage, ..)| plan.stages.get(stage));
        let steps = stage.map_or(&[][..], |stage| &stage.steps);
        let sines = |steps: &[Step]| {
            steps
                .iter()
                .filter(|step| matches!(step, Step::Sine { .. }))
                .count()
        };
        let point = self.at.and_then(|(_, step, _)| match steps.get(step) {
            Some(Step::Sine { index, freq_hz, .. }) => Some(PointNow {
                number: index + 1,
                of: sines(steps),
                freq_hz: *freq_hz,
            }),
            _ => None,
        });
        let (total_s, left_s) = self.left(plan);
        RunNow {
            run,
            experiment: self.name.clone(),
            going,
            ended: self.ended.clone(),
            stage: stage.map_or_else(String::new, |stage| stage.purpose.to_string()),
            stage_number,
            stages: plan.stages.len(),
            step: self.last_text.clone(),
            step_number,
            steps: steps.len(),
            point,
            points_done: self
                .stages
                .values()
                .flat_map(|stage| stage.done.values())
                .filter(|point| **point)
                .count(),
            points: plan.stages.iter().map(|stage| sines(&stage.steps)).sum(),
            done: if total_s > 0.0 {
                1.0 - left_s / total_s
            } else {
                0.0
            },
            left_s: self
                .factor
                .filter(|_| going && total_s > 0.0)
                .map(|factor| (left_s / factor).round()),
            bench_time_s: self.latest_s,
            time: self.time.clone(),
            safe: self.safe,
        }
    }

    /// Expected bench time of the whole plan, and of what is left of it, s.
    fn left(&self, plan: &Plan) -> (f64, f64) {
        let (mut total_s, mut left_s) = (0.0, 0.0);
        for (number, stage) in plan.stages.iter().enumerate() {
            let known = self.stages.get(&number);
            for (index, step) in stage.steps.iter().enumerate() {
                let expected_s = step.expected_s();
                total_s += expected_s;
                if known.is_some_and(|known| known.finished || known.done.contains_key(&index)) {
                    continue;
                }
                let spent_s = self
                    .at
                    .filter(|at| (at.0, at.1) == (number, index))
                    .map_or(0.0, |(_, _, began_s)| self.latest_s - began_s);
                left_s += (expected_s - spent_s).max(0.0);
            }
        }
        (total_s, left_s)
    }
}

/// Whole lines that are new, where there are any.
fn grown(file: &mut Follow) -> Option<Vec<String>> {
    file.look()
        .ok()
        .map(|grown| grown.lines)
        .filter(|lines| !lines.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fake cell from 10 s on, the cell from 20 s on.
    fn changed() -> Watch {
        let stage = |fixture, number| crate::plan::Stage {
            purpose: Purpose::Sweep(fixture, number),
            steps: Vec::new(),
        };
        let plan = Plan {
            stages: vec![stage(Fixture::FakeCell, 0), stage(Fixture::Cell, 1)],
        };
        let mut watch = Watch {
            plan: Some(plan),
            ..Watch::new(Path::new("none"))
        };
        tell(&mut watch, 10.0, Entry::Stage { stage: 0 });
        tell(&mut watch, 20.0, Entry::Stage { stage: 1 });
        watch
    }

    fn tell(watch: &mut Watch, time_s: f64, entry: Entry) {
        watch.entry(Line {
            number: 1,
            time_s,
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
                reading.temperature_c,
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
        assert!(!watch.now(None, false).safe, "nobody said that it is");
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
