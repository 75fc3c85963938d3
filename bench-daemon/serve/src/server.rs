//! State that all requests share.

use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
};

use instruments::clock::{self, Clock, TimeMode};

use super::{
    analyses::Analyses,
    audit::Audit,
    catalog::CatalogKeeper,
    health::Health,
    hub::Hub,
    jobs::Jobs,
    live::{Live, StopReport},
    notebook::Notebook,
    notices::Notices,
    pack::LastModel,
    queue::Queue,
    session::Sessions,
    settings::Settings,
    supervisor,
    timeline::Timelines,
    token::{TokenError, Tokens},
};
use bench_core::safety::failure::Failure;
use bench_evaluate::support::telemetry::{Telemetry, Tracer, counts::TelemetryCounts};

/// State that all requests share.
pub struct Server {
    /// Its file, resolved.
    pub settings: Settings,
    /// Events of the server.
    pub hub: Hub,
    /// Tokens and their permissions.
    pub tokens: Tokens,
    /// Audit trail.
    pub audit: Audit,
    /// Real time.
    pub clock: Clock,
    /// This program, to be started for runs.
    pub program: PathBuf,
    /// Counters for the metrics.
    pub counts: Counts,
    /// Notes on benches and disk for the metrics.
    pub health: Health,
    /// Tracer; `None` if tracing is off.
    pub tracer: Option<Tracer>,
    /// Counts of exported telemetry.
    pub telemetry: Arc<TelemetryCounts>,
    /// Readings of runs.
    pub timelines: Timelines,
    /// Analyses of runs.
    pub analyses: Analyses,
    /// The model that the pack explorer has asked for last.
    pub last_model: LastModel,
    /// Notifications to people away from the page.
    pub notices: Notices,
    /// Sessions of browsers.
    pub sessions: Sessions,
    /// Runs that were begun here.
    pub jobs: Arc<Jobs>,
    /// Notes and tags.
    pub notebook: Arc<Notebook>,
    /// The catalogue of runs and diagnoses.
    pub catalog: Arc<CatalogKeeper>,
    queue: Mutex<Queue>,
    shelf: Mutex<()>,
    live: Mutex<BTreeMap<String, Live>>,
    stops: Mutex<BTreeMap<String, StopReport>>,
    identities: Mutex<BTreeMap<String, Vec<supervisor::Asked>>>,
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
    /// Number of times that listeners were informed of missed events.
    pub lagged: AtomicU64,
    /// Number of polls of the supervisor.
    pub looks: AtomicU64,
    /// When the server was started, s since 1970.
    pub started_unix_s: f64,
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
    /// Opens the data folder without starting anything. Must be called inside a runtime.
    ///
    /// # Errors
    /// A data folder that cannot be created, read or written; another server that uses it.
    pub fn open(settings: Settings, telemetry: &Telemetry) -> Result<Self, Failure> {
        let tokens = Tokens::of(&settings.data);
        if !settings.is_of_this_machine()
            && tokens
                .all()
                .map_err(|error| Failure::Usage(error.to_string()))?
                .is_empty()
        {
            return Err(Failure::Usage(format!(
                "expected at least one token to listen beyond this machine (on {}{}), found none: \
                `eis-bench token add` makes one",
                settings.listen,
                settings
                    .proxy_host
                    .as_ref()
                    .map_or_else(String::new, |host| format!(", as {host}"))
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
                }
                .judged(),
            )
        });
        let started_unix_s = clock::unix_time_s();
        let jobs = Arc::new(Jobs::of(&settings.data));
        let notebook = Arc::new(Notebook::of(&settings.data));
        Ok(Self {
            hub: Hub::new((started_unix_s * 1.0e3) as u64),
            audit: Audit::open(&settings.data)?,
            clock: Clock::start(TimeMode::Real),
            program: std::env::current_exe()?,
            counts: Counts {
                started_unix_s,
                ..Counts::default()
            },
            health: Health::of(
                &settings.data,
                &jobs,
                settings.benches.iter().map(|bench| bench.name.as_str()),
            ),
            tracer: telemetry.tracer(),
            telemetry: telemetry.counts().clone(),
            timelines: Timelines::default(),
            analyses: Analyses::open(&settings.data),
            last_model: LastModel::default(),
            notices: Notices::default(),
            sessions: Sessions::default(),
            catalog: Arc::new(CatalogKeeper::of(&settings.data, notebook.clone())),
            notebook,
            jobs,
            queue: Mutex::new(queue),
            shelf: Mutex::default(),
            live: Mutex::new(live.collect()),
            stops: Mutex::default(),
            identities: Mutex::default(),
            tokens,
            settings,
        })
    }

    /// Returns whether every local caller may do everything: the server is reachable from this
    /// machine only, and no token exists.
    ///
    /// # Errors
    /// Tokens that cannot be read.
    pub fn open_to_all(&self) -> Result<bool, TokenError> {
        Ok(self.settings.is_of_this_machine() && self.tokens.all()?.is_empty())
    }

    /// The queue.
    pub fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks the configuration store, so that no other version of a file is written meanwhile.
    pub fn shelf(&self) -> MutexGuard<'_, ()> {
        self.shelf.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The benches as they are now.
    pub fn live(&self) -> MutexGuard<'_, BTreeMap<String, Live>> {
        self.live.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reports of the last stops, by bench.
    pub fn stops(&self) -> MutexGuard<'_, BTreeMap<String, StopReport>> {
        self.stops.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns what the instruments answered when they were last asked outside a run, by bench.
    pub fn identities(&self) -> MutexGuard<'_, BTreeMap<String, Vec<supervisor::Asked>>> {
        self.identities
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Folder of the runs.
    pub fn runs(&self) -> PathBuf {
        self.settings.runs()
    }
}
