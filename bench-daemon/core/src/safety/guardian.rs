//! The guardian: a second process that can only switch off. It drives and measures nothing for the
//! run; it waits for the end of the daemon.
//!
//! The daemon starts the guardian before any output is energised and sends it a heartbeat over a
//! pipe five times a second ([`Keeper`]). The pipe closes when the daemon dies. If the daemon
//! hangs or is stopped, the heartbeat stays away for longer than the lease; the guardian then
//! kills the daemon, so that it cannot resume during the shutdown. The guardian connects to the
//! instruments, switches them off in the order of [`Bench::safe_state`], reads back their states,
//! and retries until it succeeds.
//!
//! Drives are switched off first. The relays of a bath are opened in parallel. A bath that closes
//! its own loop is checked afterwards. Neither delays the verification of the other instruments.
//!
//! The guardian assumes that each instrument accepts a single client. It therefore reaches and
//! identifies each instrument before the daemon connects, closes these connections, and connects
//! again after the daemon has died.

mod keeper;

use std::{collections::BTreeMap, fs::File, io::BufRead, path::Path, time::Duration};

use instruments::{
    clock::{self, Clock},
    transcript::Tap,
    transport::MemoryHub,
    units::{Celsius, Seconds, Volts},
};
use nix::{
    sys::signal::{Signal, kill},
    unistd::{Pid, getppid},
};
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc::UnboundedReceiver;

pub use keeper::{GuardianError, Keeper, wait_for_earlier};

use crate::{
    bench::{BathOrder, Bench, Connections, Identified, SafeReport},
    clock::TypedClock,
    safety::state::{Latched, Lock, State, StateError, pid},
};
use bench_plan::{
    config,
    interlock::Trip,
    support::{logging, terminal::say},
};

/// Messages that go over the pipes, one per line. To the guardian:
const ALIVE: &str = ".";
const DOING: &str = "doing ";
/// Placeholder for the set-point of a bath that this run has not started.
const NO_BATH: &str = "-";
const GOODBYE: &str = "goodbye";
const TAKE_OVER: &str = "take over";
/// From the guardian:
const READY: &str = "ready";
const REFUSED: &str = "refused ";

const REPORT: &str = "guardian.json";
/// Roles that the guardian switches off or checks.
const ROLES: [&str; 5] = ["supply4q", "generator", "load", "supply", "chiller"];
/// Time after everything else is off during which the guardian still tries to reach a relay board,
/// s. The longest relay pulse ends within this time.
const RELAYS_DROP_S: Seconds = Seconds(90.0);
/// Pause between two attempts, s: first and greatest value. Each pause is twice as long as the one
/// before.
const BACKOFF_S: (Seconds, Seconds) = (Seconds(1.0), Seconds(10.0));
/// Number of attempts that the guardian makes after its folder was removed.
const PATIENCE: u32 = 30;
/// Time in which a killed process must disappear, unless the system hangs.
const DEATH: Duration = Duration::from_secs(5);

/// Start parameters of a guardian.
pub struct Charge<'a> {
    /// The bench.
    pub bench: &'a config::Bench,
    /// The run folder, for its report.
    pub run: &'a Path,
    /// Least and greatest voltage of the cell, V.
    pub window_v: (Volts, Volts),
    /// Least and greatest temperature of the cell, °C, if a cell is to be in the jig.
    pub cell_degc: Option<(Celsius, Celsius)>,
    /// SHA-256 of the bench file as the daemon read it: both processes must use the same
    /// instruments.
    pub sha256: String,
}

/// Progress of a guardian.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// The guardian waits for the end of the daemon.
    Watching,
    /// The guardian has not yet read back every output as off.
    #[serde(rename = "switching off")]
    SwitchingOff,
    /// Every output was read back as off.
    Verified,
    /// Every output was read back as off, but a bath does not answer.
    #[serde(rename = "verified, bath not reached")]
    BathNotReached,
    /// The daemon has verified the safe state and needs the guardian no longer.
    Dismissed,
}

/// The guardian's report, in the state folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Process ID of the guardian.
    pub pid: i32,
    /// Process ID of the daemon that it watches.
    pub daemon: i32,
    /// Run folder of the daemon.
    pub run: String,
    /// Progress of the guardian.
    pub status: Status,
    /// Reason why it intervened.
    pub cause: Option<String>,
    /// The step that was being executed.
    pub step: String,
    /// Number of attempts to switch off.
    pub attempts: u32,
    /// Result of the last attempt, as `eis-bench safe --json` prints it; absent in the file of an
    /// older guardian.
    #[serde(flatten)]
    pub safe: Option<SafeReport>,
    /// Least and greatest temperature of the cell, °C.
    #[serde(default)]
    #[serde(rename = "cell_c")]
    pub cell_degc: Option<(Celsius, Celsius)>,
    /// Set-point at which the run started a bath that closes its own loop, °C.
    #[serde(default)]
    #[serde(rename = "bath_c")]
    pub bath_degc: Option<Celsius>,
    /// End state of the bath, if it was changed.
    #[serde(default)]
    pub bath_ended: Option<String>,
    /// Time from the intervention until everything that moves charge was verified as off, bench s.
    pub took_s: Option<Seconds>,
    /// Time at which the report was written, s since 1970.
    pub unix_s: f64,
}

impl Report {
    /// Reads the report of the last guardian. Returns `None` if there is none or if it cannot be
    /// parsed.
    pub fn read(state: &State) -> Option<Self> {
        serde_json::from_str(&std::fs::read_to_string(state.path(REPORT)).ok()?).ok()
    }

    /// Checks whether the guardian has read back everything that moves charge as off after this
    /// run.
    pub fn has_verified(&self, run: &Path) -> bool {
        matches!(self.status, Status::Verified | Status::BathNotReached)
            && Path::new(&self.run) == run
    }
}

/// Returns the least and greatest temperature, °C, that the cell of the last run on a bench
/// tolerates, or `None` if they are unknown.
pub fn last_cell_degc(state: &State) -> Option<(Celsius, Celsius)> {
    let text = std::fs::read_to_string(state.path(REPORT)).ok()?;
    let report: serde_json::Value = serde_json::from_str(&text).ok()?;
    Some((
        Celsius(report["cell_c"][0].as_f64()?),
        Celsius(report["cell_c"][1].as_f64()?),
    ))
}

/// Watches the daemon until it says goodbye or the guardian must intervene.
///
/// # Errors
/// Fails if an instrument cannot be reached or a state cannot be written; the daemon is notified.
pub async fn watch(charge: &Charge<'_>, clock: &Clock) -> Result<(), GuardianError> {
    match Watch::start(charge, clock).await {
        Ok(watch) => {
            say!("{READY}");
            watch.keep().await
        }
        Err(error) => {
            say!("{REFUSED}{error}");
            Err(error)
        }
    }
}

/// The state folder of the bench, held by this guardian.
struct HeldState {
    folder: State,
    /// Result of the last attempt to latch the bench.
    latched: Option<Result<(), StateError>>,
    _place: Lock,
}

impl HeldState {
    fn new(folder: State, place: Lock) -> Self {
        Self {
            folder,
            latched: None,
            _place: place,
        }
    }

    /// Latches the bench. A write error is kept in `latched`.
    fn latch(&mut self, trip: &Latched) {
        let latched = self.folder.latch(trip);
        if let Err(error) = &latched {
            tracing::error!("{error}");
        }
        self.latched = Some(latched);
    }

    /// Settles the run, unless the bench had to be latched and the latch could not be written.
    fn settle(&mut self) {
        let latched = self.latched.take().unwrap_or(Ok(()));
        if let Err(error) = latched.and_then(|()| self.folder.settled()) {
            tracing::error!("{error}");
        }
    }
}

struct Watch<'a> {
    charge: &'a Charge<'a>,
    clock: Clock,
    connections: Connections,
    report: Report,
    /// The cell is in the jig, as far as is known.
    cell: bool,
    messages: UnboundedReceiver<String>,
    state: HeldState,
}

impl<'a> Watch<'a> {
    async fn start(charge: &'a Charge<'a>, clock: &Clock) -> Result<Self, GuardianError> {
        let state = State::of(charge.bench)?.ok_or(GuardianError::NothingToGuard)?;
        let place = state.lock_guardian()?.ok_or(GuardianError::Another)?;
        let log = state.path("guardian.log");
        logging::log_to_limited(&log, clock).map_err(|source| StateError::Io {
            path: log,
            what: "cannot be written",
            source,
        })?;
        let mut taps = BTreeMap::new();
        for role in ROLES {
            let path = state.path(&format!("guardian_{role}.txt"));
            let begun = File::create(&path).and_then(|_| logging::Limited::open(&path));
            let file = begun.map_err(|source| StateError::Io {
                path,
                what: "cannot be written",
                source,
            })?;
            taps.insert(role, Tap::new(file));
        }
        let connections = Connections {
            clock: clock.clone(),
            hub: MemoryHub::new(),
            taps,
        };
        reach(charge.bench, &connections).await?;
        let report = Report {
            pid: pid(),
            daemon: getppid().as_raw(),
            run: charge.run.display().to_string(),
            status: Status::Watching,
            cause: None,
            step: String::new(),
            attempts: 0,
            safe: None,
            cell_degc: charge.cell_degc,
            bath_degc: None,
            bath_ended: None,
            took_s: None,
            unix_s: clock::unix_time_s(),
        };
        state.json(REPORT, &report)?;
        let (run, unix_s) = (&report.run, report.unix_s);
        tracing::info!(
            "process {}, at {unix_s:.0} s since 1970: watching process {} on {} for {run}",
            report.pid,
            report.daemon,
            charge.bench.name
        );
        Ok(Self {
            charge,
            clock: clock.clone(),
            connections,
            report,
            cell: false,
            messages: daemon_messages(),
            state: HeldState::new(state, place),
        })
    }

    async fn keep(mut self) -> Result<(), GuardianError> {
        let lease = Duration::from_secs_f64(self.charge.bench.guardian.lease_s.value());
        let cause = loop {
            match self.clock.deadline(lease, self.messages.recv()).await {
                Ok(Some(word)) if word == GOODBYE => {
                    tracing::info!("goodbye");
                    return self.tell(Status::Dismissed);
                }
                Ok(Some(word)) if word == TAKE_OVER => {
                    break "the daemon could not verify safe state";
                }
                Ok(Some(word)) => {
                    if let Some(doing) = word.strip_prefix(DOING) {
                        self.note_daemon_state(doing);
                    }
                    say!("{ALIVE}");
                }
                Ok(None) => break "the daemon died",
                Err(_) => {
                    self.end_daemon().await;
                    break "the daemon hung or was stopped";
                }
            }
        };
        tracing::warn!("{cause} in step \"{}\": switching off", self.report.step);
        self.report.cause = Some(cause.to_owned());
        self.switch_off().await
    }

    /// Records what the daemon reports: fixture in the jig, set-point at which the bath was
    /// started, and step.
    fn note_daemon_state(&mut self, doing: &str) {
        let mut fields = doing.splitn(3, ' ');
        let (Some(fixture), Some(bath), Some(step)) = (fields.next(), fields.next(), fields.next())
        else {
            return;
        };
        (self.cell, self.report.step) = (fixture == "cell", step.to_owned());
        let bath_degc = bath.parse().ok().map(Celsius);
        if self.report.bath_degc != bath_degc {
            self.report.bath_degc = bath_degc;
            // Recorded for the process that switches off if this process dies, too.
            self.note(Status::Watching);
        }
    }

    /// Kills the daemon. A daemon that resumed during the shutdown would be worse than a dead one,
    /// and its connections block other clients.
    async fn end_daemon(&mut self) {
        let daemon = Pid::from_raw(self.report.daemon);
        // As long as the daemon is the parent, its process ID cannot have been reused.
        if getppid() == daemon {
            tracing::warn!(
                "no word from process {daemon} within {} s: killing it",
                self.charge.bench.guardian.lease_s.0
            );
            if let Err(error) = kill(daemon, Signal::SIGKILL) {
                tracing::error!("process {daemon} cannot be killed: {error}");
            }
        }
        let gone = async { while self.messages.recv().await.is_some() {} };
        if self.clock.deadline(DEATH, gone).await.is_err() {
            tracing::error!("process {daemon} is still there");
        }
    }

    /// Retries until every output is off and read back.
    async fn switch_off(mut self) -> Result<(), GuardianError> {
        let start_s = self.clock.now();
        let mut pause_s = BACKOFF_S.0;
        // A report that cannot be written, for example because the disk is full, must not prevent
        // switching off.
        self.note(Status::SwitchingOff);
        loop {
            self.report.attempts += 1;
            let mut bench = Bench::unconnected(self.charge.bench, &self.connections)?;
            let safe = bench.safe_state().await;
            let took_s = self.clock.now() - start_s;
            if safe.drives_verified() && self.report.took_s.is_none() {
                self.report.took_s = Some(took_s);
                self.bath(&mut bench).await;
            }
            drop(bench);
            self.keep_reading(&safe);
            if safe.verified {
                return self.verified(&safe, Status::Verified);
            }
            self.failed(&safe);
            // By now every relay pulse has ended, and the bench is latched.
            if safe.drives_verified()
                && safe.bath_is_silent()
                && took_s >= self.report.took_s.unwrap_or(took_s) + RELAYS_DROP_S
            {
                self.report.bath_ended = Some(safe.message.clone());
                return self.verified(&safe, Status::BathNotReached);
            }
            if !self.state.folder.exists() && self.report.attempts >= PATIENCE {
                tracing::error!("the state folder was taken away: giving up");
                return Err(GuardianError::GaveUp);
            }
            self.clock.sleep_for(pause_s).await;
            pause_s = (2.0 * pause_s).min(BACKOFF_S.1);
        }
    }

    /// Checks a bath that closes its own loop. The bath continues unless its settings differ from
    /// those that the run made, or its own sensor shows that it is not under control. It is
    /// checked once, after everything that moves charge is off.
    async fn bath(&mut self, bench: &mut Bench) {
        let Some(setpoint_degc) = self.report.bath_degc else {
            return;
        };
        let order = BathOrder {
            cell_degc: self.charge.cell_degc,
            stop: None,
        };
        let Some(bath) = bench.stop_stray_bath_of(setpoint_degc, &order).await else {
            return;
        };
        tracing::warn!("{bath}");
        if bath.astray {
            self.latch(Latched::new(
                "guardian",
                &format!("{}: {bath}", self.cause()),
            ));
        }
        self.report.bath_ended = Some(bath.words);
    }

    /// Stores what was read back. Ignores write errors.
    fn keep_reading(&mut self, safe: &SafeReport) {
        if let Err(error) = self.state.folder.keep_readings(&safe.readings("guardian")) {
            tracing::error!("{error}");
        }
        self.report.safe = Some(safe.clone());
    }

    fn failed(&mut self, safe: &SafeReport) {
        tracing::error!(
            "attempt {}: {}; {}",
            self.report.attempts,
            safe.message,
            safe.troubles()
        );
        if self.report.attempts == 1 {
            tracing::error!(
                "trying again until it succeeds; to end this, kill process {}",
                pid()
            );
            self.latch(Latched::new(
                "guardian",
                &format!(
                    "{}, and the guardian cannot switch off: {}",
                    self.cause(),
                    safe.message
                ),
            ));
        }
        self.note(Status::SwitchingOff);
    }

    /// Writes the report. Write errors do not stop the guardian.
    fn note(&mut self, status: Status) {
        if let Err(error) = self.tell(status) {
            tracing::error!("{error}");
        }
    }

    /// Ends the guardian's work after everything that moves charge is verified as off.
    fn verified(&mut self, safe: &SafeReport, status: Status) -> Result<(), GuardianError> {
        let took_s = self.report.took_s.unwrap_or(Seconds::ZERO);
        tracing::warn!(
            "{}: {}, {took_s:.1} after the guardian stepped in",
            safe.read,
            safe.message
        );
        // The sense leads of the load are connected to the cell itself. A voltage that can no
        // longer be read may have any value.
        let read = |role: &&str| {
            safe.outputs
                .iter()
                .find(|output| output.role == *role)?
                .volts
        };
        let volts = ["load", "supply4q"]
            .iter()
            .find_map(read)
            .unwrap_or(Volts::NAN);
        let (least, greatest) = self.charge.window_v;
        if let Some(value) =
            Some(volts).filter(|volts| self.cell && !(least..=greatest).contains(volts))
        {
            let what = "cell voltage, found by the guardian after it had switched off,";
            let trip = Trip::limit(what, value, &(least..=greatest), self.clock.now());
            self.latch(Latched::of_trip("guardian", &trip));
        }
        self.note(status);
        // After the latch: if the latch could not be written, the run stays open.
        self.state.settle();
        Ok(self.state.folder.remember(
            &serde_json::json!({ "what": "switched off by the guardian", "report": self.report }),
        )?)
    }

    fn cause(&self) -> &str {
        self.report.cause.as_deref().unwrap_or_default()
    }

    fn latch(&mut self, trip: Latched) {
        let trip = trip.during(self.charge.run, &self.report.step);
        self.state.latch(&trip);
    }

    fn tell(&mut self, status: Status) -> Result<(), GuardianError> {
        (self.report.status, self.report.unix_s) = (status, clock::unix_time_s());
        Ok(self.state.folder.json(REPORT, &self.report)?)
    }
}

/// Reaches and identifies every instrument that can move charge, and the bath if it can be
/// reached. Then closes the connections, because the daemon connects next.
async fn reach(bench: &config::Bench, connections: &Connections) -> Result<(), GuardianError> {
    let mut bench = Bench::unconnected(bench, connections)?;
    bench.connect().await?;
    let bath = bench.instruments.chiller.take();
    bench
        .identify()
        .await?
        .iter()
        .try_for_each(Identified::expected)?;
    bench.instruments.chiller = bath;
    // A bath moves no charge and may serve another client. The daemon decides whether this is an
    // error.
    if let Err(error) = bench.reach_bath().await {
        tracing::warn!("{error}");
    }
    Ok(())
}

/// Returns the messages that the daemon sends; the channel closes when the daemon ends.
fn daemon_messages() -> UnboundedReceiver<String> {
    let (tell, messages) = tokio::sync::mpsc::unbounded_channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines() {
            let Ok(line) = line else { return };
            if tell.send(line).is_err() {
                return;
            }
        }
    });
    messages
}
