//! The daemon: a queue of experiments, each of them run by a process of its own (`eis-bench run`),
//! watched through its folder, and shown over HTTP.
//!
//! A run does not know that it is served. It has its own guardian, journal and safe state, so that
//! nothing that happens to the server – a crash, a kill, a client too many – reaches it; a server
//! that is restarted finds it by its lock. A run is controlled as from a terminal: run control
//! requests in its folder, SIGTERM, `eis-bench safe`.
//!
//! In reading order: [`settings`], [`token`], [`audit`], [`hub`] (events), [`queue`],
//! [`submission`], [`watch`] (a run folder, read as it grows), [`live`], [`proof`], [`supervisor`]
//! (the one thread that begins and watches), [`stop`], [`http`].

pub mod audit;
pub mod follow;
pub mod http;
pub mod hub;
pub mod jobs;
pub mod live;
pub mod locks;
pub mod proof;
pub mod queue;
pub mod settings;
pub mod spectra;
pub mod stop;
pub mod submission;
pub mod supervisor;
pub mod systemd;
pub mod token;
pub mod transcript_monitor;
pub mod watch;

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use instruments::clock::{self, Clock, TimeMode};
use nix::sys::resource::{Resource, getrlimit, setrlimit};

use crate::{run::StopSignals, safety::failure::Failure, support::terminal::say};
use audit::Audit;
use hub::Hub;
use live::{Live, StopReport};
use queue::Queue;
use settings::Settings;
use token::{TokenError, Tokens};

/// State that all requests share.
pub struct Server {
    /// Its file, resolved.
    pub settings: Settings,
    /// Events of the server.
    pub hub: Hub,
    /// Who may do what.
    pub tokens: Tokens,
    /// Who did what.
    pub audit: Audit,
    /// Real time.
    pub clock: Clock,
    /// This program, to be started for runs.
    pub program: PathBuf,
    /// Counters for the metrics.
    pub counts: Counts,
    queue: Mutex<Queue>,
    live: Mutex<BTreeMap<String, Live>>,
    stops: Mutex<BTreeMap<String, StopReport>>,
    identities: Mutex<BTreeMap<String, Vec<supervisor::Identity>>>,
}

/// Counters since the start.
#[derive(Debug, Default)]
pub struct Counts {
    /// Answers by the first digit of their status.
    pub answers: [AtomicU64; 6],
    /// Listeners at present.
    pub listeners: AtomicU64,
    /// Connections at present.
    pub connections: AtomicU64,
    /// Listeners that were told that they had missed something.
    pub lagged: AtomicU64,
    /// Looks of the supervisor.
    pub looks: AtomicU64,
}

impl Counts {
    /// One more answer.
    pub fn answered(&self, status: u16) {
        if let Some(count) = self.answers.get(usize::from(status / 100)) {
            count.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Server {
    /// Opens the data folder; nothing is begun yet. Must be called inside a runtime.
    ///
    /// # Errors
    /// A data folder that cannot be made, read or written; another server that uses it.
    pub fn open(settings: Settings) -> Result<Self, Failure> {
        let tokens = Tokens::of(&settings.data);
        if !settings.listen.ip().is_loopback()
            && tokens
                .all()
                .map_err(|error| Failure::Usage(error.to_string()))?
                .is_empty()
        {
            return Err(Failure::Usage(format!(
                "expected at least one token to listen beyond this machine (on {}), found none: \
                `eis-bench token add` makes one",
                settings.listen
            )));
        }
        let queue =
            Queue::open(&settings.data).map_err(|error| Failure::Usage(error.to_string()))?;
        let live = settings.benches.iter().map(|bench| {
            (
                bench.name.clone(),
                Live {
                    bench: bench.name.clone(),
                    ..Live::default()
                },
            )
        });
        Ok(Self {
            hub: Hub::new((clock::unix_time_s() * 1.0e3) as u64),
            audit: Audit::open(&settings.data)?,
            clock: Clock::start(TimeMode::Real),
            program: std::env::current_exe()?,
            counts: Counts::default(),
            queue: Mutex::new(queue),
            live: Mutex::new(live.collect()),
            stops: Mutex::default(),
            identities: Mutex::default(),
            tokens,
            settings,
        })
    }

    /// Whether everybody on this machine may do everything: it listens nowhere else, and there is
    /// no token at all.
    ///
    /// # Errors
    /// Tokens that cannot be read.
    pub fn open_to_all(&self) -> Result<bool, TokenError> {
        Ok(self.settings.listen.ip().is_loopback() && self.tokens.all()?.is_empty())
    }

    /// The queue.
    pub fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The benches as they are now.
    pub fn live(&self) -> MutexGuard<'_, BTreeMap<String, Live>> {
        self.live.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reports of the last stops, by bench.
    pub fn stops(&self) -> MutexGuard<'_, BTreeMap<String, StopReport>> {
        self.stops.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Identities of the instruments by their own last answers, by bench.
    pub fn identities(&self) -> MutexGuard<'_, BTreeMap<String, Vec<supervisor::Identity>>> {
        self.identities
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Folder of the runs.
    pub fn runs(&self) -> PathBuf {
        self.settings.data.join("runs")
    }

    /// Tells everybody what is in the queue.
    pub fn tell_queue(&self) {
        let shown = http::queue::QueueNow::of(self);
        self.hub.tell("queue", &shown);
    }
}

/// Serves until a signal asks to stop. Runs in work go on; the next server finds them.
///
/// # Errors
/// Any failure to listen.
pub fn serve(settings: Settings) -> Result<(), Failure> {
    for part in ["runs", "jobs", "submitted", "logs"] {
        std::fs::create_dir_all(settings.data.join(part))?;
    }
    let folder = std::fs::File::options()
        .create(true)
        .append(true)
        .open(settings.data.join("lock"))?;
    if folder.try_lock().is_err() {
        return Err(Failure::Usage(format!(
            "{}: expected a data folder of its own, found one that another server uses",
            settings.data.display()
        )));
    }
    // A connection is a file. Where the system grants more than it gives by itself, they are taken;
    // where it does not, the longest silent go.
    if let Err(error) = getrlimit(Resource::RLIMIT_NOFILE)
        .and_then(|(_, most)| setrlimit(Resource::RLIMIT_NOFILE, most, most))
    {
        tracing::warn!("the limit of open files stays as it is: {error}");
    }
    // Requests, and the stop among them, do not wait for one that computes.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let outcome = runtime.block_on(until_stopped(settings));
    runtime.shutdown_background();
    outcome
}

async fn until_stopped(settings: Settings) -> Result<(), Failure> {
    let mut stop = StopSignals::install()?;
    let server = Arc::new(Server::open(settings)?);
    let notify = systemd::Notify::from_environment();
    let listener = http::Listener::bind(&server).await?;
    let supervisor = supervisor::start(&server)?;
    say!("listening on {}", listener.url());
    notify.say("READY=1");
    let refresh = async {
        let mut seen = 0;
        while let Some(every_s) = notify.watchdog_s {
            server.clock.sleep_s(every_s).await;
            // A supervisor that no longer looks is no life.
            let looks = server.counts.looks.load(Ordering::Relaxed);
            if looks != std::mem::replace(&mut seen, looks) {
                notify.say("WATCHDOG=1");
            }
        }
        std::future::pending::<()>().await;
    };
    tokio::select! {
        () = listener.accept(&server) => {}
        () = refresh => {}
        () = stop.requested() => {}
    }
    notify.say("STOPPING=1");
    tracing::info!("stopping; runs in work go on by themselves");
    server.hub.close();
    supervisor.end();
    Ok(())
}
