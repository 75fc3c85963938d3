//! Executes several experiments in sequence on a bench, with the checks before each of them.

use std::path::Path;

use analysis::{calibration::Correction, run_folder::LOG};
use instruments::{
    clock::{Clock, TimeMode},
    fixture::Fixture,
};
use tokio::runtime::Runtime;
use tracing::Instrument;

use super::{
    Finished, ResumeContext, inherited::inherited_by, play::Run, stop::StopSignals, traced,
};
use bench_core::{
    operator::Operator, record::Recorder, safety::bench_lease, safety::failure::Failure,
    sim::Simulation, watch::Pace,
};
use bench_plan::{
    config::{self, Experiment, Source},
    procedure,
    support::{crash_point::Drill, logging, sums, terminal::remark},
};

/// A sequence of runs on one bench: time continues from run to run, and so does a simulated world;
/// the bench's correction is kept.
pub struct Session {
    pub(super) runtime: Option<Runtime>,
    pub(super) clock: Clock,
    simulation: Option<Simulation>,
    correction: Option<Correction>,
}

impl Session {
    /// Creates a session on a bench without earlier runs.
    ///
    /// # Errors
    /// Error of the operating system if it has no event queue.
    pub fn new(bench: &config::Bench) -> Result<Self, Failure> {
        let mode = bench
            .simulation
            .as_ref()
            .map_or(TimeMode::Real, |simulation| simulation.time);
        let runtime = Clock::runtime(mode)?;
        let clock = runtime.block_on(async { Clock::start(mode) });
        Ok(Self {
            runtime: Some(runtime),
            clock,
            simulation: None,
            correction: None,
        })
    }

    /// Returns the bench time, s.
    pub fn now_s(&self) -> f64 {
        self.runtime.as_ref().map_or(0.0, |runtime| {
            runtime.block_on(async { self.clock.now_s() })
        })
    }

    /// Creates a session that continues a run whose journal ends at a bench time, s.
    ///
    /// # Errors
    /// As [`Session::new`].
    pub fn at(bench: &config::Bench, time_s: f64) -> Result<Self, Failure> {
        let mut session = Self::new(bench)?;
        if let Some(runtime) = &session.runtime {
            session.clock =
                runtime.block_on(async { Clock::start_at(session.clock.mode(), time_s) });
        }
        Ok(session)
    }

    /// Returns the simulated world behind the mocks, if there is one in this process and a run has
    /// used it, regardless of how the run ended.
    pub fn simulation(&self) -> Option<&Simulation> {
        self.simulation.as_ref()
    }

    /// Executes an experiment into a folder. Without its own controls it uses the correction of
    /// the previous run.
    ///
    /// # Errors
    /// Everything that ends a run early, including a stop request.
    pub fn run(&mut self, experiment: &Experiment, folder: &Path) -> Result<Finished, Failure> {
        let stop = self.signals()?;
        let outcome = self.play(experiment, folder, None);
        self.resume_by_itself(experiment, folder, outcome, stop)
    }

    /// Continues a run in its folder.
    ///
    /// # Errors
    /// Everything that ends a run early, including a stop request.
    pub fn go_on(
        &mut self,
        experiment: &Experiment,
        folder: &Path,
        context: ResumeContext,
    ) -> Result<Finished, Failure> {
        let stop = self.signals()?;
        let outcome = self.play(experiment, folder, Some(context));
        self.resume_by_itself(experiment, folder, outcome, stop)
    }

    /// Installs the stop signals from here on, even if they are not being waited for yet.
    pub(crate) fn signals(&self) -> Result<StopSignals, Failure> {
        let Some(runtime) = &self.runtime else {
            return Err(ended());
        };
        Ok(runtime.block_on(async { StopSignals::install() })?)
    }

    /// Checks whether a stop signal has arrived since the last check, also while nothing waited for it.
    pub(crate) fn has_stopped(&self, stop: &mut StopSignals) -> bool {
        self.runtime.as_ref().is_some_and(|runtime| {
            runtime.block_on(async {
                // The runtime takes signals from the system only when its tasks wait.
                tokio::task::yield_now().await;
                stop.came().await
            })
        })
    }

    pub(super) fn play(
        &mut self,
        experiment: &Experiment,
        folder: &Path,
        context: Option<ResumeContext>,
    ) -> Result<Finished, Failure> {
        let plan = procedure::plan(experiment).check(&experiment.cell.limits)?;
        Pace::of(experiment)
            .check(experiment)
            .map_err(Failure::Usage)?;
        experiment
            .cell
            .wide
            .iter()
            .for_each(|text| remark!("note: {text}"));
        let operator = Operator::detect();
        refuse_without_person(experiment, operator)?;
        refuse_unswitched(experiment)?;
        let Some(runtime) = &self.runtime else {
            return Err(ended());
        };
        let inherited_world = self.simulation.is_some();
        if !inherited_world {
            self.simulation = simulated(experiment)?;
        }
        let (clock, simulation) = (self.clock.clone(), self.simulation.clone());
        let inherited = self
            .correction
            .clone()
            .filter(|_| experiment.fixture_check.is_none());
        let inherited = match (inherited, &context) {
            (None, Some(context)) => inherited_by(experiment, folder, context.inherited())?,
            (inherited, _) => inherited,
        };
        bench_lease::refuse(&experiment.bench)?;
        let drill = Drill::from_environment(experiment.bench.simulation.is_some())
            .map_err(Failure::Usage)?;
        let span = traced::run(experiment, folder, context.is_some());
        let work = async {
            let mut recorder = match &context {
                None => Recorder::create(folder, clock.clone())?,
                Some(context) => {
                    Recorder::reopen(folder, clock.clone(), &context.read, &context.replay)?
                }
            };
            recorder.drill(&drill);
            logging::log_to(&recorder.path(LOG), &clock)?;
            let before = (simulation, inherited);
            Box::pin(
                Run {
                    experiment,
                    plan: &plan,
                    clock,
                    operator,
                    recorder,
                    before,
                    inherited_world,
                    context,
                }
                .go(),
            )
            .await
        };
        let outcome = runtime.block_on(work.instrument(span.clone()));
        traced::ended(&span, outcome.as_ref().err());
        let finished = outcome?;
        self.correction = Some(finished.measured.correction.clone());
        // Nothing may be written into the folder from here on.
        logging::log_off();
        sums::write(folder)?;
        Ok(finished)
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        // A thread that still waits for a person's answer must not delay the end.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

fn ended() -> Failure {
    Failure::Panic("the bench's session has ended".to_owned())
}

/// Returns the world behind in-process addresses; for addresses on real ports another process
/// serves it.
fn simulated(experiment: &Experiment) -> Result<Option<Simulation>, Failure> {
    let bench = &experiment.bench;
    let Some(section) = bench.simulation.as_ref().filter(|_| bench.in_process()) else {
        return Ok(None);
    };
    let read = experiment
        .sources
        .iter()
        .find(|source| source.path() == section.scenario);
    let unread;
    let scenario = match read {
        Some(scenario) => scenario,
        None => {
            unread = Source::read(&section.scenario)?;
            &unread
        }
    };
    let cell = experiment.specimen.as_ref().map(|one| one.name.as_str());
    let simulation = Simulation::of(scenario, experiment.seed, cell)?;
    Ok(Some(
        simulation
            .with_faults(section.faults.clone())
            .with_quirks(section.quirks.clone()),
    ))
}

/// Returns an error for real instruments with a supply that the program cannot switch. Safe state and
/// watch cannot yet end its zero error in every situation (docs/safety.md).
fn refuse_unswitched(experiment: &Experiment) -> Result<(), Failure> {
    let bench = &experiment.bench;
    if bench.wiring.analog.is_none() || bench.is_simulated() {
        return Ok(());
    }
    Err(Failure::Usage(
        "expected a bipolar supply with a link, found `analog`: this version drives an analog supply on \
        simulated benches only, because it cannot end the supply's zero error in every situation; \
        `plan`, `identify` and `safe` take this bench"
            .to_owned(),
    ))
}

/// Returns an error if a sweep begins with a person changing the fixture but no person can be
/// asked. Otherwise the run would fail in the middle of the night.
fn refuse_without_person(experiment: &Experiment, operator: Operator) -> Result<(), Failure> {
    let person = matches!(experiment.bench.instruments.jig, Some(config::Jig::Person));
    let cells = experiment
        .campaign
        .as_ref()
        .is_some_and(|campaign| campaign.cells.len() > 1);
    let shunt = experiment
        .eis
        .as_ref()
        .is_some_and(|eis| eis.fixture == Fixture::Shunt && eis.repeat > 0);
    if person
        && (experiment.fixture_check.is_some() || shunt || cells)
        && operator == Operator::Nobody
    {
        return Err(Failure::Usage(
            bench_core::operator::OperatorError::NoTerminal.to_string(),
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bench_plan::config::load_experiment;

    #[test]
    fn a_stop_signal_between_two_runs_is_seen_once() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/experiments/map.toml");
        let experiment = load_experiment(&file, None).unwrap();
        let session = Session::new(&experiment.bench).unwrap();
        let mut stop = session.signals().unwrap();
        assert!(!session.has_stopped(&mut stop));
        let kill = format!("kill -HUP {}", std::process::id());
        let sent = std::process::Command::new("sh")
            .args(["-c", &kill])
            .status();
        assert!(sent.unwrap().success());
        // The system may deliver it later.
        let seen = (0..1_000_000).any(|_| session.has_stopped(&mut stop));
        assert!(seen);
        assert!(!session.has_stopped(&mut stop));
    }
}
