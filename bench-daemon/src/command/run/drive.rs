//! A plan played stage by stage: controls are judged and the correction is made from them, sweeps and traces go into the index.

use std::collections::{
    BTreeMap,
    btree_map::Entry::{Occupied, Vacant},
};

use analysis::{
    calibration::Correction,
    dataset::{self, SweepEntry},
    spectrum::Spectrum,
};
use instruments::{
    clock::{Clock, TimeMode},
    mock::plant::Fixture,
};

use super::{
    Measured, Past, multisine, safe,
    sweeping::{self, Settled, Sweeping},
};
use crate::{
    bench::Bench,
    command::Failure,
    config::Experiment,
    executor::{Entrance, ExecuteError, Executor, SweepPoint},
    fixture_check,
    journal::{Entry, PointDone},
    operator::Operator,
    plan::{Checked, Plan, Purpose, Stage, fixture_name},
    progress::Progress,
    record::{RecordError, Recorder},
    wishes::{self, Wishes},
};

/// What came before: the correction of another run on the same bench, or the part of this one that was done before its process died.
pub(super) struct Before<'a> {
    pub(super) inherited: Option<Correction>,
    pub(super) past: Option<&'a Past>,
}

/// Executes the plan, stage by stage, and judges the controls as soon as they are measured.
pub(super) async fn drive(
    (bench, recorder): (&mut Bench, &mut Recorder),
    experiment: &Experiment,
    plan: &Checked,
    (clock, operator, progress): (&Clock, &Operator, &Progress),
    before: Before<'_>,
) -> Result<Measured, Failure> {
    safe(bench.safe_state().await, Ok(()))?;
    recorder.journal(Entry::Safe)?;
    let Before { inherited, past } = before;
    let measured = Measured {
        controls: Vec::new(),
        sweeps: BTreeMap::new(),
        correction: inherited.clone().unwrap_or_else(|| Correction::none(experiment.bench.wiring.shunt)),
        spectrum: Spectrum { name: experiment.name.clone(), points: Vec::new() },
        repeats: Vec::new(),
        own_noise: Vec::new(),
        points: Vec::new(),
        campaign: experiment.campaign.is_some(),
        multisines: Vec::new(),
    };
    recorder.about(&experiment.cell.name, experiment.cell.capacity_c);
    let mut executor = Executor::new((bench, recorder), experiment, clock.clone(), (operator, progress));
    if let Some(correction) = inherited {
        executor.recorder.json("correction.json", &correction)?;
        executor.correction = correction;
    }
    let mut drive = Drive { executor, experiment, plan: plan.plan(), past, measured, settled: BTreeMap::new() };
    drive.restore()?;
    drive.play().await?;
    let Drive { executor, mut measured, settled, .. } = drive;
    for (place, Settled { points, spectrum, own_noise }) in settled.into_values().enumerate() {
        if place == 0 {
            measured.spectrum = spectrum;
        } else {
            measured.repeats.push(spectrum);
        }
        measured.points.push(points);
        measured.own_noise.push(own_noise);
    }
    if !measured.spectrum.points.is_empty() {
        dataset::write_spectrum_parquet(&executor.recorder.path("spectrum.parquet"), &measured.spectrum.points)
            .map_err(crate::record::RecordError::from)?;
    }
    Ok(measured)
}

struct Drive<'a, 'b> {
    executor: Executor<'a>,
    experiment: &'a Experiment,
    plan: &'b Plan,
    past: Option<&'b Past>,
    measured: Measured,
    /// Sweeps of the cell, by their numbers.
    settled: BTreeMap<usize, Settled>,
}

impl<'a, 'b> Drive<'a, 'b> {
    /// What finished stages have given, from the run folder.
    fn restore(&mut self) -> Result<(), Failure> {
        let Some(past) = self.past else { return Ok(()) };
        let latest = past.story.latest.and_then(|number| self.plan.stages.get(number)).and_then(Stage::specimen).cloned();
        let left_c = past.charge_left_c(self.executor.recorder, self.plan)?;
        self.executor.take_over(latest, left_c);
        for (number, stage) in self.plan.stages.iter().enumerate().filter(|(number, _)| past.story.finished(*number)) {
            if let Purpose::Multisine(repeat) = stage.purpose {
                self.measured.multisines.push(multisine::restore(self.executor.recorder, repeat)?);
            }
            let Purpose::Sweep(fixture, repeat) = stage.purpose else { continue };
            let points: Vec<&PointDone> = past.story.stages.get(&number).map_or_else(Vec::new, |story| story.points.values().collect());
            let sweeping = self.sweeping((fixture, repeat));
            sweeping.restore(self.executor.recorder, &points)?;
            let settled = sweeping.settle(self.executor.recorder, points.into_iter().map(|point| point.point.clone()).collect())?;
            sweeping::flags(&settled.points, &mut |freq_hz, text| {
                self.executor.recorder.known_point_warning(&sweeping.name, freq_hz, text);
            });
            self.finish((fixture, repeat), settled, true)?;
        }
        Ok(())
    }

    /// Everything that is left to do.
    async fn play(&mut self) -> Result<(), Failure> {
        let finished = |number: &usize| self.past.is_some_and(|past| past.story.finished(*number));
        let mut left: Vec<usize> = (0..self.plan.stages.len()).filter(|number| !finished(number)).collect();
        let mut run = None;
        if let Some(Past { next, story, .. }) = self.past {
            run = story.latest.and_then(|latest| self.run_of(latest));
            if let Some(again) = next.again {
                self.stage(again, Entrance::default()).await?;
            }
            if let Some((open, from)) = next.open {
                left.retain(|number| *number != open);
                self.stage(open, Entrance { from, points: self.known(open) }).await?;
            }
        }
        while !left.is_empty() {
            self.reorder(&mut left, run);
            let number = left.remove(0);
            run = self.run_of(number);
            self.stage(number, Entrance::default()).await?;
        }
        Ok(())
    }

    /// Points of a stage that was interrupted.
    fn known(&self, number: usize) -> Vec<&'b PointDone> {
        self.past.and_then(|past| past.story.stages.get(&number)).map_or_else(Vec::new, |story| story.points.values().collect())
    }

    fn run_of(&self, number: usize) -> Option<usize> {
        self.plan.stages.get(number).and_then(Stage::run)
    }

    /// The order that is wanted, once the run in work is done.
    fn reorder(&self, left: &mut [usize], run: Option<usize>) {
        if self.experiment.campaign.is_none() || self.executor.clock.mode() == TimeMode::Virtual {
            return;
        }
        let mut order = Wishes::read(self.executor.recorder.folder()).order;
        order.splice(0..0, run);
        // What is not named comes as it is planned, whatever was wanted before.
        left.sort_unstable();
        // The controls come before every run.
        let controls = left.iter().take_while(|number| self.run_of(**number).is_none()).count();
        wishes::reorder(&mut left[controls..], &order, |number| self.plan.stages.get(*number).and_then(Stage::run));
    }

    /// One stage, and what is made of it.
    async fn stage(&mut self, number: usize, entrance: Entrance<'_>) -> Result<(), Failure> {
        let Some(stage) = self.plan.stages.get(number) else { return Ok(()) };
        match stage.purpose {
            Purpose::Sweep(fixture, repeat) => self.sweep((number, stage), (fixture, repeat), &entrance).await?,
            Purpose::Multisine(repeat) => {
                let run = multisine::measure(&mut self.executor, ((number, stage), repeat), &self.measured).await?;
                self.measured.multisines.push(run);
            }
            Purpose::Temperature | Purpose::SocReset | Purpose::OcvSoc | Purpose::Trace => {
                self.executor.stage((number, stage), &entrance, &mut |_, _| Ok(())).await?;
            }
        }
        Ok(self.executor.recorder.journal(Entry::StageDone { stage: number })?)
    }

    fn sweeping(&self, of: (Fixture, usize)) -> Sweeping<'a> {
        Sweeping::new(self.experiment, of, self.measured.correction.clone())
    }

    /// One sweep: every point is in the files as soon as it is measured, and the whole sweep in the index.
    async fn sweep(&mut self, stage: (usize, &Stage), of: (Fixture, usize), entrance: &Entrance<'_>) -> Result<(), Failure> {
        let sweeping = self.sweeping(of);
        let start_time_s = self.past.filter(|_| !entrance.points.is_empty()).and_then(|past| past.story.stages.get(&stage.0));
        let start_time_s = start_time_s.map_or_else(|| self.executor.clock.now_s(), |story| story.began_s);
        let recorder = &mut *self.executor.recorder;
        recorder.forget_sweep(sweeping.indexed());
        recorder.drop_captures(&sweeping.name, &entrance.points)?;
        sweeping.restore(recorder, &entrance.points)?;
        let mut on_point = |recorder: &mut Recorder, point: &SweepPoint| -> Result<(), ExecuteError> {
            sweeping.record(recorder, point)?;
            point.warnings.iter().for_each(|warning| recorder.point_warning(&sweeping.name, point.phasors.freq_hz, warning));
            Ok(())
        };
        let points = self.executor.stage(stage, entrance, &mut on_point).await?;
        let settled = sweeping.settle(self.executor.recorder, points)?;
        let recorder = &mut *self.executor.recorder;
        let flagged = sweeping::flags(&settled.points, &mut |freq_hz, text| recorder.point_warning(&sweeping.name, freq_hz, text));
        if of.1 > 0 {
            let entry = SweepEntry { flagged, ..sweeping.entry(&self.executor, (stage.1, start_time_s)) };
            self.executor.recorder.sweep(entry)?;
        }
        self.finish(of, settled, false)
    }

    /// What follows from a whole sweep. `restored`: it was told before.
    fn finish(&mut self, (fixture, repeat): (Fixture, usize), settled: Settled, restored: bool) -> Result<(), Failure> {
        let points = settled.points.clone();
        if fixture == Fixture::Cell {
            self.settled.insert(repeat, settled);
        }
        let tell = |recorder: &mut Recorder, text: &str| if restored { Ok(()) } else { recorder.event(text) };
        if repeat == 0 {
            judge(self.executor.recorder, self.experiment, (fixture, &points), (&mut self.measured, &tell))?;
        }
        let first = repeat <= 1;
        match self.measured.sweeps.entry(fixture_name(fixture)) {
            Occupied(mut known) if first => drop(known.insert(points)),
            Occupied(_) => {}
            Vacant(place) => drop(place.insert(points)),
        }
        // Before anything is done with the cell, its state of charge included.
        let controls = self.experiment.fixture_check.as_ref().map_or(0, |check| check.controls.len());
        if repeat == 0 && self.measured.controls.len() == controls {
            correct(self.executor.recorder, self.experiment, (&mut self.measured, &tell))?;
            self.executor.correction = self.measured.correction.clone();
        }
        Ok(())
    }
}

/// Says what came out, unless it was said before.
type Tell<'a> = &'a dyn Fn(&mut Recorder, &str) -> Result<(), RecordError>;

/// Stops the run when a control that was just measured is off as read.
fn judge(
    recorder: &mut Recorder,
    experiment: &Experiment,
    (fixture, points): (Fixture, &[SweepPoint]),
    (measured, tell): (&mut Measured, Tell<'_>),
) -> Result<(), Failure> {
    let tolerance = experiment.fixture_check.iter().flat_map(|check| &check.controls).find(|(control, _)| *control == fixture);
    let Some((_, tolerance)) = tolerance else { return Ok(()) };
    let swept = fixture_check::swept(experiment, points);
    let mut result = fixture_check::judge_raw(&experiment.bench, fixture, tolerance, swept);
    result.believed_as_read = Some(fixture_check::believed_as_read(experiment, fixture, points));
    let text = format!("{} as read: {}", result.control, result.raw.text);
    tell(recorder, &text)?;
    let passed = result.raw.passed;
    measured.controls.push(result);
    recorder.json("controls.json", &measured.controls)?;
    if passed { Ok(()) } else { Err(Failure::FixtureCheck(text)) }
}

/// Computes the correction from the controls and stops the run when it does not make them right.
fn correct(recorder: &mut Recorder, experiment: &Experiment, (measured, tell): (&mut Measured, Tell<'_>)) -> Result<(), Failure> {
    let Some(check) = &experiment.fixture_check else { return Ok(()) };
    let correction = fixture_check::correction(&experiment.bench, &measured.sweeps)
        .map_err(|error| Failure::FixtureCheck(format!("no correction can be computed: {error}")))?;
    recorder.json("correction.json", &correction)?;
    measured.correction = correction;
    let mut wrong = None;
    for fixture in [Fixture::FakeCell, Fixture::Short] {
        let name = fixture_name(fixture);
        let Some(control) = measured.controls.iter_mut().find(|control| control.control == name) else { continue };
        let points = measured.sweeps.get(name).map_or(&[][..], Vec::as_slice);
        let correction = (&measured.correction, check.corrected_tolerance);
        let verdict = fixture_check::judge_corrected(&experiment.bench, fixture, correction, fixture_check::swept(experiment, points));
        control.believed = Some(fixture_check::believed(experiment, fixture, correction, points));
        let text = format!("{name} after the correction: {}", verdict.text);
        tell(recorder, &text)?;
        if !verdict.passed && wrong.is_none() {
            wrong = Some(text);
        }
        control.corrected = Some(verdict);
    }
    recorder.json("controls.json", &measured.controls)?;
    wrong.map_or(Ok(()), |text| Err(Failure::FixtureCheck(text)))
}
