//! Executes the steps of a checked plan with the instruments, and writes readings and records. The
//! caller must bring the bench into a safe state afterwards, whatever the outcome.

mod analog;
mod ask;
mod bath;
mod bias;
mod burst;
mod counted;
mod crest;
mod cross_check;
mod dc;
mod error;
mod gate;
mod gate_bands;
mod handle_request;
mod leg;
mod metered;
mod multisine;
mod point_overlap;
mod power;
mod record;
mod resume_point;
mod rig;
mod screen;
mod setup;
mod sine;
mod state;
pub mod thermostat;
mod trace;
mod trace_rows;
mod traced;
mod watch;
mod wave;
mod zero;

use std::sync::Arc;

use analysis_signal::calibration::Correction;
use instruments::{
    fixture::Fixture,
    units::{Celsius, Coulombs, Volts},
};

use bias::BiasState;
pub use error::ExecuteError;
pub use multisine::{BandFit, fit_band};
use point_overlap::{NextPoint, SweepState};
pub use record::{ChannelRecord, PointRequest, analyse, check_channels};
pub use resume_point::ResumePoint;
pub use rig::Rig;
use screen::Screen;
pub use state::Person;
use state::{Direct, Known, Position, Reset};
pub use trace::charge_of;
pub use trace_rows::{Frames, Recorded as RecordedTrace, zeros};
pub use traced::{Timed, within};

use crate::{
    bench::BenchError,
    journal::Entry,
    record::{Event, Recorder},
};
use bench_plan::{
    interlock::Reading,
    measure::{Spent, SweepPoint},
    plan::{Purpose, Specimen, Stage, Step},
};
use rig::{POLL_S, require};

/// Executes stages on a bench.
pub struct Executor<'a> {
    /// The instruments.
    pub rig: Rig<'a>,
    /// Knowledge of harness and cell.
    pub known: Known,
    /// The person at the bench.
    person: Person<'a>,
    /// Contents of the jig.
    position: Position,
    /// Settings of the scope.
    scope: Screen,
    /// The present sweep.
    sweep: SweepState,
    /// State that steps with direct current have left.
    direct: Direct,
}

impl<'a> Executor<'a> {
    /// Creates an executor.
    pub fn new(rig: Rig<'a>, person: Person<'a>) -> Self {
        let correction = Correction::none(rig.setup.wiring.shunt);
        Self {
            rig,
            known: Known {
                correction,
                idle: Reading::default(),
                lines: Vec::new(),
                controls: Vec::new(),
            },
            person,
            position: Position::default(),
            scope: Screen::default(),
            sweep: SweepState::default(),
            direct: Direct::default(),
        }
    }

    /// Executes one stage, given with its number in the plan, from the resume point
    /// `resume_point`. Calls `on_point` for every finished point as soon as it and its capture are
    /// on disk. Returns all points, including earlier ones.
    ///
    /// # Errors
    /// The first error that occurs. The outputs may then still be on.
    pub async fn stage(
        &mut self,
        number: usize,
        stage: &Stage,
        resume_point: &ResumePoint<'_>,
        on_point: &mut dyn FnMut(&mut Recorder, &SweepPoint) -> Result<(), ExecuteError>,
    ) -> Result<Vec<SweepPoint>, ExecuteError> {
        tracing::info!("stage: {}", stage.purpose);
        self.rig.recorder.journal(Entry::Stage { stage: number })?;
        self.rig
            .recorder
            .event(Event::Stage, &stage.purpose.to_string())?;
        let mut points: Vec<SweepPoint> = Vec::new();
        let mut fixture = Fixture::Cell;
        self.position.repeat =
            if let Purpose::Sweep(_, repeat) | Purpose::Multisine(repeat) = stage.purpose {
                repeat
            } else {
                0
            };
        self.sweep.spent = Spent::of(resume_point.points.iter().map(|known| &known.point));
        if matches!(stage.purpose, Purpose::SocReset | Purpose::OcvSoc) {
            // Such a stage sets the charge anew: the charge of earlier traces no longer counts.
            self.direct.charge_coulomb = Coulombs::ZERO;
            if stage.point().is_some() {
                self.journal_charge()?;
            }
        }
        self.direct.reset = Reset::default();
        self.sweep.fall_back();
        self.scope.armed = None;
        for (index, step) in stage.steps.iter().enumerate() {
            if let Some(known) = resume_point.point(index) {
                points.push(known.point.clone());
            }
            if self.direct.reset.accepted || !resume_point.plays(stage, index, step) {
                continue;
            }
            if let Err(error) = self.handle_request(stage, index, fixture).await {
                self.report_moved_charge();
                return Err(error);
            }
            if matches!(step, Step::Sine { .. } | Step::Multisine(_)) {
                self.check_bias(stage.bias_at(index))?;
            }
            tracing::info!("step: {step}");
            let allowance = self.rig.allowance(fixture, step);
            if !self.sweep.was_announced(index) {
                self.rig.recorder.journal(Entry::Intent {
                    stage: number,
                    step: index,
                    text: step.to_string(),
                    live: allowance.live,
                })?;
                self.rig.recorder.event(Event::Step, &step.to_string())?;
            }
            self.sweep.next = match step {
                Step::Sine { settings, .. } if self.rig.overlaps(settings) => {
                    NextPoint::after(number, stage, index, |at, step| {
                        resume_point.plays(stage, at, step)
                    })
                }
                _ => None,
            };
            self.person.progress.begin(&stage.title(), step);
            self.rig.allow(allowance, step);
            if let Step::Mount(other) = *step {
                fixture = other;
            }
            let done = |recorder: &mut Recorder| {
                recorder.journal(Entry::Done {
                    stage: number,
                    step: index,
                })
            };
            let span = traced::step(step, &self.rig.clock);
            let work = async {
                match *step {
                    Step::Recheck(ref quality)
                        if matches!(stage.purpose, Purpose::Multisine(_)) =>
                    {
                        self.recheck_bands(quality, stage, &mut points).await?;
                        done(self.rig.recorder)?;
                    }
                    Step::Recheck(ref quality) => {
                        for (step, at) in self.recheck(fixture, quality, stage, &mut points).await?
                        {
                            // The later entry of a step takes precedence.
                            let idle = self.known.idle;
                            self.rig.recorder.point(number, step, idle, &points[at])?;
                        }
                        done(self.rig.recorder)?;
                    }
                    Step::Multisine(ref band) => {
                        self.gated_band(band, &mut points).await?;
                        done(self.rig.recorder)?;
                    }
                    _ => {
                        if let Some(point) = self.play(fixture, step).await? {
                            let idle = self.known.idle;
                            self.rig.recorder.point(number, index, idle, &point)?;
                            on_point(self.rig.recorder, &point)?;
                            points.push(point);
                        } else {
                            done(self.rig.recorder)?;
                        }
                    }
                }
                Ok::<(), ExecuteError>(())
            };
            let outcome = traced::within(span, work).await;
            if outcome.is_err() {
                self.report_moved_charge();
            }
            outcome?;
            self.person.progress.end(step);
        }
        for text in self.rig.bench.peculiarities() {
            self.rig.recorder.warning(&text);
        }
        if let Some(first) = resume_point.points.first() {
            // The sweep began when its first point did.
            self.known.idle = first.idle;
        }
        Ok(points)
    }

    /// Restores the state of an earlier process: the cell that was in use, and the charge that
    /// traces have left in it, C.
    pub fn take_over(&mut self, specimen: Option<Arc<Specimen>>, charge_coulomb: Coulombs) {
        (self.position.specimen, self.direct.charge_coulomb) = (specimen, charge_coulomb);
    }

    /// Returns the charge that was moved since the cell was brought to a state of charge or taken into
    /// use, C, charge positive.
    pub fn charge_coulomb(&self) -> Coulombs {
        self.direct.charge_coulomb
    }

    /// Returns the voltage at rest, V, and the temperature of the cell, °C, as they were last read;
    /// `None` before the first rest of a stage.
    pub fn at_rest(&self) -> Option<(Volts, Option<Celsius>)> {
        let (ocv_v, _) = self.direct.reset.rested?;
        let last_degc = self.rig.temperatures.last_degc;
        Some((ocv_v, last_degc.filter(|degc| degc.is_finite())))
    }

    /// Executes one step; a sine step returns a point.
    async fn play(
        &mut self,
        fixture: Fixture,
        step: &Step,
    ) -> Result<Option<SweepPoint>, ExecuteError> {
        match *step {
            Step::Specimen(ref run) => {
                self.position.run = Some(run.clone());
                self.insert(&run.cell).await?;
            }
            Step::Mount(_) => self.mount(fixture).await?,
            Step::HoldTemperature { .. } => self.hold_temperature(step).await?,
            Step::Discharge { .. } => self.rig.discharge(step).await?,
            Step::Charge { .. } => self.charge(step).await?,
            Step::Rest { .. } => self.rest(step).await?,
            Step::PowerUp { .. } => {
                self.power(fixture, step).await?;
                self.begin_count().await?;
            }
            Step::Accept { band_v, missed } => {
                if self.point().is_some() {
                    self.rig.cell_temperature().await?;
                }
                self.accept(band_v.0..=band_v.1, missed)?;
            }
            Step::Leg(leg) => self.leg(&leg).await?,
            Step::Sine { ref settings, .. } => {
                return self.gated(fixture, step, settings).await.map(Some);
            }
            // These steps return several points or change existing ones.
            Step::Multisine(_) | Step::Recheck(_) => {}
            Step::Pause { span_s } => self.rig.pause(span_s).await?,
            Step::Zero(ref trace) => self.zero(trace).await?,
            Step::Trace(ref trace) => {
                // Its rows count the charge.
                self.direct.residual = None;
                self.trace(trace).await?;
            }
            Step::BiasZero(ref bias) => self.bias_zero(bias).await?,
            Step::Bias(ref bias) => self.bias(bias).await?,
            Step::Recharge(ref recharge) => self.recharge(recharge).await?,
            Step::PowerDown => {
                if self.rig.setup.wiring.analog.is_some() {
                    self.end_analog(fixture).await?;
                } else {
                    self.rig.power_down().await?;
                }
                self.end_count()?;
                // What a recharge has left counts as the charge of a trace does.
                self.direct.charge_coulomb += self.moved_coulomb();
                self.rig.driving.bias = BiasState::default();
            }
        }
        Ok(None)
    }

    /// Takes another cell into use. If a person changes the cells, they are asked when it is to be
    /// clamped.
    async fn insert(&mut self, specimen: &Arc<Specimen>) -> Result<(), ExecuteError> {
        self.rig.bench.made_safe().await.map_err(BenchError::from)?;
        self.rig.bench.off_again().await?;
        let error = self.rig.bench.error("jig");
        if let Some(jig) = self.rig.bench.instruments.jig.as_mut() {
            jig.insert(specimen.number).await.map_err(error)?;
        }
        if self.position.specimen.replace(specimen.clone()).as_ref() != Some(specimen) {
            // The charge that traces have left belongs to the other cell, and so does the last
            // temperature.
            self.direct.charge_coulomb = Coulombs::ZERO;
            self.rig.interlock.forget();
        }
        Ok(())
    }

    async fn mount(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        self.rig.bench.made_safe().await.map_err(BenchError::from)?;
        let error = self.rig.bench.error("load");
        if let Some(load) = self.rig.bench.instruments.load.as_mut() {
            // From here on the load is the cell's voltmeter.
            load.watch().await.map_err(error)?;
        }
        self.scope.forget();
        if fixture == Fixture::Short {
            // A bar across a cell is a dead short, whatever state the outputs have: check for a
            // cell before a person reaches into the jig.
            self.rig.refuse_a_cell("before mounting the short").await?;
        }
        self.rig.bench.off_again().await?;
        if self.rig.setup.wiring.analog.is_some() {
            self.rig.hold_zero().await?;
        }
        match self.rig.bench.instruments.jig.as_mut() {
            Some(jig) => {
                let mounted = jig.mount(fixture).await;
                mounted.map_err(self.rig.bench.error("jig"))?;
            }
            // The person who mounted the fixture need not be asked again.
            None if self.rig.setup.person_clamps
                && self.position.mounted == Some((fixture, self.position.specimen.clone())) => {}
            None if self.rig.setup.person_clamps => self.ask(fixture).await?,
            // Without a jig device only the cell is ever requested, so it is what is mounted.
            None => {}
        }
        if self.position.mounted != Some((fixture, self.position.specimen.clone())) {
            // Earlier readings belong to another fixture.
            self.rig.interlock.forget();
        }
        self.position.mounted = Some((fixture, self.position.specimen.clone()));
        if fixture == Fixture::Short {
            self.rig.refuse_a_cell("after mounting the short").await?;
        }
        Ok(())
    }
}
