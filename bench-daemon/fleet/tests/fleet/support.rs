//! A broker as a process, a network that can be cut, and benches that write down themselves what
//! they did, whatever the fleet's records say.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::{self, File, OpenOptions},
    io::{Read, Write},
    net::{SocketAddr, TcpListener as Bound, TcpStream as Blocking},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{
        Arc, Condvar, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
};

use bench_fleet::{
    BenchState, Capabilities, Client, Condition, End, Fate, Fleet, FleetSettings, LocalBench,
    Order, Reading, Submission,
    fleet::Joining,
    local::{Away, NotDone, NotTaken},
};
use futures_util::{FutureExt, future::BoxFuture};
use instruments_link::clock::{Clock, TimeMode};
use tokio::{
    io::AsyncWriteExt,
    net::{TcpListener, TcpStream},
    sync::watch,
    task::AbortHandle,
};

/// Real time.
pub(crate) fn clock() -> Clock {
    Clock::start(TimeMode::Real)
}

pub(crate) async fn pause(seconds: f64) {
    clock().sleep_s(seconds).await;
}

/// Waits until something is so.
#[track_caller]
pub(crate) fn until<'a>(
    what: &'a str,
    patience_s: f64,
    mut is_so: impl AsyncFnMut() -> bool + 'a,
) -> impl Future<Output = ()> + 'a {
    let caller = std::panic::Location::caller();
    async move {
        let clock = clock();
        while !is_so().await {
            assert!(clock.now_s() < patience_s, "{caller}: {what} did not come");
            clock.sleep_s(0.05).await;
        }
    }
}

fn free_port() -> u16 {
    let bound = Bound::bind("127.0.0.1:0").unwrap();
    bound.local_addr().unwrap().port()
}

/// A broker.
pub(crate) struct Broker {
    child: Option<Child>,
    store: PathBuf,
    pub(crate) port: u16,
    monitor: u16,
    config: Option<PathBuf>,
}

impl Broker {
    /// Starts a broker, or returns `None` if the program is not installed.
    pub(crate) fn start(folder: &Path) -> Option<Self> {
        let mut broker = Self {
            child: None,
            store: folder.join("nats"),
            port: free_port(),
            monitor: free_port(),
            config: None,
        };
        if let Err(error) = broker.run() {
            eprintln!("skipped: nats-server cannot be started: {error}");
            return None;
        }
        Some(broker)
    }

    /// Starts a broker that requires a password, over TLS with a self-signed certificate; returns
    /// `None` if `openssl` or the broker is not installed.
    pub(crate) fn start_with_tls(folder: &Path) -> Option<Self> {
        for arguments in [
            "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=ca -keyout ca.key -out ca.pem",
            "req -newkey rsa:2048 -nodes -subj /CN=nats -keyout nats.key -out nats.csr",
            "x509 -req -in nats.csr -CA ca.pem -CAkey ca.key -CAcreateserial -days 2 \
             -extfile nats.ext -out nats.pem",
        ] {
            fs::write(folder.join("nats.ext"), "subjectAltName = IP:127.0.0.1\n").unwrap();
            let made = Command::new("openssl")
                .args(arguments.split_whitespace())
                .current_dir(folder)
                .stderr(Stdio::null())
                .status();
            if !made.is_ok_and(|status| status.success()) {
                eprintln!("skipped: openssl makes no certificate");
                return None;
            }
        }
        let path = |name: &str| folder.join(name).display().to_string();
        let text = format!(
            "tls {{ cert_file: {:?}, key_file: {:?} }}\n\
            authorization {{ users = [ {{ user: north, password: secret }} ] }}\n",
            path("nats.pem"),
            path("nats.key")
        );
        fs::write(folder.join("nats.conf"), text).unwrap();
        let mut broker = Self {
            child: None,
            store: folder.join("nats"),
            port: free_port(),
            monitor: free_port(),
            config: Some(folder.join("nats.conf")),
        };
        broker.run().ok()?;
        Some(broker)
    }

    fn run(&mut self) -> std::io::Result<()> {
        let mut command = Command::new("nats-server");
        if let Some(config) = &self.config {
            command.arg("-c").arg(config);
        }
        command
            .args(["-js", "-a", "127.0.0.1", "-p", &self.port.to_string()])
            .args(["-m", &self.monitor.to_string(), "-sd"])
            .arg(&self.store)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        self.child = Some(command.spawn()?);
        Ok(())
    }

    pub(crate) fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }

    pub(crate) fn restart(&mut self) {
        self.run().unwrap();
    }

    pub(crate) fn address(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    /// Memory that the broker has in use, MB.
    pub(crate) fn memory_mb(&self) -> f64 {
        let pid = self.child.as_ref().map_or(0, Child::id);
        resident_mb(&format!("/proc/{pid}/status"))
    }

    /// Messages that it has taken and sent since its start.
    pub(crate) fn messages(&self) -> u64 {
        let Ok(mut stream) = Blocking::connect(("127.0.0.1", self.monitor)) else {
            return 0;
        };
        let _ = stream.write_all(b"GET /varz HTTP/1.0\r\n\r\n");
        let mut text = String::new();
        let _ = stream.read_to_string(&mut text);
        let body = text.split_once("\r\n\r\n").map_or("", |(_, body)| body);
        let value: serde_json::Value = serde_json::from_str(body).unwrap_or_default();
        let count = |key: &str| value[key].as_u64().unwrap_or_default();
        count("in_msgs") + count("out_msgs")
    }
}

impl Drop for Broker {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Memory of a process, MB.
pub(crate) fn resident_mb(path: &str) -> f64 {
    let status = fs::read_to_string(path).unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmRSS"));
    let kb = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<f64>().ok());
    kb.unwrap_or_default() / 1024.0
}

/// A network between daemons and a broker that can be cut: connections are closed or hang, and no
/// new connection succeeds.
pub(crate) struct Network {
    pub(crate) port: u16,
    cut: watch::Sender<bool>,
}

impl Network {
    pub(crate) async fn to(broker: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let port = listener.local_addr().unwrap().port();
        let (cut, heard) = watch::channel(false);
        tokio::spawn(async move {
            let mut number = 0_u64;
            while let Ok((client, _)) = listener.accept().await {
                number += 1;
                tokio::spawn(pass(
                    client,
                    broker,
                    heard.clone(),
                    number.is_multiple_of(2),
                ));
            }
        });
        Self { port, cut }
    }

    pub(crate) fn cut(&self, is_cut: bool) {
        self.cut.send_replace(is_cut);
    }

    pub(crate) fn address(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }
}

async fn pass(mut client: TcpStream, broker: u16, mut cut: watch::Receiver<bool>, hangs: bool) {
    if *cut.borrow_and_update() {
        return;
    }
    let address = SocketAddr::from(([127, 0, 0, 1], broker));
    let Ok(mut server) = TcpStream::connect(address).await else {
        return;
    };
    tokio::select! {
        _ = tokio::io::copy_bidirectional(&mut client, &mut server) => {}
        _ = cut.changed() => {
            if hangs {
                // Data is dropped silently.
                let _ = cut.changed().await;
            }
        }
    }
    let _ = client.shutdown().await;
}

/// A machine with one bench: its disk and its runs outlive the daemon on it.
pub(crate) struct Machine {
    pub(crate) name: String,
    pub(crate) folder: PathBuf,
    run_s: Mutex<f64>,
    runs: Mutex<Vec<AbortHandle>>,
    held: Mutex<Option<String>>,
    pub(crate) capabilities: Capabilities,
    pub(crate) stops: AtomicUsize,
    gate: (Mutex<bool>, Condvar),
    is_off: AtomicBool,
    /// Its disk is full.
    pub(crate) is_full: AtomicBool,
    /// It cannot begin a run.
    pub(crate) is_broken: AtomicBool,
    /// Its server does not answer.
    pub(crate) is_away: AtomicBool,
    /// The next reply to a begin is lost, after the run was begun.
    pub(crate) loses_reply: AtomicBool,
}

impl Machine {
    pub(crate) fn new(root: &Path, name: &str, run_s: f64) -> Arc<Self> {
        let folder = root.join(name);
        for part in ["queued", "ended"] {
            fs::create_dir_all(folder.join(part)).unwrap();
        }
        let capabilities = Capabilities {
            current_a: 20.0,
            temperature_degc: Some([-10.0, 60.0]),
            fixtures: vec!["cell".to_owned(), "shunt".to_owned()],
            simulated: true,
        };
        Arc::new(Self {
            name: name.to_owned(),
            folder,
            run_s: Mutex::new(run_s),
            runs: Mutex::default(),
            held: Mutex::default(),
            capabilities,
            stops: AtomicUsize::new(0),
            gate: (Mutex::new(true), Condvar::new()),
            is_off: AtomicBool::new(false),
            is_full: AtomicBool::new(false),
            is_broken: AtomicBool::new(false),
            is_away: AtomicBool::new(false),
            loses_reply: AtomicBool::new(false),
        })
    }

    pub(crate) fn runs_take(&self, run_s: f64) {
        *self.run_s.lock().unwrap() = run_s;
    }

    /// From now on a begin waits, or goes on.
    pub(crate) fn lets_begin(&self, lets: bool) {
        *self.gate.0.lock().unwrap() = lets;
        self.gate.1.notify_all();
    }

    /// The machine goes off, with its runs.
    pub(crate) fn power_off(&self) {
        self.is_off.store(true, Ordering::SeqCst);
        self.end_runs();
    }

    fn end_runs(&self) {
        for run in self.runs.lock().unwrap().drain(..) {
            run.abort();
        }
    }

    fn names(&self, part: &str) -> BTreeSet<String> {
        let entries = fs::read_dir(self.folder.join(part)).unwrap();
        let name = |entry: std::io::Result<fs::DirEntry>| {
            entry.unwrap().file_name().into_string().unwrap()
        };
        entries.map(name).collect()
    }

    pub(crate) fn going(&self) -> Vec<String> {
        let ended = self.names("ended");
        let queued = self.names("queued").into_iter();
        queued.filter(|run| !ended.contains(run)).collect()
    }

    /// A person begins a run at this bench.
    pub(crate) fn begin_by_hand(&self, run: &str) {
        self.spawn(run);
    }

    fn answers(&self) -> Result<(), Away> {
        match self.is_away.load(Ordering::SeqCst) {
            true => Err(Away("no reply".to_owned())),
            false => Ok(()),
        }
    }

    fn spawn(&self, run: &str) {
        File::create(self.folder.join("queued").join(run)).unwrap();
        let (folder, run, run_s) = (
            self.folder.clone(),
            run.to_owned(),
            *self.run_s.lock().unwrap(),
        );
        let task = tokio::spawn(async move { play(&folder, &run, run_s).await });
        self.runs.lock().unwrap().push(task.abort_handle());
    }
}

fn append(folder: &Path, line: &str) {
    let mut options = OpenOptions::new();
    let mut ledger = options
        .create(true)
        .append(true)
        .open(folder.join("ledger"))
        .unwrap();
    ledger.write_all(format!("{line}\n").as_bytes()).unwrap();
}

/// Writes atomically, so that a concurrent reader finds no partial end.
fn end(folder: &Path, run: &str, how: &str) {
    let beside = folder.join(format!("{run}.ended"));
    fs::write(&beside, how).unwrap();
    fs::rename(beside, folder.join("ended").join(run)).unwrap();
}

/// Simulates a run: it drives the bench exclusively, and records that in the ledger.
async fn play(folder: &Path, run: &str, run_s: f64) {
    let lock = File::create(folder.join("lock")).unwrap();
    if lock.try_lock().is_err() {
        append(folder, &format!("two {run}"));
    }
    append(folder, &format!("begin {run}"));
    pause(run_s).await;
    append(folder, &format!("end {run}"));
    end(folder, run, "finished");
}

impl LocalBench for Machine {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn capabilities(&self) -> Capabilities {
        self.capabilities.clone()
    }

    fn condition(&self) -> Result<Condition, Away> {
        self.answers()?;
        let going = self.going();
        let held = self.held.lock().unwrap().clone();
        Ok(Condition {
            state: match (&held, going.is_empty()) {
                (_, false) => BenchState::Running,
                (Some(_), true) => BenchState::Held,
                (None, true) => BenchState::Idle,
            },
            free: going.is_empty() && held.is_none(),
            verified: going.is_empty().then_some(true),
            reading: going.first().map(|_| Reading {
                voltage_v: Some(3.7),
                current_a: Some(1.0),
                temperature_degc: None,
            }),
            run: going.into_iter().next(),
            held,
            ..Condition::default()
        })
    }

    fn check(&self, order: &Order) -> Result<(), NotTaken> {
        if let Err(away) = self.answers() {
            return Err(NotTaken::NotNow(away.to_string()));
        }
        if order.text.contains(&format!("not {}", self.name)) {
            let words = "the plan would leave the limits of this bench".to_owned();
            return Err(NotTaken::Unfit(words));
        }
        if self.is_full.load(Ordering::SeqCst) {
            return Err(NotTaken::NotNow("no space left".to_owned()));
        }
        Ok(())
    }

    fn begin(&self, order: &Order) -> Result<(), NotDone> {
        self.answers().map_err(NotDone::Away)?;
        if self.is_broken.load(Ordering::SeqCst) {
            return Err(NotDone::Refused("no queue".to_owned()));
        }
        let mut lets = self.gate.0.lock().unwrap();
        while !*lets {
            lets = self.gate.1.wait(lets).unwrap();
            if self.is_off.load(Ordering::SeqCst) {
                return Err(NotDone::Refused("off".to_owned()));
            }
        }
        drop(lets);
        if self.names("queued").contains(&order.run) {
            return Ok(());
        }
        assert!(!order.text.is_empty(), "{order:?}");
        self.spawn(&order.run);
        if self.loses_reply.swap(false, Ordering::SeqCst) {
            return Err(NotDone::Away(Away("the reply is lost".to_owned())));
        }
        Ok(())
    }

    fn withdraw(&self, _run: &str, _by: &str) -> Result<bool, Away> {
        // A run here never waits.
        self.answers().map(|()| false)
    }

    fn fate(&self, run: &str) -> Result<Fate, Away> {
        self.answers()?;
        let (queued, ended) = (self.names("queued"), self.folder.join("ended").join(run));
        Ok(match (queued.contains(run), fs::read_to_string(ended)) {
            (_, Ok(words)) => Fate::Ended(End {
                finished: words == "finished",
                words,
                content_sha256: None,
            }),
            (true, Err(_)) => Fate::Going,
            (false, Err(_)) => Fate::Unknown,
        })
    }

    fn hold(&self, by: &str, why: &str) -> Result<(), NotDone> {
        self.answers().map_err(NotDone::Away)?;
        let mut held = self.held.lock().unwrap();
        held.get_or_insert_with(|| format!("{why} (fleet: {by})"));
        Ok(())
    }

    fn release(&self, _by: &str, _why: &str) -> Result<(), NotDone> {
        self.answers().map_err(NotDone::Away)?;
        *self.held.lock().unwrap() = None;
        Ok(())
    }

    fn stop<'a>(&'a self, by: &'a str) -> BoxFuture<'a, Result<serde_json::Value, Away>> {
        async move {
            self.answers()?;
            self.stops.fetch_add(1, Ordering::SeqCst);
            let _ = self.hold(by, "stopped");
            let going = self.going();
            self.end_runs();
            for run in &going {
                append(&self.folder, &format!("stop {run}"));
                end(&self.folder, run, "stopped");
            }
            Ok(serde_json::json!({ "bench": self.name, "by": by, "verified": true }))
        }
        .boxed()
    }

    fn audit(&self, by: &str, what: &str, outcome: &str) -> Result<(), Away> {
        self.answers()?;
        append(
            &self.folder,
            &format!("audit fleet: {by}: {what}: {outcome}"),
        );
        Ok(())
    }
}

/// A daemon with its machines; killing it leaves the machines.
pub(crate) struct Daemon {
    pub(crate) machines: Vec<Arc<Machine>>,
    settings: FleetSettings,
    folder: PathBuf,
    pub(crate) fleet: Option<Arc<Fleet>>,
}

pub(crate) fn settings(server: String, lease_s: f64) -> FleetSettings {
    FleetSettings {
        fleet: "lab".to_owned(),
        site: "north".to_owned(),
        server,
        credentials: None,
        ca: None,
        lease_s,
    }
}

impl Daemon {
    pub(crate) fn new(
        folder: &Path,
        settings: &FleetSettings,
        machines: Vec<Arc<Machine>>,
    ) -> Self {
        let mut daemon = Self {
            folder: folder.join(format!("daemon-{}", machines[0].name)),
            settings: settings.clone(),
            machines,
            fleet: None,
        };
        daemon.start();
        daemon
    }

    pub(crate) fn start(&mut self) {
        let benches = self.machines.iter();
        let joining = Joining {
            settings: self.settings.clone(),
            folder: self.folder.clone(),
            benches: benches
                .map(|one| one.clone() as Arc<dyn LocalBench>)
                .collect(),
        };
        self.fleet = Some(Fleet::join(joining));
    }

    /// Ends it as a kill does: nothing is cleaned up.
    pub(crate) fn kill(&mut self) {
        self.fleet = None;
    }
}

/// Returns a submission of `count` jobs.
pub(crate) fn work(name: &str, count: usize) -> Submission {
    Submission {
        name: name.to_owned(),
        text: "name = \"work\"".to_owned(),
        count,
        by: "ann".to_owned(),
        ..Submission::default()
    }
}

/// Ledgers that the machines wrote themselves.
#[derive(Debug, Default)]
pub(crate) struct Witness {
    /// Begins of each job, whatever its turn.
    pub(crate) begins: BTreeMap<String, usize>,
    pub(crate) ends: usize,
    pub(crate) driven_by_two: usize,
}

/// Reads every ledger; runs are `NAME-JOB` or `NAME-JOB-tN`.
pub(crate) fn witness(machines: &[Arc<Machine>], name: &str) -> Witness {
    let mut found = Witness::default();
    for machine in machines {
        let text = fs::read_to_string(machine.folder.join("ledger")).unwrap_or_default();
        for line in text.lines() {
            let (what, run) = line.split_once(' ').unwrap();
            let Some(job) = run.strip_prefix(&format!("{name}-")) else {
                continue;
            };
            let job = job.split("-t").next().unwrap().to_owned();
            match what {
                "begin" => *found.begins.entry(job).or_default() += 1,
                "end" => found.ends += 1,
                "two" => found.driven_by_two += 1,
                _ => {}
            }
        }
    }
    found
}

/// A client to a broker that is there.
pub(crate) async fn client(settings: &FleetSettings) -> Client {
    let clock = clock();
    loop {
        match Client::connect(settings).await {
            Ok(client) => return client,
            Err(error) => assert!(clock.now_s() < 30.0, "{error}"),
        }
        clock.sleep_s(0.1).await;
    }
}
