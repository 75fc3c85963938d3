//! `eis-bench run`: from an experiment file to a fitted model.
//!
//! Whatever happens once the instruments are known to be the configured ones, a panic and a request to stop included, the bench is brought into safe
//! state before this returns.

mod drive;
mod multisine;
mod results;

use std::{
    collections::BTreeMap,
    panic::AssertUnwindSafe,
    path::{Path, PathBuf},
    task::Poll,
};

use analysis::{calibration::Correction, spectrum::Spectrum};
use instruments::{
    clock::{self, Clock, TimeMode},
    mock::plant::Fixture,
    transport::{Address, MemoryHub},
};
use serde::Serialize;
use sha2::{Digest, Sha256};
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
    executor::SweepPoint,
    fixture_check::ControlResult,
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
    /// What multisines measured of the cell.
    pub multisines: Vec<MultisineRun>,
}

/// What ran, for whoever wants to run it again.
#[derive(Debug, Serialize)]
struct Manifest<'a> {
    program: &'static str,
    version: &'static str,
    experiment: &'a str,
    bench: &'a str,
    cell: &'a config::Cell,
    seed: u64,
    time: String,
    simulated: bool,
    config_sha256: String,
    files: BTreeMap<String, String>,
    started_unix_s: Option<f64>,
    instruments: &'a [Identified],
    status: &'a str,
    bench_time_s: f64,
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

    /// Runs an experiment into a folder. One without controls of its own takes over the correction of the run before.
    ///
    /// # Errors
    /// As [`run`].
    pub fn run(&mut self, experiment: &Experiment, folder: &Path) -> Result<Finished, Failure> {
        let plan = procedure::plan(experiment).check(&experiment.cell.limits)?;
        let operator = Operator::detect();
        refuse_without_person(experiment, operator)?;
        let Some(runtime) = &self.runtime else { return Err(Failure::Panic("the bench's session has ended".to_owned())) };
        let (clock, simulation) = (self.clock.clone(), self.simulation.clone());
        let inherited = self.correction.clone().filter(|_| experiment.fixture_check.is_none());
        let finished = runtime.block_on(async {
            let recorder = Recorder::create(folder, clock.clone())?;
            logging::log_to(&recorder.path("log.txt"), &clock)?;
            Box::pin(Run { experiment, plan: &plan, clock, operator, recorder, before: (simulation, inherited) }.go()).await
        })?;
        self.simulation.clone_from(&finished.simulation);
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

/// A sweep that begins with a person changing the fixture must not fail in the middle of the night for want of one.
fn refuse_without_person(experiment: &Experiment, operator: Operator) -> Result<(), Failure> {
    let person = matches!(experiment.bench.instruments.jig, Some(config::Jig::Person));
    let shunt = experiment.eis.as_ref().is_some_and(|eis| eis.fixture == Fixture::Shunt && eis.repeat > 0);
    if person && (experiment.fixture_check.is_some() || shunt) && operator == Operator::Nobody {
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
    /// What the runs before left: the simulated world, and the correction where it is to be kept.
    before: (Option<Simulation>, Option<Correction>),
}

impl Run<'_> {
    async fn go(mut self) -> Result<Finished, Failure> {
        for source in &self.experiment.sources {
            let name = source.path().file_name().map_or_else(|| "config.toml".into(), |name| name.to_string_lossy());
            self.recorder.text(&format!("config/{}_{name}", folder_of(source.path())), source.text())?;
        }
        let hub = MemoryHub::new();
        let simulation = self.simulate(&hub)?;
        let mut taps = BTreeMap::new();
        for (role, _) in self.experiment.bench.instruments.addressed() {
            taps.insert(role, self.recorder.tap(role)?);
        }
        let mut stop = StopSignals::install()?;
        let connections = Connections { clock: self.clock.clone(), hub, taps };
        if self.experiment.bench.instruments.logger.is_none() {
            self.recorder.warning("nothing watches the cell's temperature: the bench has no logger");
        }
        let mut bench = Bench::open(&self.experiment.bench, &connections).await?;
        let identities = bench.identify_strictly().await?;
        self.manifest(&identities, "running")?;
        let progress = Progress::new(self.plan.plan());
        let (around, inherited) = ((&self.clock, &self.operator, &progress), self.before.1.take());
        let outcome = tokio::select! {
            outcome = caught(drive::drive((&mut bench, &mut self.recorder), self.experiment, self.plan, around, inherited)) => outcome,
            () = stop.requested() => Err(Failure::Interrupted(self.recorder.folder().display().to_string())),
        };
        progress.finish();
        let outcome = match caught(async { Ok(bench.safe_state().await) }).await {
            Ok(safe_state) => safe(safe_state, outcome),
            Err(panic) => Err(Failure::Unsafe { failures: panic.to_string(), cause: String::new() }),
        };
        for (role, tap) in &connections.taps {
            if let Some(error) = tap.take_error() {
                self.recorder.warning(&format!("the transcript of {role} is incomplete: {error}"));
            }
        }
        let readings = self.recorder.finish_readings();
        match outcome {
            Ok(measured) => {
                let summary = readings
                    .map_err(Failure::from)
                    .and_then(|()| results::write(&mut self.recorder, self.experiment, &measured))
                    .inspect_err(|failure| self.ended_early(&identities, "measured, but not evaluated", failure))?;
                self.manifest(&identities, "finished")?;
                Ok(Finished { measured, summary, simulation })
            }
            Err(failure) => {
                self.ended_early(&identities, "ended early", &failure);
                Err(failure)
            }
        }
    }

    /// The reason for the end outweighs a manifest that cannot be written.
    fn ended_early(&self, identities: &[Identified], how: &str, failure: &Failure) {
        tracing::info!("{how}: {failure}");
        if let Err(error) = self.manifest(identities, &format!("{how}: {failure}")) {
            tracing::error!("{error}");
        }
    }

    /// The world behind in-process addresses; with addresses on real ports somebody else serves it.
    fn simulate(&self, hub: &MemoryHub) -> Result<Option<Simulation>, Failure> {
        let bench = &self.experiment.bench;
        let in_process = bench.instruments.addressed().iter().any(|(_, instrument)| matches!(instrument.address, Address::Memory { .. }));
        let Some(section) = bench.simulation.as_ref().filter(|_| in_process) else { return Ok(None) };
        let known = self.before.0.clone();
        let simulation = known.map_or_else(|| Simulation::new(&section.scenario, self.experiment.seed), Ok)?;
        simulation.serve_in_process(bench, &self.clock, hub)?;
        Ok(Some(simulation))
    }

    fn manifest(&self, instruments: &[Identified], status: &str) -> Result<(), Failure> {
        let mode = self.clock.mode();
        let mut whole = Sha256::new();
        let mut files = BTreeMap::new();
        for source in &self.experiment.sources {
            whole.update(source.text());
            files.insert(source.path().display().to_string(), hex(&Sha256::digest(source.text())));
        }
        let manifest = Manifest {
            program: "eis-bench",
            version: env!("CARGO_PKG_VERSION"),
            experiment: &self.experiment.name,
            bench: &self.experiment.bench.name,
            cell: &self.experiment.cell,
            seed: self.experiment.seed,
            time: mode.to_string(),
            simulated: self.experiment.bench.simulation.is_some(),
            config_sha256: hex(&whole.finalize()),
            files,
            // In virtual time the calendar has no meaning, and two runs are to write the same file.
            started_unix_s: (mode != TimeMode::Virtual).then(|| clock::unix_time_s() - self.clock.now_s()),
            instruments,
            status,
            bench_time_s: (self.clock.now_s() * 1.0e3).round() / 1.0e3,
        };
        Ok(self.recorder.json("manifest.json", &manifest)?)
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
async fn caught<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let mut work = Box::pin(work);
    std::future::poll_fn(move |context| {
        std::panic::catch_unwind(AssertUnwindSafe(|| work.as_mut().poll(context))).unwrap_or_else(|panic| {
            let text = panic.downcast_ref::<String>().cloned().or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
            Poll::Ready(Err(Failure::Panic(text.unwrap_or_default())))
        })
    })
    .await
}

fn folder_of(path: &Path) -> String {
    path.parent().and_then(Path::file_name).map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
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
