//! Executes a plan stage by stage, adds sweeps and traces to the index, and collects their
//! results.

use analysis::{
    calibration::Correction,
    dataset::{self, SweepEntry},
    run_folder::CORRECTION,
};
use instruments::{
    clock::{Clock, TimeMode},
    fixture::Fixture,
    units::{Amps, Coulombs},
};

use super::{
    Measured, ResumeContext,
    map_points::{MapTable, Standing, Way},
    multisine,
    run_accumulator::RunAccumulator,
    sweep_writer::{self, Settled},
    traced,
};
use bench_core::{
    bench::Bench,
    executor::{ExecuteError, Executor, Person, ResumePoint, Rig, within},
    journal::{Entry, PointDone},
    operator::Operator,
    operator::progress::Progress,
    operator::run_control::{self, RunControl},
    record::Recorder,
    safety::failure::Failure,
    watch::WatchLink,
};
use bench_plan::{
    config::Experiment,
    measure::{SweepPoint, channels::ControlPotentials},
    plan::{Checked, Plan, Purpose, Stage},
    procedure,
};

/// Earlier results: the correction of another run on the same bench, or the part of this run that
/// was finished before its process died.
pub(super) struct PriorResults<'a> {
    pub(super) inherited: Option<Correction>,
    pub(super) context: Option<&'a ResumeContext>,
}

/// Environment of a run beside its bench: its clock, the operator, and its progress.
pub(super) struct RunEnvironment<'a> {
    pub(super) clock: &'a Clock,
    pub(super) operator: &'a Operator,
    pub(super) progress: &'a Progress,
    pub(super) watch: Option<WatchLink>,
}

/// Executes the plan, stage by stage, and judges the controls as soon as they are measured.
pub(super) async fn drive(
    bench: &mut Bench,
    recorder: &mut Recorder,
    experiment: &Experiment,
    plan: &Checked,
    environment: RunEnvironment<'_>,
    before: PriorResults<'_>,
) -> Result<Measured, Failure> {
    bench.made_safe().await?;
    recorder.journal(Entry::Safe)?;
    let PriorResults { inherited, context } = before;
    let accumulator = RunAccumulator::new(experiment, inherited.clone());
    recorder.about(&experiment.cell.name, experiment.cell.capacity_coulomb.0);
    let mut executor = Executor::new(
        Rig::new(
            bench,
            experiment,
            environment.clock.clone(),
            recorder,
            environment.watch,
        ),
        Person {
            operator: environment.operator,
            progress: environment.progress,
        },
    );
    if let Some(correction) = inherited {
        executor.rig.recorder.json(CORRECTION, &correction)?;
        executor.known.correction = correction;
    }
    let map = experiment
        .map
        .as_ref()
        .map(|map| MapTable::of(map, executor.rig.recorder))
        .transpose()?;
    let mut drive = Drive {
        executor,
        experiment,
        plan: plan.plan(),
        context,
        accumulator,
        map,
        held: None,
        reached: None,
    };
    drive.restore()?;
    drive.play().await?;
    drive.accumulator.whole(drive.executor.rig.recorder)
}

struct Drive<'a, 'b> {
    executor: Executor<'a>,
    experiment: &'a Experiment,
    plan: &'b Plan,
    context: Option<&'b ResumeContext>,
    accumulator: RunAccumulator<'a>,
    /// The points of a map so far.
    map: Option<MapTable<'a>>,
    /// The stage whose temperature is held.
    held: Option<usize>,
    /// The point of a map that this process has brought the cell to, by its number.
    reached: Option<usize>,
}

impl<'a, 'b> Drive<'a, 'b> {
    /// Restores the results of finished stages from the run folder.
    fn restore(&mut self) -> Result<(), Failure> {
        let Some(context) = self.context else {
            return Ok(());
        };
        let latest = context
            .replay
            .latest
            .and_then(|number| self.plan.stages.get(number))
            .and_then(Stage::specimen)
            .cloned();
        let left_coulomb = context.charge_left_coulomb(self.executor.rig.recorder, self.plan)?;
        self.executor.take_over(latest, Coulombs(left_coulomb));
        self.reached = self.reached_before(context);
        self.recall_records(context);
        for (number, stage) in self
            .plan
            .stages
            .iter()
            .enumerate()
            .filter(|(number, _)| context.replay.finished(*number))
        {
            if let Purpose::Multisine(repeat) = stage.purpose {
                for number in multisine::numbers(self.experiment, stage, repeat) {
                    let folder = self.executor.rig.recorder.folder();
                    let run = multisine::restore(folder, number)?;
                    self.accumulator.measured.multisines.push(run);
                }
            }
            let Purpose::Sweep(fixture, repeat) = stage.purpose else {
                continue;
            };
            let points: Vec<&PointDone> = context
                .replay
                .stages
                .get(&number)
                .map_or_else(Vec::new, |replay| replay.points.values().collect());
            let sweep_writer = self.accumulator.sweep_writer(stage, fixture, repeat);
            sweep_writer.restore(self.executor.rig.recorder, &points)?;
            let settled = sweep_writer.settle(
                self.executor.rig.recorder,
                points
                    .into_iter()
                    .map(|point| point.point.clone())
                    .collect(),
            )?;
            sweep_writer::flags(&settled.points, &mut |freq_hz, text| {
                self.executor
                    .rig
                    .recorder
                    .known_point_warning(&sweep_writer.name, freq_hz, text);
            });
            self.finish(fixture, repeat, settled, true)?;
        }
        Ok(())
    }

    /// Returns the point of a map at which the cell still is: it was reached after the last full
    /// charge, even if its discharge has ended before its charge.
    fn reached_before(&self, context: &ResumeContext) -> Option<usize> {
        if context.next.repeated_reset.is_some() {
            return None;
        }
        let began = |number: &usize| context.replay.stages.get(number).map(|stage| stage.began_s);
        let of = |purpose: Purpose| {
            let numbered = self.plan.stages.iter().enumerate();
            let begun = numbered.filter(move |(_, stage)| stage.purpose == purpose);
            begun
                .filter_map(|(number, _)| Some((began(&number)?, number)))
                .max_by(|a, b| a.0.total_cmp(&b.0))
        };
        let (full_s, _) = of(Purpose::SocReset)?;
        let (point_s, number) = of(Purpose::MapPoint)?;
        let is_there = context.replay.finished(number) && point_s > full_s;
        is_there.then(|| self.run_of(number)).flatten()
    }

    /// Loads the records of finished points, which are needed only to recognise repeated records.
    /// A record that can no longer be read, or was moved to an archive, is omitted.
    fn recall_records(&mut self, context: &ResumeContext) {
        let rig = &mut self.executor.rig;
        let stages = context.replay.stages.values();
        for done in stages.flat_map(|stage| stage.points.values()) {
            for (file, _) in &done.files {
                if let Ok(capture) = dataset::read_capture(&rig.recorder.path(file)) {
                    rig.recall(done.point.fixture, &capture);
                }
            }
        }
    }

    /// Executes everything that remains.
    async fn play(&mut self) -> Result<(), Failure> {
        let finished = |number: &usize| {
            self.context
                .is_some_and(|context| context.replay.finished(*number))
        };
        let mut left: Vec<usize> = (0..self.plan.stages.len())
            .filter(|number| !finished(number))
            .collect();
        let mut run = None;
        if self.context.is_none() {
            for (point, reason) in procedure::left_out_pulses(self.experiment) {
                let text = format!("point {point}: {reason}");
                self.executor.rig.recorder.warning(&text);
            }
        }
        if let Some(ResumeContext { next, replay, .. }) = self.context {
            run = replay.latest.and_then(|latest| self.run_of(latest));
            if let (Some(reset), Some((open, _))) = (next.repeated_reset, next.open) {
                let unknown = Entry::ChargeUnknown { reset, open };
                self.executor.rig.recorder.journal(unknown)?;
            }
            self.hold_again().await?;
            if let Some(repeated_reset) = next.repeated_reset {
                self.stage(repeated_reset, ResumePoint::default()).await?;
            }
            if let Some((open, from)) = next.open {
                left.retain(|number| *number != open);
                self.stage(
                    open,
                    ResumePoint {
                        from,
                        points: self.known(open, from),
                    },
                )
                .await?;
            }
        }
        while !left.is_empty() {
            self.reorder(&mut left, run);
            let number = left.remove(0);
            run = self.run_of(number);
            self.stage(number, ResumePoint::default()).await?;
        }
        Ok(())
    }

    /// Brings the bath back to the temperature of the last finished stage that set one. Waits for
    /// the cell unless a control is in the jig.
    async fn hold_again(&mut self) -> Result<(), Failure> {
        let Some(context) = self.context else {
            return Ok(());
        };
        let held = |(number, stage): &(usize, &'b Stage)| {
            stage.purpose == Purpose::Temperature && context.replay.finished(*number)
        };
        let Some((number, stage)) = self.plan.stages.iter().enumerate().rfind(held) else {
            return Ok(());
        };
        self.held = Some(number);
        let open = (context.next.open).and_then(|(number, _)| self.plan.stages.get(number));
        let waits = !matches!(
            open.map(|stage| &stage.purpose),
            Some(Purpose::Sweep(fixture, _)) if *fixture != Fixture::Cell
        );
        Ok(self.executor.hold_again(stage, waits).await?)
    }

    /// Returns the points of an interrupted stage that continues at a step. A sweep under a direct
    /// current that begins anew begins without points: they belong to another charge.
    fn known(&self, number: usize, from: usize) -> Vec<&'b PointDone> {
        let stage = self.plan.stages.get(number);
        if from == 0 && stage.is_some_and(|stage| stage.bias_a() != Amps(0.0)) {
            return Vec::new();
        }
        self.context
            .and_then(|context| context.replay.stages.get(&number))
            .map_or_else(Vec::new, |replay| replay.points.values().collect())
    }

    fn run_of(&self, number: usize) -> Option<usize> {
        self.plan.stages.get(number).and_then(Stage::run)
    }

    /// Applies the requested order after the present run is done.
    fn reorder(&self, left: &mut [usize], run: Option<usize>) {
        if self.experiment.campaign.is_none() || self.executor.rig.clock.mode() == TimeMode::Virtual
        {
            return;
        }
        let mut order = RunControl::read(self.executor.rig.recorder.folder()).order;
        order.splice(0..0, run);
        // Runs that are not named keep their planned order, regardless of earlier requests.
        left.sort_unstable();
        // The controls precede every run.
        let controls = left
            .iter()
            .take_while(|number| self.run_of(**number).is_none())
            .count();
        run_control::reorder(&mut left[controls..], &order, |number| {
            self.plan.stages.get(*number).and_then(Stage::run)
        });
    }

    /// Executes one stage and evaluates it.
    async fn stage(&mut self, number: usize, resume_point: ResumePoint<'_>) -> Result<(), Failure> {
        for before in self.before(number) {
            self.stage_alone(before, ResumePoint::default()).await?;
        }
        self.stage_alone(number, resume_point).await
    }

    /// Returns the stages that bring the cell to the charge and temperature of a stage of a map, if it
    /// is not there: after a crash it may be full, or at another temperature.
    fn before(&self, number: usize) -> Vec<usize> {
        let stage = self.plan.stages.get(number);
        let Some((way, stage)) = Way::to(self.plan, number).zip(stage) else {
            return Vec::new();
        };
        let Some(point) = stage.point() else {
            return Vec::new();
        };
        let measures = !matches!(stage.purpose, Purpose::SocReset | Purpose::MapPoint);
        let beyond_coulomb = if measures && self.reached == stage.run() {
            // Even if the discharge has ended before its charge.
            0.0
        } else {
            (self.executor.charge_coulomb() + point.below_full_coulomb).value()
        };
        let at = Standing {
            beyond_coulomb,
            within_coulomb: point.within_coulomb.0,
            held: self.held,
        };
        way.before(number, stage.purpose, &at)
    }

    async fn stage_alone(
        &mut self,
        number: usize,
        resume_point: ResumePoint<'_>,
    ) -> Result<(), Failure> {
        let Some(stage) = self.plan.stages.get(number) else {
            return Ok(());
        };
        let timed = traced::stage(number, stage, &self.executor.rig.clock);
        within(timed, self.play_stage(number, stage, resume_point)).await
    }

    async fn play_stage(
        &mut self,
        number: usize,
        stage: &Stage,
        resume_point: ResumePoint<'_>,
    ) -> Result<(), Failure> {
        match stage.purpose {
            Purpose::Sweep(fixture, repeat) => {
                self.sweep(number, stage, fixture, repeat, &resume_point)
                    .await?;
            }
            Purpose::Multisine(repeat) => {
                let runs = multisine::measure(
                    &mut self.executor,
                    self.experiment,
                    number,
                    stage,
                    repeat,
                    &self.accumulator.measured,
                )
                .await?;
                self.accumulator.measured.multisines.extend(runs);
            }
            Purpose::Temperature
            | Purpose::SocReset
            | Purpose::MapPoint
            | Purpose::OcvSoc
            | Purpose::Trace => {
                self.executor
                    .stage(number, stage, &resume_point, &mut |_, _| Ok(()))
                    .await?;
            }
        }
        match stage.purpose {
            Purpose::Temperature => self.held = Some(number),
            Purpose::SocReset => self.reached = None,
            Purpose::MapPoint => self.reached = stage.run(),
            _ => {}
        }
        if let Some((map, run)) = self.map.as_mut().zip(stage.campaign_run()) {
            match stage.purpose {
                Purpose::MapPoint => map.reach(run, &mut self.executor)?,
                _ => map.write(self.executor.rig.recorder)?,
            }
        }
        Ok(self
            .executor
            .rig
            .recorder
            .journal(Entry::StageDone { stage: number })?)
    }

    /// Executes one sweep: every point is in the files as soon as it is measured, and the whole
    /// sweep in the index.
    async fn sweep(
        &mut self,
        number: usize,
        stage: &Stage,
        fixture: Fixture,
        repeat: usize,
        resume_point: &ResumePoint<'_>,
    ) -> Result<(), Failure> {
        let sweep_writer = self.accumulator.sweep_writer(stage, fixture, repeat);
        let start_time_s = self
            .context
            .filter(|_| !resume_point.points.is_empty())
            .and_then(|context| context.replay.stages.get(&number));
        let start_time_s = start_time_s.map_or_else(
            || self.executor.rig.clock.now_s(),
            |replay| replay.began_s.0,
        );
        let recorder = &mut *self.executor.rig.recorder;
        recorder.forget_sweep(sweep_writer.indexed());
        recorder.drop_captures(&sweep_writer.name, &resume_point.points)?;
        sweep_writer.restore(recorder, &resume_point.points)?;
        let mut on_point =
            |recorder: &mut Recorder, point: &SweepPoint| -> Result<(), ExecuteError> {
                sweep_writer.record(recorder, point)?;
                point.warnings.iter().for_each(|warning| {
                    recorder.point_warning(&sweep_writer.name, point.phasors.freq_hz, warning);
                });
                Ok(())
            };
        let points = self
            .executor
            .stage(number, stage, resume_point, &mut on_point)
            .await?;
        let settled = sweep_writer.settle(self.executor.rig.recorder, points)?;
        let recorder = &mut *self.executor.rig.recorder;
        let flagged = sweep_writer::flags(&settled.points, &mut |freq_hz, text| {
            recorder.point_warning(&sweep_writer.name, freq_hz, text);
        });
        if repeat > 0 {
            let entry = SweepEntry {
                flagged,
                ..sweep_writer.entry(&self.executor, stage, start_time_s, &settled)
            };
            self.executor.rig.recorder.sweep(entry)?;
        }
        self.finish(fixture, repeat, settled, false)
    }

    /// Evaluates a complete sweep.
    fn finish(
        &mut self,
        fixture: Fixture,
        repeat: usize,
        settled: Settled,
        restored: bool,
    ) -> Result<(), Failure> {
        self.accumulator.finish(
            self.executor.rig.recorder,
            fixture,
            repeat,
            settled,
            restored,
        )?;
        self.executor.known.correction = self.accumulator.measured.correction.clone();
        let shunt_ohm = self.experiment.bench.wiring.shunt.r_ohm;
        let controls = self.accumulator.measured.sweeps.values().flatten();
        self.executor.known.controls = controls
            .filter_map(|point| ControlPotentials::of(point, shunt_ohm))
            .collect();
        Ok(())
    }
}
