//! The bench of a trial: mocks on real ports, served by a thread of this process, so that the load
//! on the cell is known. The program under attack knows only addresses.

use std::{
    fs,
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc},
};

use bench_core::sim::Simulation;
use bench_plan::config::load_bench;
use fixtures::SimulatedBench;
use instruments::{
    clock::{Clock, TimeMode},
    mock::{
        FaultSwitch, Remote, Schedule,
        plant::{Meter, Plant},
    },
};

/// Bench time equals real time: deadlines are those of real instruments.
const MODE: TimeMode = TimeMode::Scaled(1.0);
/// Interval between two samples of the true current, s.
const SAMPLE_S: f64 = 0.05;

/// The truth at one time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    /// Bench time, s.
    pub(crate) now_s: f64,
    /// Current through the object in the jig, A.
    pub(crate) amps: f64,
    /// Whether an output is on through which charge can move.
    pub(crate) live: bool,
}

/// The served bench of one trial.
pub(crate) struct Scene {
    pub(crate) world: Arc<Mutex<SimulatedBench>>,
    pub(crate) simulation: Simulation,
    pub(crate) clock: Clock,
    samples: Arc<Mutex<Vec<Sample>>>,
    stop: Option<tokio::sync::oneshot::Sender<()>>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// Controls of the scheduled fault of a trial.
#[derive(Default, Clone)]
pub(crate) struct Switches {
    pub(crate) begun: FaultSwitch,
    pub(crate) repaired: FaultSwitch,
}

pub(crate) fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Scene {
    /// Serves the mocks with their schedule, and writes their addresses into the bench file.
    pub(crate) fn serve(folder: &Path, schedule: Option<Schedule>, person: bool) -> Self {
        let path = folder.join("benches/demo.toml");
        if person {
            let text = fs::read_to_string(&path).expect("the bench file");
            let text = text.replace(
                "model = \"mock-jig\"\naddress = \"memory:jig\"",
                "model = \"person\"",
            );
            fs::write(&path, text).expect("a bench file");
        }
        let (bench, _) = load_bench(&path).expect("the bench of the demo");
        let simulation = Simulation::new(&folder.join("scenarios/p45b.toml"), 1)
            .expect("its scenario")
            .with_faults(schedule)
            .with_remotes();
        let samples = Arc::default();
        let (stop, stopped) = tokio::sync::oneshot::channel();
        let (send, received) = mpsc::channel();
        let (served, kept) = (simulation.clone(), Arc::clone(&samples));
        let thread = std::thread::spawn(move || {
            let runtime = Clock::runtime(MODE).expect("a runtime");
            runtime.block_on(async {
                let clock = Clock::start(MODE);
                let addresses = served.serve_on_ports(&bench, &[], &clock).await;
                send.send((addresses.expect("free ports"), clock.clone()))
                    .expect("a listener");
                watch(&served, &clock, &kept, stopped).await;
            });
        });
        let (addresses, clock) = received.recv().expect("addresses");
        let mut text = fs::read_to_string(&path)
            .expect("the bench file")
            .replace("[simulation]", &format!("[simulation]\ntime = \"{MODE}\""));
        for served in addresses {
            text = text.replace(
                &format!("\"memory:{}\"", served.role),
                &format!("{:?}", served.address),
            );
        }
        fs::write(&path, text).expect("a bench file");
        Self {
            world: simulation.world().clone(),
            simulation,
            clock,
            samples,
            stop: Some(stop),
            thread: Some(thread),
        }
    }

    pub(crate) fn now_s(&self) -> f64 {
        self.clock.now_s()
    }

    pub(crate) fn samples(&self) -> Vec<Sample> {
        lock(&self.samples).clone()
    }

    pub(crate) fn remote(&self, role: &str) -> Option<Remote> {
        self.simulation.remote(role)
    }

    /// Checks whether no current has flowed for a time, s.
    pub(crate) fn is_quiet_for(&self, span_s: f64) -> bool {
        let samples = lock(&self.samples);
        let Some(last) = samples.last() else {
            return false;
        };
        last.now_s > span_s
            && samples
                .iter()
                .rev()
                .take_while(|sample| last.now_s - sample.now_s < span_s)
                .all(|sample| sample.amps.abs() <= super::judge::NOTHING_A)
    }

    /// Returns the greatest delay of a sample of the current, s: a measure of the load on the
    /// machine.
    pub(crate) fn lag_s(&self) -> f64 {
        lock(&self.samples)
            .windows(2)
            .map(|pair| pair[1].now_s - pair[0].now_s - SAMPLE_S)
            .fold(0.0, f64::max)
    }
}

/// Samples the current repeatedly until the trial is over.
async fn watch(
    served: &Simulation,
    clock: &Clock,
    kept: &Mutex<Vec<Sample>>,
    mut stopped: tokio::sync::oneshot::Receiver<()>,
) {
    while stopped.try_recv().is_err() {
        clock.sleep_s(SAMPLE_S).await;
        let mut world = lock(served.world());
        let now_s = clock.now_s();
        world.read(now_s, Meter::BipolarAmps);
        let sample = Sample {
            now_s,
            amps: world.truth_current_a(),
            live: world.truth_live(),
        };
        drop(world);
        lock(kept).push(sample);
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
