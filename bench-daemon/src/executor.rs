//! The one loop: steps of a checked plan → instruments → readings and records. Whoever drives it brings the bench into safe state afterwards,
//! whatever the outcome.

mod beside;
mod dc;
mod error;
mod gate;
mod leg;
mod multisine;
mod sine;
mod trace;

use analysis::{calibration::Correction, multisine::Line};
use instruments::{
    clock::Clock,
    mock::plant::Fixture,
    scope::Vertical,
    supply4q,
    units::{Amps, Volts},
};

pub use beside::{Bend, Beside};
pub use error::ExecuteError;
pub use sine::SweepPoint;

use crate::{
    bench::{Bench, BenchError},
    config::{self, Experiment},
    interlock::{self, Limits, NO_CURRENT_A, Reading},
    operator::Operator,
    plan::{Purpose, Stage, Step, fixture_name},
    progress::Progress,
    record::Recorder,
};

/// Seconds between two readings while current flows.
const POLL_S: f64 = 1.0;
/// With its command at zero the bipolar supply may drive this much, A: more is a zero error that wants trimming.
const IDLE_CURRENT_A: f64 = 0.2;
/// With every output off a control shows less than this, V: thermal voltages, and the zero error of a meter. Any cell shows more.
const CONTROL_IDLE_V: f64 = 0.2;
/// The gain error of a meter, as part of a step's envelope.
const METER_GAIN: f64 = 1.1;
/// A temperature is read with every so many readings.
const TEMPERATURE_EVERY: u32 = 10;

/// Executes stages on a bench.
pub struct Executor<'a> {
    /// The instruments.
    pub bench: &'a mut Bench,
    /// What is being done.
    pub experiment: &'a Experiment,
    /// Bench time.
    pub clock: Clock,
    /// Where everything is written.
    pub recorder: &'a mut Recorder,
    /// Who changes the fixture, where no device does.
    pub operator: &'a Operator,
    /// What the person watching sees.
    pub progress: &'a Progress,
    /// What takes the harness off the channels.
    pub correction: Correction,
    /// What was read of the cell before the bipolar supply went on last.
    pub idle: Reading,
    /// What the lines of multisines say besides their impedance, until somebody takes it.
    pub lines: Vec<Line>,
    /// What the scope's channels are to be set to.
    verticals: [Option<Vertical>; 4],
    /// What they were last set to.
    applied: [Option<Vertical>; 4],
    /// Level of the trigger; follows the signal.
    trigger_v: Volts,
    /// What the step in work may expose the cell to.
    envelope: Limits,
    polls: u32,
    /// What was clamped into the jig last.
    mounted: Option<Fixture>,
    /// Number of the sweep, 0 for a control.
    repeat: usize,
    /// Points that the scope's memory was last set to.
    memory_points: Option<u64>,
    /// What the channels show while nothing flows.
    zero: Option<trace::Zero>,
    /// Charge that traces have left in the cell, C.
    charge_c: f64,
    /// The cell's temperature when it was read last, °C.
    last_c: Option<f64>,
    /// The logger scans nothing before it was told what.
    logger_ready: bool,
    /// The readings of the legs so far.
    legs: leg::Legs,
    /// When the scope was stopped last, s.
    stopped_s: f64,
    /// Where the reset of the state of charge stands.
    reset: dc::Reset,
    /// What went into measuring points of the sweep again.
    spent: gate::Spent,
}

/// The event from which on current may flow.
pub const OUTPUT_ON: &str = "bipolar supply: output on";

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
            envelope: experiment.cell.limits,
            polls: 0,
            mounted: None,
            repeat: 0,
            memory_points: None,
            zero: None,
            charge_c: 0.0,
            last_c: None,
            logger_ready: false,
            legs: leg::Legs::default(),
            stopped_s: 0.0,
            reset: dc::Reset::default(),
            spent: gate::Spent::default(),
        }
    }

    /// Executes one stage; `on_point` gets every finished point as soon as its capture is on disk.
    ///
    /// # Errors
    /// The first thing that went wrong. The outputs may then still be on.
    pub async fn stage(
        &mut self,
        stage: &Stage,
        on_point: &mut dyn FnMut(&mut Recorder, &SweepPoint) -> Result<(), ExecuteError>,
    ) -> Result<Vec<SweepPoint>, ExecuteError> {
        tracing::info!("stage: {}", stage.purpose);
        self.recorder.event(&stage.purpose.to_string())?;
        let mut points = Vec::new();
        let mut fixture = Fixture::Cell;
        self.repeat = if let Purpose::Sweep(_, repeat) | Purpose::Multisine(repeat) = stage.purpose { repeat } else { 0 };
        self.spent = gate::Spent::default();
        self.reset = dc::Reset::default();
        for step in &stage.steps {
            if self.reset.accepted {
                break;
            }
            tracing::info!("step: {step}");
            self.recorder.event(&step.to_string())?;
            self.progress.begin(&stage.purpose.to_string(), step);
            self.set_envelope(fixture, step);
            match *step {
                Step::Mount(other) => {
                    fixture = other;
                    self.mount(other).await?;
                }
                Step::HoldTemperature { .. } => self.hold_temperature(step).await?,
                Step::Discharge { .. } => self.discharge(step).await?,
                Step::Charge { .. } => self.charge(step).await?,
                Step::Rest { .. } => self.rest(step).await?,
                Step::Accept { band_v, missed } => self.accept(band_v, missed)?,
                Step::Leg(leg) => self.leg(&leg).await?,
                Step::PowerUp { compliance_v, limit_a, .. } => {
                    let limits = supply4q::Limits { compliance: Volts(compliance_v), current: Amps(limit_a) };
                    self.power_up(fixture, &limits).await?;
                }
                Step::Sine { .. } => {
                    let point = self.gated(fixture, step).await?;
                    on_point(self.recorder, &point)?;
                    points.push(point);
                }
                Step::Multisine(ref band) => points.extend(self.multisine(band).await?),
                Step::Recheck { .. } => self.recheck(fixture, stage, &mut points).await?,
                Step::Pause { span_s } => self.pause(span_s).await?,
                Step::Zero(ref trace) => self.zero(trace).await?,
                Step::Trace(ref trace) => self.trace(trace).await?,
                Step::PowerDown => self.power_down().await?,
            }
            self.progress.end(step);
        }
        Ok(points)
    }

    /// What may flow during a step is far less than what the cell could bear.
    fn set_envelope(&mut self, fixture: Fixture, step: &Step) {
        let mut cell = self.experiment.cell.limits;
        if fixture != Fixture::Cell {
            cell = cell.of_control();
        }
        let drawn = |amps: f64| METER_GAIN * amps + NO_CURRENT_A;
        self.envelope = match *step {
            Step::Discharge { current_a, .. } => cell.bounded(NO_CURRENT_A, drawn(current_a)),
            Step::Charge { current_a, .. } => cell.bounded(drawn(current_a), NO_CURRENT_A),
            Step::Leg(leg) => {
                let (charge_a, discharge_a) = leg.most_a();
                cell.bounded(drawn(charge_a), drawn(discharge_a))
            }
            Step::PowerUp { limit_a, .. } => cell.bounded(limit_a, limit_a),
            // Between power-up and power-down the limit of the power-up holds.
            Step::Sine { .. } | Step::Multisine(_) | Step::Recheck { .. } | Step::PowerDown => self.envelope,
            Step::Trace(ref trace) => {
                let (least_a, greatest_a) = trace.extremes_a();
                self.envelope.bounded(drawn(greatest_a), drawn(-least_a))
            }
            Step::Mount(_)
            | Step::Accept { .. }
            | Step::Pause { .. }
            | Step::Zero(_)
            | Step::HoldTemperature { .. }
            | Step::Rest { .. } => cell.bounded(NO_CURRENT_A, NO_CURRENT_A),
        };
    }

    async fn mount(&mut self, fixture: Fixture) -> Result<(), ExecuteError> {
        self.bench.safe_state().await.map_err(first)?;
        let error = self.bench.error("load");
        if let Some(load) = self.bench.load.as_mut() {
            // From here on it is the cell's voltmeter.
            load.watch().await.map_err(error)?;
        }
        self.verticals = [None; 4];
        self.trigger_v = Volts(0.0);
        if fixture == Fixture::Short {
            // A bar across a cell is a dead short, whatever the outputs do: it is looked for before anybody reaches into the jig.
            self.refuse_a_cell("before mounting the short").await?;
        }
        match (&self.experiment.bench.instruments.jig, self.bench.jig.as_mut()) {
            (Some(config::Jig::Device(_)), Some(jig)) => {
                let mounted = jig.mount(fixture).await;
                mounted.map_err(self.bench.error("jig"))?;
            }
            // Whoever put it there need not be asked again.
            (Some(config::Jig::Person), _) if self.mounted == Some(fixture) => {}
            (Some(config::Jig::Person), _) => self.operator.mount(fixture).await?,
            // Without a jig only the cell is ever asked for: it is what is in there.
            _ => {}
        }
        self.mounted = Some(fixture);
        if fixture == Fixture::Short {
            self.refuse_a_cell("after mounting the short").await?;
        }
        Ok(())
    }

    async fn power_up(&mut self, fixture: Fixture, limits: &supply4q::Limits) -> Result<(), ExecuteError> {
        let error = self.bench.error("generator");
        let offset = Volts(self.experiment.bench.wiring.command_offset_v);
        let generator = require(&mut self.bench.generator, "generator")?;
        generator.output(false).await.map_err(&error)?;
        generator.quiet(offset).await.map_err(&error)?;
        let error = self.bench.error("supply4q");
        let supply = require(&mut self.bench.supply4q, "supply4q")?;
        supply.prepare(limits).await.map_err(&error)?;
        if fixture == Fixture::Cell {
            // A cell that is missing, reversed, ruined or too hot must not be driven: it is read while the output is still off.
            let mut reading = self.read_supply4q().await?;
            reading.temperature_c = self.cell_temperature().await?;
            self.idle = reading;
            self.judge("idle", reading)?;
        } else {
            self.refuse_a_cell(&format!("driving the {}", fixture_name(fixture))).await?;
        }
        let scope_error = self.bench.error("scope");
        if let Some(eis) = &self.experiment.eis {
            let memory_points = eis.memory_points;
            let scope = require(&mut self.bench.scope, "scope")?;
            scope.set(&instruments::scope::Intent::Session { memory_points }).await.map_err(scope_error)?;
            self.memory_points = Some(memory_points);
        }
        // The generator holds the offset that brings the supply's zero error to zero current before the output goes on.
        let generator_error = self.bench.error("generator");
        require(&mut self.bench.generator, "generator")?.output(true).await.map_err(generator_error)?;
        self.recorder.event(OUTPUT_ON)?;
        require(&mut self.bench.supply4q, "supply4q")?.energise().await.map_err(&error)?;
        let idle_a = self.watch("idle", fixture).await?.current_a.unwrap_or(0.0);
        let allowed_a =
            IDLE_CURRENT_A.min(self.experiment.eis.as_ref().map_or(f64::INFINITY, |eis| 0.5 * eis.amplitude_a)).max(NO_CURRENT_A);
        if idle_a.abs() > allowed_a {
            return Err(ExecuteError::Disobeyed {
                what: "bipolar supply with its command at zero".to_owned(),
                expected: format!("less than {allowed_a} A"),
                met: format!("{idle_a:.3} A: adjust wiring.command_offset"),
            });
        }
        Ok(())
    }

    /// Reads the voltage at the jig, every output off, and refuses one that no control has. A reading that is not a number is refused too.
    async fn refuse_a_cell(&mut self, what: &str) -> Result<(), ExecuteError> {
        let reading = self.read_supply4q().await?;
        self.recorder.reading("idle", &reading)?;
        let volts = reading.voltage_v.unwrap_or(f64::NAN);
        if volts.abs() <= CONTROL_IDLE_V { Ok(()) } else { Err(ExecuteError::CellLeftIn { what: what.to_owned(), volts }) }
    }

    async fn power_down(&mut self) -> Result<(), ExecuteError> {
        let error = self.bench.error("supply4q");
        require(&mut self.bench.supply4q, "supply4q")?.safe().await.map_err(error)?;
        let error = self.bench.error("generator");
        require(&mut self.bench.generator, "generator")?.safe().await.map_err(error)?;
        Ok(())
    }

    /// Waits, reading and judging the bipolar supply all the while.
    async fn wait_watching(&mut self, seconds: f64, fixture: Fixture) -> Result<(), ExecuteError> {
        let end_s = self.clock.now_s() + seconds;
        loop {
            let left_s = end_s - self.clock.now_s();
            if left_s <= 0.0 {
                return Ok(());
            }
            self.clock.sleep_s(left_s.min(POLL_S)).await;
            self.watch("sine", fixture).await?;
        }
    }

    /// One reading of the bipolar supply, judged.
    async fn watch(&mut self, phase: &str, fixture: Fixture) -> Result<Reading, ExecuteError> {
        let reading = self.read_supply4q().await?;
        self.recorder.reading(phase, &reading)?;
        // The thermocouple is on the cell, which lies outside the jig while a control is in it, before anything has brought it to a temperature.
        let temperature_c = reading.temperature_c.filter(|_| fixture == Fixture::Cell);
        match interlock::judge(&self.envelope, &Reading { temperature_c, ..reading }) {
            Some(trip) if fixture != Fixture::Cell => Err(trip.of_control().into()),
            Some(trip) => Err(trip.into()),
            None => Ok(reading),
        }
    }

    async fn read_supply4q(&mut self) -> Result<Reading, ExecuteError> {
        let error = self.bench.error("supply4q");
        let (mut volts, amps) = require(&mut self.bench.supply4q, "supply4q")?.measure().await.map_err(error)?;
        // The supply sees the drop of its leads; the load, with its input off, is a voltmeter at the jig.
        let error = self.bench.error("load");
        if let Some(load) = self.bench.load.as_mut() {
            volts = load.measure().await.map_err(error)?.0;
        }
        let temperature_c = self.temperature_now_and_then().await?;
        Ok(Reading { time_s: self.clock.now_s(), voltage_v: Some(volts.value()), current_a: Some(amps.value()), temperature_c })
    }

    /// The cell's temperature with every tenth reading.
    async fn temperature_now_and_then(&mut self) -> Result<Option<f64>, ExecuteError> {
        self.polls = self.polls.wrapping_add(1);
        if self.polls.is_multiple_of(TEMPERATURE_EVERY) { self.cell_temperature().await } else { Ok(None) }
    }

    /// The cell's temperature; nothing on a bench without a logger. An open thermocouple is a reading that is no number, and trips.
    async fn cell_temperature(&mut self) -> Result<Option<f64>, ExecuteError> {
        let error = self.bench.error("logger");
        let Some(logger) = self.bench.logger.as_mut() else { return Ok(None) };
        if !self.logger_ready {
            logger.configure().await.map_err(&error)?;
            self.logger_ready = true;
        }
        let readings = logger.scan().await.map_err(error)?;
        self.last_c = Some(readings.first().copied().flatten().map_or(f64::NAN, |celsius| celsius.value()));
        Ok(self.last_c)
    }

    fn judge(&mut self, phase: &str, reading: Reading) -> Result<(), ExecuteError> {
        self.recorder.reading(phase, &reading)?;
        match interlock::judge(&self.envelope, &reading) {
            Some(trip) => Err(trip.into()),
            None => Ok(()),
        }
    }
}

/// The instrument of a role, or a complaint that the bench lacks it.
fn require<'b, T>(instrument: &'b mut Option<T>, role: &'static str) -> Result<&'b mut T, BenchError> {
    instrument.as_mut().ok_or(BenchError::Missing { role })
}

fn first(mut failures: Vec<BenchError>) -> BenchError {
    // Never empty: an empty list is no failure.
    failures.drain(..).next().unwrap_or(BenchError::Missing { role: "supply4q" })
}
