//! Executes the steps of a checked plan with the instruments, and writes readings and records. The
//! caller brings the bench into safe state afterwards, whatever the outcome.

mod agree;
mod ahead;
mod burst;
mod crest;
mod dc;
mod entrance;
mod error;
mod gate;
mod gate_bands;
mod heed;
mod leg;
mod metered;
mod multisine;
mod power;
mod record;
mod sine;
mod trace;
mod trace_rows;
mod watch;
mod wave;

use std::sync::Arc;

use analysis::{calibration::Correction, multisine::Line};
use instruments::{
    clock::Clock,
    fixture::Fixture,
    scope::{Trigger, Vertical},
    units::{Seconds, Volts},
};

pub use dc::SOC_MISSED;
pub use entrance::Entrance;
pub use error::ExecuteError;
pub(crate) use multisine::{BandFit, fit_band};
pub(crate) use record::{Asked, Taken, analyse};
pub use trace::charge_of;
pub(crate) use trace_rows::{Frames, Recorded as RecordedTrace, zeros};

use crate::{
    bench::{Bench, BenchError},
    config::{self, Experiment},
    interlock::{Interlock, Reading},
    journal::{Entry, PointDone},
    measure::{Spent, SweepPoint},
    operator::Operator,
    plan::{Purpose, Specimen, Stage, Step},
    progress::Progress,
    record::{Event, Recorder},
    thermostat::Thermostat,
};

/// Seconds between two readings while current flows.
const POLL_S: f64 = 1.0;

/// Executes stages on a bench.
pub struct Executor<'a> {
    /// The instruments.
    pub bench: &'a mut Bench,
    /// Experiment in work.
    pub experiment: &'a Experiment,
    /// Bench time.
    pub clock: Clock,
    /// Where everything is written.
    pub recorder: &'a mut Recorder,
    /// Who changes the fixture, where no device does.
    pub operator: &'a Operator,
    /// Progress that the person at the terminal sees.
    pub progress: &'a Progress,
    /// Correction of the harness for the channels.
    pub correction: Correction,
    /// Last reading of the cell before the bipolar supply went on.
    pub idle: Reading,
    /// Lines of multisines, with their noise and distortion, until somebody takes them.
    pub lines: Vec<Line>,
    /// Vertical settings that the scope's channels are to have.
    verticals: [Option<Vertical>; 4],
    /// Vertical settings that were applied last.
    applied: [Option<Vertical>; 4],
    /// Level of the trigger; follows the signal.
    trigger_v: Volts,
    /// Interlock with the allowance of the step in work.
    interlock: Interlock,
    polls: u32,
    /// Fixture that was clamped in last, and which cell it was, where there are several.
    mounted: Option<(Fixture, Option<Arc<Specimen>>)>,
    /// The cell that is in use, where there are several.
    specimen: Option<Arc<Specimen>>,
    /// Number of the campaign's run that the stage in work belongs to.
    run: Option<usize>,
    /// Number of the sweep, 0 for a control.
    repeat: usize,
    /// Points that the scope's memory was last set to.
    memory_points: Option<u64>,
    /// Channels while no current flows.
    zero: Option<trace::Zero>,
    /// Charge that traces have left in the cell, C.
    charge_c: f64,
    /// Bench time of the last reading of the bipolar supply, s.
    watched_s: f64,
    /// When those that are to carry nothing were read last, bench s.
    others_s: f64,
    /// Number of the instrument whose settings were read back last.
    looked: usize,
    /// How long the last reading of the bipolar supply took, s.
    read_s: f64,
    /// The step in work may be ended in its middle on request.
    ends_early: bool,
    /// When it was looked for such a request last, bench s.
    heeded_s: f64,
    /// Last reading of the voltmeter at the jig, V.
    shown_v: Option<f64>,
    /// Current that the power-up in work allows, A.
    powered_a: Option<f64>,
    /// Scales of the shunt's channels, V per division, and what a record on them shows while no
    /// direct current flows, A: from the first since the power-up.
    first_mean: Option<([f64; 2], f64)>,
    /// By how much the mean of the current has changed since then, A.
    mean_change_a: f64,
    /// The cell's temperature when it was read last, °C.
    last_c: Option<f64>,
    /// The logger scans nothing before it was told what.
    logger_ready: bool,
    /// The readings of the legs so far.
    legs: leg::Legs,
    /// When the scope was stopped last, s.
    stopped_s: f64,
    /// The point after the one in work, where the generator may go on to it.
    next: Option<ahead::Next>,
    /// The step that is in the journal before its turn.
    announced: Option<usize>,
    /// The generator has gone on.
    ahead: Option<ahead::Ahead>,
    /// How long its signal goes on by itself.
    burst: burst::Burst,
    /// Time per division and trigger that the scope was armed with last.
    armed: Option<(Seconds, Trigger)>,
    /// How long the last reading took, s.
    watch_took_s: f64,
    /// Where the reset of the state of charge stands.
    reset: dc::Reset,
    /// Effort of the retried points of the sweep.
    spent: Spent,
    /// The chiller was started here, and is to go on running.
    chiller_runs: bool,
    /// The loop of a bath that has none of its own.
    thermostat: Option<Thermostat>,
    /// It was said that the bipolar supply is not bounded.
    told: bool,
}

impl<'a> Executor<'a> {
    /// Makes an executor.
    pub fn new(
        (bench, recorder): (&'a mut Bench, &'a mut Recorder),
        experiment: &'a Experiment,
        clock: Clock,
        (operator, progress): (&'a Operator, &'a Progress),
    ) -> Self {
        Self {
            bench,
            experiment,
            clock,
            recorder,
            operator,
            progress,
            correction: Correction::none(experiment.bench.wiring.shunt),
            idle: Reading::default(),
            lines: Vec::new(),
            verticals: [None; 4],
            applied: [None; 4],
            trigger_v: Volts(0.0),
            interlock: Interlock::new(
                experiment.cell.interlock,
                experiment.cell.limits,
                experiment.bench.instruments.logger.is_some(),
            ),
            polls: 0,
            mounted: None,
            specimen: None,
            run: None,
            repeat: 0,
            memory_points: None,
            zero: None,
            charge_c: 0.0,
            watched_s: f64::NEG_INFINITY,
            others_s: f64::NEG_INFINITY,
            looked: 0,
            read_s: 0.0,
            ends_early: false,
            heeded_s: f64::NEG_INFINITY,
            shown_v: None,
            powered_a: None,
            first_mean: None,
            mean_change_a: 0.0,
            last_c: None,
            logger_ready: false,
            legs: leg::Legs::default(),
            stopped_s: 0.0,
            next: None,
            announced: None,
            ahead: None,
            burst: burst::Burst::default(),
            armed: None,
            watch_took_s: 0.0,
            reset: dc::Reset::default(),
            spent: Spent::default(),
            chiller_runs: false,
            thermostat: None,
            told: false,
        }
    }

    /// Executes one stage, given with its number in the plan, from the resume point `entrance`;
    /// `on_point` gets every finished point as soon as it and its capture are on disk. Returns all
    /// points, those that were there before included.
    ///
    /// # Errors
    /// The first thing that went wrong. The outputs may then still be on.
    pub async fn stage(
        &mut self,
        (number, stage): (usize, &Stage),
        entrance: &Entrance<'_>,
        on_point: &mut dyn FnMut(&mut Recorder, &SweepPoint) -> Result<(), ExecuteError>,
    ) -> Result<Vec<SweepPoint>, ExecuteError> {
        tracing::info!("stage: {}", stage.purpose);
        self.recorder.journal(Entry::Stage { stage: number })?;
        self.recorder
            .event(Event::Stage, &stage.purpose.to_string())?;
        let mut points: Vec<SweepPoint> = Vec::new();
        let mut fixture = Fixture::Cell;
        self.repeat = if let Purpose::Sweep(_, repeat) | Purpose::Multisine(repeat) = stage.purpose
        {
            repeat
        } else {
            0
        };
        self.spent = Spent::of(entrance.points.iter().map(|known| &known.point));
        if matches!(stage.purpose, Purpose::SocReset | Purpose::OcvSoc) {
            // Where it ends, nothing is left of what traces have moved before.
            self.charge_c = 0.0;
        }
        self.reset = dc::Reset::default();
        (self.announced, self.ahead, self.armed) = (None, None, None);
        for (index, step) in stage.steps.iter().enumerate() {
            if let Some(known) = entrance.point(index) {
                points.push(known.point.clone());
            }
            if self.reset.accepted || !entrance.plays(stage, (index, step)) {
                continue;
            }
            self.heed(stage, (index, fixture)).await?;
            tracing::info!("step: {step}");
            let allowance = self.allowance(fixture, step);
            if !self.was_announced(index) {
                self.recorder.journal(Entry::Intent {
                    stage: number,
                    step: index,
                    text: step.to_string(),
                    live: allowance.live,
                })?;
                self.recorder.event(Event::Step, &step.to_string())?;
            }
            self.look_ahead((number, stage), index, |at, step| {
                entrance.plays(stage, (at, step))
            });
            self.progress.begin(&stage.title(), step);
            self.interlock.begin(allowance, self.clock.machine_s());
            if let Step::Mount(other) = *step {
                fixture = other;
            }
            match *step {
                Step::Recheck { .. } if matches!(stage.purpose, Purpose::Multisine(_)) => {
                    self.recheck_bands(stage, &mut points).await?;
                    self.recorder.journal(Entry::Done {
                        stage: number,
                        step: index,
                    })?;
                }
                Step::Recheck { .. } => {
                    for at in self.recheck(fixture, stage, &mut points).await? {
                        // The later entry of a step counts.
                        self.recorder.point(PointDone {
                            stage: number,
                            step: at.0,
                            files: Vec::new(),
                            idle: self.idle,
                            point: points[at.1].clone(),
                        })?;
                    }
                    self.recorder.journal(Entry::Done {
                        stage: number,
                        step: index,
                    })?;
                }
                Step::Multisine(ref band) => {
                    self.gated_band(band, &mut points).await?;
                    self.recorder.journal(Entry::Done {
                        stage: number,
                        step: index,
                    })?;
                }
                _ => {
                    if let Some(point) = self.play(fixture, step).await? {
                        self.recorder.point(PointDone {
                            stage: number,
                            step: index,
                            files: Vec::new(),
                            idle: self.idle,
                            point: point.clone(),
                        })?;
                        on_point(self.recorder, &point)?;
                        points.push(point);
                    } else {
                        self.recorder.journal(Entry::Done {
                            stage: number,
                            step: index,
                        })?;
                    }
                }
            }
            self.progress.end(step);
        }
        if let Some(first) = entrance.points.first() {
            // The sweep began when its first point did.
            self.idle = first.idle;
        }
        Ok(points)
    }

    /// Takes over from an earlier process: the cell that was in use, and the charge that traces
    /// have left in it, C.
    pub fn take_over(&mut self, specimen: Option<Arc<Specimen>>, charge_c: f64) {
        (self.specimen, self.charge_c) = (specimen, charge_c);
    }

    /// Plays one step; a sine gives a point.
    async fn play(
        &mut self,
        fixture: Fixture,
        step: &Step,
    ) -> Result<Option<SweepPoint>, ExecuteError> {
        match *step {
            Step::Specimen(ref specimen, run) => {
                self.run = Some(run);
                self.insert(specimen).await?;
            }
            Step::Mount(_) => self.mount(fixture).await?,
            Step::HoldTemperature { .. } => self.hold_temperature(step).await?,
            Step::Discharge { .. } => self.discharge(step).await?,
            Step::Charge { .. } => self.charge(step).await?,
            Step::Rest { .. } => self.rest(step).await?,
            Step::PowerUp { .. } => self.power(fixture, step).await?,
            Step::Accept { band_v, missed } => self.accept(band_v, missed)?,
            Step::Leg(leg) => self.leg(&leg).await?,
            Step::Sine { .. } => return self.gated(fixture, step).await.map(Some),
            // They give several points, or change those that are there.
            Step::Multisine(_) | Step::Recheck { .. } => {}
            Step::Pause { span_s } => self.pause(span_s).await?,
            Step::Zero(ref trace) => self.zero(trace).await?,
            Step::Trace(ref trace) => self.trace(trace).await?,
            Step::PowerDown => self.power_down().await?,
        }
        Ok(None)
    }

    /// Takes another cell into use. Where a person does it, they are asked when it is to be
    /// clamped.
    async fn insert(&mut self, specimen: &Arc<Specimen>) -> Result<(), ExecuteError> {
        self.bench.made_safe().await.map_err(BenchError::from)?;
        self.bench.off_again().await?;
        let error = self.bench.error("jig");
        if let Some(jig) = self.bench.jig.as_mut() {
            jig.insert(specimen.number).await.map_err(error)?;
        }
        if self.specimen.replace(specimen.clone()).as_ref() != Some(specimen) {
            // What traces have left is in the other cell, and so is the temperature that was seen.
            self.charge_c = 0.0;
            self.interlock.forget();
        }
        Ok(())
    }

    async fn mount(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        self.bench.made_safe().await.map_err(BenchError::from)?;
        let error = self.bench.error("load");
        if let Some(load) = self.bench.load.as_mut() {
            // From here on it is the cell's voltmeter.
            load.watch().await.map_err(error)?;
        }
        self.verticals = [None; 4];
        self.trigger_v = Volts(0.0);
        if fixture == Fixture::Short {
            // A bar across a cell is a dead short, whatever the outputs do: it is looked for before
            // anybody reaches into the jig.
            self.refuse_a_cell("before mounting the short").await?;
        }
        self.bench.off_again().await?;
        match (
            &self.experiment.bench.instruments.jig,
            self.bench.jig.as_mut(),
        ) {
            (Some(config::Jig::Device(_)), Some(jig)) => {
                let mounted = jig.mount(fixture).await;
                mounted.map_err(self.bench.error("jig"))?;
            }
            // Whoever put it there need not be asked again.
            (Some(config::Jig::Person), _)
                if self.mounted == Some((fixture, self.specimen.clone())) => {}
            (Some(config::Jig::Person), _) => {
                let _person = self.clock.wait(None);
                tokio::select! {
                    mounted = self.operator.mount(fixture, self.specimen.as_deref()) => mounted?,
                    ended = self.asked_to_end() => return Err(ended),
                }
            }
            // Without a jig only the cell is ever asked for: it is what is in there.
            _ => {}
        }
        if self.mounted != Some((fixture, self.specimen.clone())) {
            // What was seen of another one says nothing of this.
            self.interlock.forget();
        }
        self.mounted = Some((fixture, self.specimen.clone()));
        if fixture == Fixture::Short {
            self.refuse_a_cell("after mounting the short").await?;
        }
        Ok(())
    }
}

/// The instrument of a role, or a complaint that the bench lacks it.
fn require<'b, T>(
    instrument: &'b mut Option<T>,
    role: &'static str,
) -> Result<&'b mut T, BenchError> {
    instrument.as_mut().ok_or(BenchError::Missing { role })
}
