//! `eis-bench run`: from an experiment file to a fitted model.
//!
//! Whatever happens once the instruments are known to be the configured ones, a panic and a request to stop included, the bench is brought into safe
//! state before this returns.

mod drive;
mod manifest;
mod multisine;
mod past;
mod results;
mod sweeping;

use std::{
    collections::BTreeMap,
    panic::AssertUnwindSafe,
    path::{Path, PathBuf},
    task::Poll,
};

use analysis::{calibration::Correction, spectrum::Spectrum};
use drive::Before;
use instruments::{
    clock::{Clock, TimeMode},
    mock::plant::Fixture,
    transport::MemoryHub,
};
pub(crate) use past::{Past, begun_experiment};
use tokio::{
    runtime::Runtime,
    signal::unix::{Signal, SignalKind, signal},
};

use crate::terminal::say;
use crate::{
    bench::{Bench, BenchError, Connections, Identified},
    cli::RunArgs,
    command::Failure,
    config::{self, Experiment, load_experiment},
    custody::{self, Custody},
    doctor,
    drill::Drill,
    executor::SweepPoint,
    fixture_check::ControlResult,
    journal::Entry,
    logging,
    operator::Operator,
    plan::Checked,
    procedure,
    progress::Progress,
    record::Recorder,
    sim::Simulation,
};

pub use multisine::MultisineRun;

/// What a run measured.
#[derive(Debug)]
pub struct Measured {
    /// The controls' verdicts.
    pub controls: Vec<ControlResult>,
    /// Points as read, by fixture.
    pub sweeps: BTreeMap<&'static str, Vec<SweepPoint>>,
    /// The correction of the bench.
    pub correction: Correction,
    /// The corrected spectrum of the cell, of its first sweep; without points where it was not swept.
    pub spectrum: Spectrum,
    /// Those of its further sweeps.
    pub repeats: Vec<Spectrum>,
    /// All of them with the noise of their own records only: what the correction leaves uncertain is the same in each.
    pub own_noise: Vec<Spectrum>,
    /// The points of all of them as read.
    pub points: Vec<Vec<SweepPoint>>,
    /// They are runs of a campaign, and called after cell and repeat.
    pub campaign: bool,
    /// What multisines measured of the cell.
    pub multisines: Vec<MultisineRun>,
}

impl Measured {
    /// The corrected spectra of all sweeps of the cell.
    pub fn spectra(&self) -> impl Iterator<Item = &Spectrum> {
        std::iter::once(&self.spectrum).chain(&self.repeats).filter(|spectrum| !spectrum.points.is_empty())
    }

    /// What each of them is called among the others; nothing where there is no other.
    pub fn names(&self) -> Vec<String> {
        let several = self.repeats.iter().any(|spectrum| !spectrum.points.is_empty());
        let name = |(number, spectrum): (usize, &Spectrum)| match (several, self.campaign) {
            (_, true) => spectrum.name.clone(),
            (true, false) => format!("sweep {number}"),
            (false, false) => String::new(),
        };
        (1..).zip(self.spectra()).map(name).collect()
    }

    /// What the first of them is called, where there are others.
    pub(super) fn first_of_several(&self) -> Option<String> {
        self.names().into_iter().next().filter(|_| !self.repeats.is_empty())
    }
}

/// Runs an experiment.
///
/// # Errors
/// A mistake in the files, before anything is energised; later anything that ended the run, the bench in safe state.
pub fn run(args: &RunArgs) -> Result<(), Failure> {
    let mut experiment = load_experiment(&args.experiment, args.bench.as_deref())?;
    experiment.seed = args.seed.unwrap_or(experiment.seed);
    let folder = args.out.clone().unwrap_or_else(|| free_folder(&experiment.name));
    let finished = run_experiment(&experiment, &folder)?;
    say!("{}", finished.summary.trim_end());
    Ok(())
}

/// A run that went to its end.
pub struct Finished {
    /// What was measured.
    pub measured: Measured,
    /// What the terminal shows.
    pub summary: String,
    /// The simulated world, where there is one in this process.
    pub simulation: Option<Simulation>,
}

/// Runs an experiment into a folder.
///
/// # Errors
/// As [`run`].
pub fn run_experiment(experiment: &Experiment, folder: &Path) -> Result<Finished, Failure> {
    Session::new(&experiment.bench)?.run(experiment, folder)
}

/// Runs on one bench, one after the other: time goes on from run to run, and so does a simulated world; the bench's correction stays.
pub struct Session {
    runtime: Option<Runtime>,
    clock: Clock,
    simulation: Option<Simulation>,
    correction: Option<Correction>,
}

impl Session {
    /// A bench on which nothing was run yet.
    ///
    /// # Errors
    /// What the system says when it has no event queue.
    pub fn new(bench: &config::Bench) -> Result<Self, Failure> {
        let mode = bench.simulation.as_ref().map_or(TimeMode::Real, |simulation| simulation.time);
        let runtime = Clock::runtime(mode)?;
        let clock = runtime.block_on(async { Clock::start(mode) });
        Ok(Self { runtime: Some(runtime), clock, simulation: None, correction: None })
    }

    /// Bench time, s.
    pub fn now_s(&self) -> f64 {
        self.runtime.as_ref().map_or(0.0, |runtime| runtime.block_on(async { self.clock.now_s() }))
    }

    /// A bench on which a run goes on whose journal ends at a bench time, s.
    ///
    /// # Errors
    /// As [`Session::new`].
    pub(super) fn at(bench: &config::Bench, time_s: f64) -> Result<Self, Failure> {
        let mut session = Self::new(bench)?;
        if let Some(runtime) = &session.runtime {
            session.clock = runtime.block_on(async { Clock::start_at(session.clock.mode(), time_s) });
        }
        Ok(session)
    }

    /// The simulated world behind the mocks, where there is one in this process and something was run on it, however it ended.
    pub fn simulation(&self) -> Option<&Simulation> {
        self.simulation.as_ref()
    }

    /// Runs an experiment into a folder. One without controls of its own takes over the correction of the run before.
    ///
    /// # Errors
    /// As [`run`].
    pub fn run(&mut self, experiment: &Experiment, folder: &Path) -> Result<Finished, Failure> {
        self.play(experiment, folder, None)
    }

    /// Goes on with a run in its folder.
    ///
    /// # Errors
    /// As [`run`].
    pub(super) fn go_on(&mut self, experiment: &Experiment, folder: &Path, past: Past) -> Result<Finished, Failure> {
        self.play(experiment, folder, Some(past))
    }

    fn play(&mut self, experiment: &Experiment, folder: &Path, past: Option<Past>) -> Result<Finished, Failure> {
        let plan = procedure::plan(experiment).check(&experiment.cell.limits)?;
        let operator = Operator::detect();
        refuse_without_person(experiment, operator)?;
        let Some(runtime) = &self.runtime else { return Err(Failure::Panic("the bench's session has ended".to_owned())) };
        let inherited_world = self.simulation.is_some();
        if !inherited_world {
            self.simulation = simulated(experiment)?;
        }
        let (clock, simulation) = (self.clock.clone(), self.simulation.clone());
        let inherited = self.correction.clone().filter(|_| experiment.fixture_check.is_none());
        custody::refuse(&experiment.bench)?;
        let drill = Drill::from_environment(experiment.bench.simulation.is_some()).map_err(Failure::Usage)?;
        let finished = runtime.block_on(async {
            let mut recorder = match &past {
                None => Recorder::create(folder, clock.clone())?,
                Some(past) => Recorder::reopen(folder, clock.clone(), (&past.read, &past.story))?,
            };
            recorder.drill(&drill);
            logging::log_to(&recorder.path("log.txt"), &clock)?;
            let before = (simulation, inherited);
            Box::pin(Run { experiment, plan: &plan, clock, operator, recorder, before, inherited_world, past }.go()).await
        })?;
        self.correction = Some(finished.measured.correction.clone());
        Ok(finished)
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        // A thread that still waits for a person's answer must not hold up the end.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// The world behind in-process addresses; with addresses on real ports somebody else serves it.
fn simulated(experiment: &Experiment) -> Result<Option<Simulation>, Failure> {
    let bench = &experiment.bench;
    let Some(section) = bench.simulation.as_ref().filter(|_| bench.in_process()) else { return Ok(None) };
    let read = experiment.sources.iter().find(|source| source.path() == section.scenario);
    let simulation = match read {
        Some(scenario) => Simulation::of(scenario, experiment.seed)?,
        None => Simulation::new(&section.scenario, experiment.seed)?,
    };
    Ok(Some(simulation.with_faults(section.faults.clone())))
}

/// A sweep that begins with a person changing the fixture must not fail in the middle of the night for want of one.
fn refuse_without_person(experiment: &Experiment, operator: Operator) -> Result<(), Failure> {
    let person = matches!(experiment.bench.instruments.jig, Some(config::Jig::Person));
    let cells = experiment.campaign.as_ref().is_some_and(|campaign| campaign.cells.len() > 1);
    let shunt = experiment.eis.as_ref().is_some_and(|eis| eis.fixture == Fixture::Shunt && eis.repeat > 0);
    if person && (experiment.fixture_check.is_some() || shunt || cells) && operator == Operator::Nobody {
        return Err(Failure::Usage(crate::operator::OperatorError::NoTerminal.to_string()));
    }
    Ok(())
}

fn free_folder(name: &str) -> PathBuf {
    let taken = |path: &Path| std::fs::read_dir(path).is_ok_and(|mut entries| entries.next().is_some());
    let first = PathBuf::from("runs").join(name);
    if !taken(&first) {
        return first;
    }
    (2_u32..).map(|number| PathBuf::from("runs").join(format!("{name}-{number}"))).find(|path| !taken(path)).unwrap_or(first)
}

struct Run<'a> {
    experiment: &'a Experiment,
    plan: &'a Checked,
    clock: Clock,
    operator: Operator,
    recorder: Recorder,
    /// The simulated world, and the correction where that of a run before is to be kept.
    before: (Option<Simulation>, Option<Correction>),
    /// A run before has used this simulated world.
    inherited_world: bool,
    /// What was done of this run before its process died or was stopped.
    past: Option<Past>,
}

impl Run<'_> {
    async fn go(mut self) -> Result<Finished, Failure> {
        match &self.past {
            None => self.begin()?,
            Some(past) => past.tell(&mut self.recorder, self.plan.plan())?,
        }
        let hub = MemoryHub::new();
        let simulation = self.before.0.take();
        if let Some(simulation) = &simulation {
            simulation.serve_in_process(&self.experiment.bench, &self.clock, &hub)?;
        }
        let mut taps = BTreeMap::new();
        for (role, _) in self.experiment.bench.instruments.addressed() {
            taps.insert(role, self.recorder.tap(role)?);
        }
        let mut stop = StopSignals::install()?;
        let connections = Connections { clock: self.clock.clone(), hub, taps };
        if self.experiment.bench.instruments.logger.is_none() {
            self.recorder.warning("nothing watches the cell's temperature: the bench has no logger");
        }
        let progress = Progress::new(self.plan.plan());
        let mut custody = tokio::select! {
            taken = Custody::take(self.experiment, self.recorder.folder(), (&self.clock, progress.doing())) => taken?,
            () = stop.requested() => return Err(Failure::Interrupted(self.recorder.folder().display().to_string())),
        };
        let (mut bench, identities) = match self.open(&connections).await {
            Ok(opened) => opened,
            Err(failure) => return custody.end(Err(failure)).await,
        };
        let around = (&self.clock, &self.operator, &progress);
        let before = Before { inherited: self.before.1.take(), past: self.past.as_ref() };
        let outcome = tokio::select! {
            outcome = caught(drive::drive((&mut bench, &mut self.recorder), self.experiment, self.plan, around, before)) => outcome,
            () = stop.requested() => Err(Failure::Interrupted(self.recorder.folder().display().to_string())),
            lost = custody.lost() => Err(lost.into()),
        };
        progress.finish();
        let outcome = match caught(async { Ok(bench.safe_state().await) }).await {
            Ok(safe_state) => safe(safe_state, outcome),
            Err(panic) => Err(Failure::Unsafe { failures: panic.to_string(), cause: String::new() }),
        };
        // What could not be switched off is left to the guardian, which needs the instruments for itself.
        drop(bench);
        let outcome = custody.end(outcome).await;
        for (role, tap) in &connections.taps {
            if let Some(error) = tap.take_error() {
                self.recorder.warning(&format!("the transcript of {role} is incomplete: {error}"));
            }
        }
        let happened = simulation.as_ref().map(Simulation::happened).unwrap_or_default();
        if !happened.is_empty() {
            self.recorder.warning(&format!("{} faults were played on the simulated instruments: faults.json", happened.len()));
            self.recorder.json("faults.json", &happened)?;
        }
        let readings = self.recorder.finish_readings();
        match outcome {
            Ok(measured) => {
                self.recorder.journal(Entry::Safe)?;
                let summary = readings.map_err(Failure::from).and_then(|()| results::write(&mut self.recorder, self.experiment, &measured));
                let summary = match summary {
                    Ok(summary) => summary,
                    Err(failure) => {
                        self.ended_early(&identities, "measured, but not evaluated", &failure);
                        return Err(failure);
                    }
                };
                self.manifest(&identities, "finished")?;
                self.recorder.journal(Entry::Ended { how: FINISHED.to_owned() })?;
                Ok(Finished { measured, summary, simulation })
            }
            Err(failure) => {
                self.ended_early(&identities, "ended early", &failure);
                Err(failure)
            }
        }
    }

    /// Connects to the instruments, which must be the configured ones. Changes nothing on them.
    async fn open(&mut self, connections: &Connections) -> Result<(Bench, Vec<Identified>), Failure> {
        let mut bench = Bench::open(&self.experiment.bench, connections).await?;
        let identities = bench.identify_strictly().await?;
        self.doctored(&identities)?;
        self.manifest(&identities, "running")?;
        if self.past.is_some() {
            self.reconcile(&mut bench).await?;
        }
        Ok((bench, identities))
    }

    /// A bench that no report of the doctor speaks for is remarked, or refused where its file wants one.
    fn doctored(&mut self, identities: &[Identified]) -> Result<(), Failure> {
        let config = &self.experiment.bench;
        let source = self.experiment.sources.iter().find(|source| source.path() == config.path);
        let Some(why) = doctor::standing(config, source.map_or("", |source| source.text()), identities) else { return Ok(()) };
        let what = format!("{why}; `eis-bench doctor {}` looks at it", config.path.display());
        if config.doctor.required {
            return Err(Failure::Usage(format!("the bench file requires a report of the doctor: {what}")));
        }
        self.recorder.warning(&what);
        Ok(())
    }

    /// The reason for the end outweighs a manifest that cannot be written.
    fn ended_early(&mut self, identities: &[Identified], how: &str, failure: &Failure) {
        tracing::info!("{how}: {failure}");
        let told = self.manifest(identities, &format!("{how}: {failure}"));
        let told = told.and(self.recorder.journal(Entry::Ended { how: format!("{how}: {failure}") }).map_err(Failure::from));
        if let Err(error) = told {
            tracing::error!("{error}");
        }
    }
}

/// Safe state that could not be verified outweighs everything else.
fn safe<T>(safe: Result<(), Vec<BenchError>>, outcome: Result<T, Failure>) -> Result<T, Failure> {
    match safe {
        Ok(()) => outcome,
        Err(failures) => Err(Failure::Unsafe {
            failures: failures.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "),
            cause: outcome.err().map_or_else(String::new, |failure| format!(" (after: {failure})")),
        }),
    }
}

/// Number of the signal that Ctrl-Z sends, on Linux.
const SIGTSTP: i32 = 20;

/// Ctrl-C, a polite kill, or the end of the terminal: each is to bring the bench into safe state.
pub(crate) struct StopSignals([Signal; 5]);

impl StopSignals {
    /// From now on these signals no longer end the process by themselves.
    ///
    /// # Errors
    /// A system that refuses: a run that cannot be stopped must not begin.
    pub(crate) fn install() -> std::io::Result<Self> {
        // Ctrl-Z would stop the watching and leave the current flowing: it ends the run like Ctrl-C.
        let suspend = SignalKind::from_raw(SIGTSTP);
        let [interrupt, terminate, hangup, quit, suspend] =
            [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup(), SignalKind::quit(), suspend].map(signal);
        Ok(Self([interrupt?, terminate?, hangup?, quit?, suspend?]))
    }

    /// Waits for the first of them.
    pub(crate) async fn requested(&mut self) {
        let [interrupt, terminate, hangup, quit, suspend] = &mut self.0;
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
            _ = hangup.recv() => {}
            _ = quit.recv() => {}
            _ = suspend.recv() => {}
        }
    }
}

/// A panic while the outputs are on must not keep them on: it becomes a failure like any other.
pub(crate) async fn caught<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let mut work = Box::pin(work);
    std::future::poll_fn(move |context| {
        std::panic::catch_unwind(AssertUnwindSafe(|| work.as_mut().poll(context))).unwrap_or_else(|panic| {
            let text = panic.downcast_ref::<String>().cloned().or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            Poll::Ready(Err(Failure::Panic(text.unwrap_or_default())))
        })
    })
    .await
}

/// How a run ends of which nothing is left to do.
pub(super) const FINISHED: &str = "finished";

fn folder_of(path: &Path) -> String {
    path.parent().and_then(Path::file_name).map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_a_failure() {
        let runtime = Clock::runtime(TimeMode::Real).unwrap();
        let outcome: Result<(), Failure> = runtime.block_on(caught(async { panic!("out of range") }));
        assert!(matches!(&outcome, Err(Failure::Panic(text)) if text == "out of range"), "{outcome:?}");
    }
}
