//! Single thread that begins runs, watches them, and publishes changes. It waits for no listener
//! and no request.

mod identity;

use std::{
    fs::File,
    io::Write,
    os::unix::{fs::OpenOptionsExt, process::CommandExt},
    path::Path,
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

use analysis::run_folder::{self, JOURNAL};
use instruments::clock;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use serde::Serialize;

use super::{
    Server,
    audit::private,
    jobs::{Ended, Job},
    live::{self, BenchState, InstrumentNow, Live},
    outputs,
    queue::{HeldBy, Item, Kind, Process},
    shelf,
    spectra::{self, Spectrum, Stamps},
    submission, traced,
    watch::Watch,
};
use bench_core::{
    bench::outputs::{DRIVES, OutputState, OutputsKind, OutputsState},
    operator::{BY_FOLDER, OPERATOR_VARIABLE},
    safety::failure::{Failure, GATE_REFUSED, REFUSED_CODE},
    safety::state::{Holder, State},
};
use bench_evaluate::support::telemetry::CONTEXT_VARIABLE;
use bench_plan::{config, support::locks};
pub use identity::{Answer, Asked, Identity};

/// Interval between two polls, s.
const LOOK_S: f64 = 0.2;
/// Minimum interval between two published states of a bench that changes constantly, s.
const TELL_S: f64 = 0.5;
/// So long a process may take until its journal is there, s.
const BIRTH_S: f64 = 60.0;
/// Exit code of a process that has refused its request.
const NOTHING_DONE: i32 = 2;

/// Separates the output of the processes of a run in its log.
const RESUMED: &str = "-- resumed --";

/// The thread at work.
pub struct Supervisor {
    end: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

/// Starts the thread. Must be called inside a runtime.
///
/// # Errors
/// A system without threads; a state folder that cannot be written.
pub fn start(server: &Arc<Server>) -> Result<Supervisor, Failure> {
    let mut posts = server
        .settings
        .benches
        .iter()
        .map(|bench| SupervisedBench::new(server, bench))
        .collect::<Result<Vec<_>, _>>()?;
    let (server, handle) = (server.clone(), tokio::runtime::Handle::current());
    let end = Arc::new(AtomicBool::new(false));
    let ended = end.clone();
    let work = move || {
        while !ended.load(Ordering::Relaxed) {
            posts.iter_mut().for_each(|post| post.look(&server));
            server.counts.looks.fetch_add(1, Ordering::Relaxed);
            handle.block_on(server.clock.sleep_s(LOOK_S));
        }
    };
    Ok(Supervisor {
        end,
        thread: std::thread::Builder::new()
            .name("supervisor".to_owned())
            .spawn(work)?,
    })
}

impl Supervisor {
    /// Ends the supervisor; runs continue.
    pub fn end(self) {
        self.end.store(true, Ordering::Relaxed);
        let _ = self.thread.join();
    }
}

/// One bench.
struct SupervisedBench {
    bench: config::Bench,
    state: Option<State>,
    /// The active process if it is a child of this server, with its queue number.
    child: Option<(u64, Child)>,
    watch: Option<(Option<String>, Watch)>,
    manifest: Vec<Identity>,
    stamps: Stamps,
    reported: (Live, f64),
    /// Why no run begins until the server is restarted.
    restart: Option<String>,
}

impl SupervisedBench {
    fn new(server: &Server, bench: &config::Bench) -> Result<Self, Failure> {
        let mut latest = server.jobs.latest();
        let last = latest.find(|job| job.item.bench == bench.name);
        let watch = last.map(|job| {
            (
                Some(job.item.run.clone()),
                Watch::new(&server.runs().join(&job.item.run)),
            )
        });
        Ok(Self {
            bench: bench.clone(),
            state: State::of(bench)?,
            child: None,
            watch,
            manifest: Vec::new(),
            stamps: Stamps::new(),
            reported: (Live::default(), f64::NEG_INFINITY),
            restart: None,
        })
    }

    fn look(&mut self, server: &Server) {
        self.restart = shelf::restart_needed(&self.bench);
        self.reap(server);
        self.begin(server);
        let going = self.follow(server);
        self.tell(server, going);
    }

    /// Notices the end of the run in work.
    fn reap(&mut self, server: &Server) {
        let Some(item) = server.queue().in_work(&self.bench.name).cloned() else {
            return;
        };
        let folder = server.runs().join(&item.run);
        let code = match &mut self.child {
            Some((id, child)) if *id == item.id => match child.try_wait() {
                Ok(Some(status)) => status.code(),
                Ok(None) => return,
                Err(_) => None,
            },
            _ if lives(&folder, &item) => return,
            _ => None,
        };
        self.child = None;
        // A server that crashed after the start of a run and before it recorded the start begins
        // the run again. The second process finds the folder of the first, does nothing, and
        // prints nothing.
        let is_second = item.kind == Kind::Run && code == Some(NOTHING_DONE);
        let code = code.filter(|_| !(is_second && folder.join(JOURNAL).exists()));
        if code.is_none() && lives(&folder, &item) {
            return;
        }
        let mut watch = Watch::new(&folder);
        watch.look();
        let word = last_word(&log_of(server, &item.run));
        let how = how_it_ended(watch.ended(), word);
        // A run with points that its quality gate has refused counts as finished.
        let as_finished = |code: i32| code == 0 || code == i32::from(REFUSED_CODE);
        let finished = watch.ended() == Some("finished") && code.is_none_or(as_finished);
        let ended = Ended {
            code,
            finished,
            ..Ended::now(how)
        };
        self.over(server, &item, &ended.stopped(stopper(server, &item)));
    }

    fn over(&self, server: &Server, item: &Item, ended: &Ended) {
        let job = Job {
            item: item.clone(),
            ended: Some(ended.clone()),
        };
        let kept = server.jobs.write(&job);
        let (by, why) = held_behind(server, item, ended);
        let mut queue = server.queue();
        let held = if ended.finished {
            Ok(())
        } else {
            queue.hold(by, &item.bench, &why)
        };
        let done = queue.done(item.id);
        drop(queue);
        for error in [
            kept.err(),
            held.err().map(|error| error.to_string()),
            done.err().map(|error| error.to_string()),
        ]
        .iter()
        .flatten()
        {
            tracing::error!("{error}");
        }
        server.catalog.refresh_run(&item.run);
        server.health.ended(&item.bench, &item.run, ended);
        traced::ended(server, item, ended);
        server.hub.tell("run", &job);
        server.tell_queue();
    }

    /// Begins the next run if the bench is free.
    fn begin(&mut self, server: &Server) {
        // A completed stop holds the bench; therefore the queue is checked afterwards.
        let last_stop = match server.stops().get(&self.bench.name) {
            Some(stop) if !stop.over => return,
            stop => stop.map(|stop| stop.unix_s),
        };
        let Some(item) = server.queue().next(&self.bench.name).cloned() else {
            return;
        };
        if self.taken() {
            return;
        }
        let folder = server.runs().join(&item.run);
        if item.kind == Kind::Run && folder.join(JOURNAL).exists() {
            // It was begun, and the server died before it could write that down.
            let pid = locks::holder(&folder.join(JOURNAL)).unwrap_or(0);
            self.begun(server, &item, pid, last_stop);
            return;
        }
        if let Some(why) = shelf::why_not_begun(&server.settings.data, &self.bench, &item.run) {
            if let Err(error) = server.queue().hold(HeldBy::Here, &self.bench.name, &why) {
                tracing::error!("{error}");
            }
            server.tell_queue();
            return;
        }
        match command(server, &item, &self.bench)
            .and_then(|mut command| command.spawn().map_err(|error| error.to_string()))
        {
            Ok(child) => {
                let pid = i32::try_from(child.id()).unwrap_or(0);
                self.child = Some((item.id, child));
                self.begun(server, &item, pid, last_stop);
            }
            Err(how) => self.over(server, &item, &Ended::now(how)),
        }
    }

    /// Records that an entry has started. No lock is held between the check of the stops and this
    /// point, so that a slow disk never delays a stop. A stop that arrived in between finds no
    /// process, or finds it late; therefore the process is ended here.
    fn begun(&self, server: &Server, item: &Item, pid: i32, last_stop: Option<f64>) {
        let process = Process {
            pid,
            started_unix_s: clock::unix_time_s(),
        };
        let item = Item {
            process: Some(process.clone()),
            ..item.clone()
        };
        // From here on a stop finds it.
        let begun = server.queue().begun(item.id, process);
        let stopped = {
            let mut stops = server.stops();
            let stopped = stops.get(&self.bench.name).map(|stop| stop.unix_s) != last_stop;
            if !stopped {
                // The outcome of the last stop is no longer valid.
                stops.remove(&self.bench.name);
            }
            stopped
        };
        if stopped && pid > 1 {
            tracing::warn!(
                "{}: process {pid} was started while the bench was being stopped: it is ended",
                self.bench.name
            );
            let _ = kill(Pid::from_raw(pid), Signal::SIGTERM);
        }
        traced::waited(server, &item);
        let job = Job { item, ended: None };
        if let Some(error) = begun
            .err()
            .map(|error| error.to_string())
            .or_else(|| server.jobs.write(&job).err())
        {
            tracing::error!("{error}");
        }
        server.hub.tell("run", &job);
        server.tell_queue();
    }

    /// Returns whether the bench is latched, in use by another process, or still under the
    /// guardian of an earlier run.
    fn taken(&self) -> bool {
        let Some(state) = &self.state else {
            return false;
        };
        let latched = !matches!(state.latched(), Ok(None));
        latched
            || ["lock", "guardian.lock"]
                .iter()
                .any(|name| locks::holder(&state.path(name)).is_some())
    }

    /// Watches the active run, including one that another process began. Returns whether it
    /// continues.
    fn follow(&mut self, server: &Server) -> bool {
        let item = server.queue().in_work(&self.bench.name).cloned();
        let ours = item.map(|item| (server.runs().join(&item.run), Some(item.run)));
        let other = || {
            let state = self.state.as_ref()?;
            locks::holder(&state.path("lock"))?;
            let holder: Holder =
                serde_json::from_str(&std::fs::read_to_string(state.path("lock")).ok()?).ok()?;
            let name = holder
                .run
                .strip_prefix(std::path::absolute(server.runs()).ok()?)
                .ok()
                .and_then(Path::to_str)
                .map(str::to_owned);
            Some((holder.run, name))
        };
        let found = ours.or_else(other);
        if found.is_some() {
            // A run asks the instruments itself.
            server.identities().remove(&self.bench.name);
        }
        if let Some((folder, name)) = &found
            && self
                .watch
                .as_ref()
                .is_none_or(|(_, watch)| watch.folder() != folder)
        {
            self.watch = Some((name.clone(), Watch::new(folder)));
            self.stamps.clear();
            self.manifest.clear();
        }
        if let Some((name, watch)) = &mut self.watch {
            watch.look();
            let is_new = self.manifest.is_empty();
            if is_new {
                self.manifest = identities(watch.folder());
            }
            let stamps = spectra::stamps(watch.folder());
            let is_begun = is_new && !self.manifest.is_empty();
            if let Some(name) = name
                .as_ref()
                .filter(|_| is_begun || stamps.len() > self.stamps.len())
            {
                server.catalog.refresh_run(name);
            }
            for file in stamps
                .iter()
                .filter(|(file, stamp)| self.stamps.get(*file) != Some(*stamp))
                .map(|(file, _)| file)
            {
                if let Some(spectrum) = spectra::read(watch.folder(), file) {
                    server.hub.tell(
                        "spectrum",
                        &Changed {
                            bench: &self.bench.name,
                            run: name.as_deref(),
                            spectrum,
                        },
                    );
                }
            }
            self.stamps = stamps;
        }
        found.is_some()
    }

    fn tell(&mut self, server: &Server, going: bool) {
        let live = self.live(server, going);
        let now_s = server.clock.now_s();
        let urgent = live.state != self.reported.0.state
            || live.stop != self.reported.0.stop
            || live.trip != self.reported.0.trip
            || live.question != self.reported.0.question
            || live.is_pausing() != self.reported.0.is_pausing();
        // The trip that the first poll finds existed before this server.
        if self.reported.1.is_finite() && live.trip.is_some() && live.trip != self.reported.0.trip {
            server.health.tripped(&self.bench.name);
        }
        if live == self.reported.0 || (!urgent && now_s - self.reported.1 < TELL_S) {
            return;
        }
        server.hub.tell("live", &live);
        server.live().insert(self.bench.name.clone(), live.clone());
        self.reported = (live, now_s);
    }

    /// Returns whether a run has ended whose outputs were not read back as off, or whose outputs
    /// are unknown.
    fn left_open(&self) -> bool {
        !self.bench.in_process()
            && self
                .state
                .as_ref()
                .is_none_or(|state| !matches!(state.open_run(), Ok(None)))
    }

    /// The last run's process has left without a word.
    fn died(&self) -> bool {
        self.watch
            .as_ref()
            .is_some_and(|(_, watch)| watch.ended().is_none() && watch.reading(false).is_some())
    }

    /// Returns the state of the outputs: the readings, and their time.
    fn outputs(&self, going: bool) -> OutputsState {
        match &self.state {
            _ if going => OutputsState::in_run(),
            None => OutputsState::simulated(),
            Some(state) => state.outputs(),
        }
    }

    fn live(&self, server: &Server, going: bool) -> Live {
        let trip = self
            .state
            .as_ref()
            .and_then(|state| state.latched().ok().flatten());
        let stop = server.stops().get(&self.bench.name).cloned();
        let outputs = self.outputs(going);
        let is_unread = outputs.state == OutputsKind::NotRead;
        let unproven = !going && (self.left_open() || (self.died() && is_unread));
        let paused = self.watch.as_ref().is_some_and(|(_, watch)| watch.paused());
        let question = self
            .watch
            .as_ref()
            .and_then(|(_, watch)| watch.question())
            .filter(|_| going);
        let state = match (stop.as_ref().is_some_and(|stop| !stop.over), going) {
            (true, _) => BenchState::Stopping,
            (false, true) if question.is_some() => BenchState::Asking,
            (false, true) if paused => BenchState::Paused,
            (false, true) => BenchState::Running,
            (false, false) if trip.is_some() => BenchState::Latched,
            (false, false) if unproven => BenchState::Unknown,
            (false, false) => BenchState::Idle,
        };
        let reading = self
            .watch
            .as_ref()
            .and_then(|(_, watch)| watch.reading(going));
        let experiment = self
            .watch
            .as_ref()
            .and_then(|(_, watch)| watch.experiment());
        let step = (self.watch.as_ref().filter(|_| going)).and_then(|(_, watch)| watch.envelope());
        let limits = match (experiment, &reading) {
            (Some(experiment), Some(reading)) => {
                live::limits(&experiment.cell.limits, reading, step)
            }
            _ => Vec::new(),
        };
        Live {
            bench: self.bench.name.clone(),
            state,
            held: server
                .queue()
                .held(&self.bench.name)
                .map(str::to_owned)
                .or_else(|| self.restart.clone()),
            run: self
                .watch
                .as_ref()
                .map(|(name, watch)| watch.now(name.clone(), going)),
            soc: self.watch.as_ref().and_then(|(_, watch)| watch.soc()),
            reading,
            limits,
            instruments: self.instruments(server, &outputs),
            trip: trip.map(Into::into),
            question,
            verified: !going && !unproven && outputs.is_off(),
            outputs,
            safe_command: outputs::safe_command(&self.bench),
            read_idle_s: server.settings.read_idle_s.filter(|_| self.state.is_some()),
            stop,
            ..Live::default()
        }
        .judged()
    }

    fn instruments(&self, server: &Server, outputs: &OutputsState) -> Vec<InstrumentNow> {
        let asked = server
            .identities()
            .get(&self.bench.name)
            .cloned()
            .unwrap_or_default();
        let one = |(role, instrument): (&'static str, &config::Instrument)| {
            let asked = asked.iter().find(|asked| asked.role == role);
            let answer =
                asked.and_then(|asked| Some((asked.identity.as_ref()?, asked.recognised?)));
            let in_run = self.manifest.iter().find(|identity| identity.role == role);
            let in_run = in_run.map(|identity| (&identity.identity, identity.recognised));
            let identity = answer.or(in_run);
            let now = InstrumentNow {
                role: role.to_owned(),
                model: instrument.model.clone(),
                address: instrument.address.to_string(),
                identity: identity.map(|(identity, _)| identity.raw.clone()),
                recognised: identity.map(|(_, recognised)| recognised),
                ..self.by_transcript(role)
            };
            let mut now = self.by_reading(now, outputs);
            // A later reading of the output shows that the instrument answers again.
            let is_last =
                |asked: &&Asked| now.output_unix_s.is_none_or(|read| read <= asked.unix_s);
            if let Some(why) = asked
                .filter(is_last)
                .and_then(|asked| asked.failure.as_ref())
            {
                now.trouble = Some(format!("no answer: {why}"));
            }
            now
        };
        self.bench
            .instruments
            .addressed()
            .into_iter()
            .map(one)
            .collect()
    }

    /// Returns the state of an instrument according to the transcript of the last run.
    fn by_transcript(&self, role: &str) -> InstrumentNow {
        let watch = self.watch.as_ref().map(|(_, watch)| watch);
        let Some(monitor) = watch.and_then(|watch| watch.monitor(role)) else {
            return InstrumentNow::default();
        };
        let remark = monitor.remark.as_ref().filter(|remark| {
            monitor
                .answered_s
                .is_none_or(|answered| remark.1 > answered)
        });
        InstrumentNow {
            output: monitor.output.map(|(on, _)| on),
            output_s: monitor.output.map(|(_, time_s)| time_s),
            answered_s: monitor.answered_s,
            trouble: remark
                .filter(|(text, _)| text.contains("dropped") || text.contains("cannot"))
                .map(|(text, _)| text.clone()),
            ..InstrumentNow::default()
        }
    }

    /// Updates the state with later readings. The output state from a run's transcript is not
    /// valid after the run.
    fn by_reading(&self, now: InstrumentNow, outputs: &OutputsState) -> InstrumentNow {
        if outputs.state == OutputsKind::InRun || !DRIVES.contains(&now.role.as_str()) {
            return now;
        }
        if outputs.state == OutputsKind::Simulated {
            return InstrumentNow {
                output: now.output.map(|_| false),
                output_s: None,
                trouble: None,
                ..now
            };
        }
        let Some(reading) = outputs.of_role(&now.role) else {
            return InstrumentNow {
                output: None,
                output_s: None,
                trouble: now.output.map(|_| self.after_death().to_owned()),
                ..now
            };
        };
        let is_reached = reading.state != OutputState::Unreachable;
        InstrumentNow {
            output: is_reached.then_some(!reading.is_off()),
            output_s: None,
            output_unix_s: Some(reading.unix_s),
            output_by: Some(reading.by.clone()),
            trouble: (!is_reached).then(|| "not reached when it was read last".to_owned()),
            ..now
        }
    }

    /// Describes an output that was not read since a run.
    fn after_death(&self) -> &'static str {
        let guarded = self
            .state
            .as_ref()
            .is_some_and(|state| locks::holder(&state.path("guardian.lock")).is_some());
        if guarded {
            "the run's process died: the guardian switches off"
        } else {
            "not read since the last run began"
        }
    }
}

/// A spectrum that changed.
#[derive(Serialize)]
struct Changed<'a> {
    bench: &'a str,
    run: Option<&'a str>,
    spectrum: Spectrum,
}

/// Returns the side that holds a bench after a run that did not finish, and why.
fn held_behind(server: &Server, item: &Item, ended: &Ended) -> (HeldBy, String) {
    // A stop is forgotten when the next run has begun: one that is there has ended this run.
    let stops = server.stops();
    let stop = stops.get(&item.bench).filter(|_| item.process.is_some());
    match stop {
        Some(stop) => (stop.held_by, stop.held()),
        None => {
            let why = format!("{} did not come to its end: {}", item.run, ended.how);
            (HeldBy::Here, why)
        }
    }
}

/// Returns who stopped a run by a stop of its bench.
fn stopper(server: &Server, item: &Item) -> Option<String> {
    let begun_s = item.process.as_ref()?.started_unix_s;
    let stops = server.stops();
    let stop = stops.get(&item.bench);
    stop.filter(|stop| stop.unix_s >= begun_s)
        .map(|stop| stop.by.clone())
}

/// Returns whether the process of a run lives that is not a child of this server.
fn lives(folder: &Path, item: &Item) -> bool {
    let journal = folder.join(JOURNAL);
    if locks::holder(&journal).is_some() {
        return true;
    }
    let Some(process) = &item.process else {
        return false;
    };
    let young = clock::unix_time_s() - process.started_unix_s < BIRTH_S;
    !journal.exists() && young && process.pid > 1 && kill(Pid::from_raw(process.pid), None).is_ok()
}

/// A process of its own group: what ends the server does not end the run.
fn command(server: &Server, item: &Item, bench: &config::Bench) -> Result<Command, String> {
    let data = &server.settings.data;
    let path = data.join("logs").join(format!("{}.log", item.run));
    let mut log = File::options()
        .create(true)
        .append(true)
        .mode(0o640)
        .open(&path)
        .map_err(|error| format!("{}: {error}", path.display()))?;
    private(&path, 0o640).map_err(|error| error.to_string())?;
    let mut command = Command::new(&server.program);
    match item.kind {
        Kind::Run => {
            let folder = data.join("submitted").join(&item.run);
            let experiment = submission::frozen(&folder).ok_or_else(|| {
                format!("{}: expected the experiment, found none", folder.display())
            })?;
            command
                .arg("run")
                .arg(experiment)
                .arg("--bench")
                .arg(&bench.path)
                .arg("--out")
                .arg(server.runs().join(&item.run));
            if let Some(seed) = item.seed {
                command.arg("--seed").arg(seed.to_string());
            }
        }
        Kind::Resume => {
            writeln!(log, "{RESUMED}").map_err(|error| format!("{}: {error}", path.display()))?;
            command.arg("resume").arg(server.runs().join(&item.run));
        }
    }
    let errors = log.try_clone().map_err(|error| error.to_string())?;
    command
        .stdin(Stdio::null())
        .stdout(log)
        .stderr(errors)
        .process_group(0)
        .env(OPERATOR_VARIABLE, BY_FOLDER)
        .env_remove("NOTIFY_SOCKET")
        .env_remove("WATCHDOG_USEC");
    server.settings.telemetry.hand_over(&mut command);
    match &item.traceparent {
        Some(traceparent) => command.env(CONTEXT_VARIABLE, traceparent),
        None => command.env_remove(CONTEXT_VARIABLE),
    };
    Ok(command)
}

/// Output of the processes of a run.
fn log_of(server: &Server, run: &str) -> String {
    std::fs::read_to_string(server.settings.data.join("logs").join(format!("{run}.log")))
        .unwrap_or_default()
}

/// Reason of its end that the last process of a run wrote last. Lines of earlier processes do not
/// count.
fn last_word(log: &str) -> Option<String> {
    log.lines()
        .rev()
        .take_while(|line| *line != RESUMED)
        .find_map(|line| line.strip_prefix("eis-bench: "))
        .map(str::to_owned)
}

/// Returns how a run ended, from its journal and the last message of its process. A finished run
/// may have points that the quality gate has refused.
fn how_it_ended(ended: Option<&str>, word: Option<String>) -> String {
    let (ended, word) = match ended {
        Some("finished") => (ended, word.filter(|word| word.starts_with(GATE_REFUSED))),
        _ => (None, ended.map(str::to_owned).or(word)),
    };
    word.or_else(|| ended.map(str::to_owned))
        .unwrap_or_else(|| "its process was killed or died".to_owned())
}

/// Identities of the instruments of a run.
fn identities(run: &Path) -> Vec<Identity> {
    run_folder::instruments(run)
        .and_then(|instruments| serde_json::from_value(instruments).ok())
        .unwrap_or_default()
}

#[cfg(test)]
mod tests;
