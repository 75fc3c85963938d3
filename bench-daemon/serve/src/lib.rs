//! The daemon: a queue of experiments over HTTP. A separate process runs each experiment
//! (`eis-bench run`), and the daemon watches it through its folder.
//!
//! A run does not depend on the server. It has its own guardian, journal and safe state, so that
//! no event of the server – a crash, a kill, too many clients – affects it; a restarted server
//! finds the run by its lock. A run is controlled as from a terminal: run control requests in its
//! folder, SIGTERM, `eis-bench safe`.
//!
//! In reading order: [`settings`], [`token`], [`audit`], [`hub`] (events), [`queue`],
//! [`submission`], [`watch`] (a run folder, read as it grows), [`timeline`] (its readings and
//! events), [`live`], [`outputs`], [`supervisor`] (the one thread that begins and watches),
//! [`stop`], [`http`].

pub mod analyses;
pub mod analyst;
pub mod audit;
pub mod capabilities;
pub mod capture;
pub mod catalog;
pub mod controls;
pub mod draft;
pub mod find;
pub mod follow;
pub mod health;
pub mod http;
pub mod hub;
pub mod imported;
pub mod investigations;
pub mod investigator;
pub mod jobs;
pub mod live;
pub mod metrics;
pub mod models;
pub mod notebook;
pub mod notices;
pub mod notify;
#[cfg(feature = "otlp")]
pub mod otlp;
#[cfg(not(feature = "otlp"))]
#[path = "otlp_off.rs"]
pub mod otlp;
pub mod outputs;
pub mod pack;
pub mod queue;
pub mod queue_now;
mod server;
pub mod session;
pub mod settings;
pub mod shelf;
pub mod spectra;
pub mod stop;
pub mod submission;
pub mod supervisor;
pub mod systemd;
pub mod targets;
pub mod timeline;
pub mod token;
#[cfg(feature = "otlp")]
pub mod traced;
#[cfg(not(feature = "otlp"))]
#[path = "traced_off.rs"]
pub mod traced;
pub mod transcript_monitor;
pub mod watch;

use std::{
    io::Write as _,
    sync::{Arc, atomic::Ordering},
};

use instruments::clock::Clock;
use nix::sys::resource::{Resource, getrlimit, setrlimit};

use bench_core::safety::failure::Failure;
use bench_evaluate::run::StopSignals;
use bench_plan::support::terminal::say;
pub use server::{Counts, Server};
use settings::Settings;

/// Locked file of the data folder.
const LOCK: &str = "lock";

/// Serves until a signal requests a stop. Active runs continue; the next server finds them.
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
        .open(settings.data.join(LOCK))?;
    if folder.try_lock().is_err() {
        let other = std::fs::read_to_string(settings.data.join(LOCK)).unwrap_or_default();
        return Err(Failure::Usage(format!(
            "{}: expected a data folder of its own, found one that another server uses{}; a second \
            server needs another `data` and another `listen`",
            settings.data.display(),
            if other.is_empty() {
                String::new()
            } else {
                format!(" ({})", other.trim())
            }
        )));
    }
    folder.set_len(0)?;
    // Each connection needs a file descriptor. The limit is raised to the maximum that the system
    // grants; if it grants no more, the longest silent connections are closed.
    if let Err(error) = getrlimit(Resource::RLIMIT_NOFILE)
        .and_then(|(_, most)| setrlimit(Resource::RLIMIT_NOFILE, most, most))
    {
        tracing::warn!("the limit of open files stays as it is: {error}");
    }
    // Requests, and the stop among them, do not wait for one that computes.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .thread_stack_size(Clock::STACK_BYTES)
        .enable_all()
        .build()?;
    let outcome = runtime.block_on(until_stopped(settings, folder));
    runtime.shutdown_background();
    outcome
}

/// Work that may wait for a disk, on a thread and a runtime of its own: it holds up neither the listener
/// nor a stop, and it ends with the process.
fn beside(
    name: &str,
    server: &Arc<Server>,
    work: impl AsyncFnOnce(Arc<Server>) + Send + 'static,
) -> Result<(), Failure> {
    let server = server.clone();
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()?;
    std::thread::Builder::new()
        .name(name.to_owned())
        .stack_size(Clock::STACK_BYTES)
        .spawn(move || runtime.block_on(work(server)))?;
    Ok(())
}

/// Serves. `lock` is the locked file of the data folder; it states who serves it.
async fn until_stopped(settings: Settings, mut lock: std::fs::File) -> Result<(), Failure> {
    let mut stop = StopSignals::install()?;
    let telemetry = otlp::start(&settings);
    let server = Arc::new(Server::open(settings, &telemetry)?);
    #[cfg(feature = "otlp")]
    let telemetry = otlp::measure(telemetry, &server);
    let notify = systemd::Notify::from_environment();
    let listener = http::Listener::bind(&server).await?;
    let supervisor = supervisor::start(&server)?;
    beside("health", &server, async |server| {
        server.health.work(&server.clock).await;
    })?;
    beside("catalog", &server, async |server| {
        server.catalog.work(|| server.hub.tell("catalog", &()));
    })?;
    beside("analyst", &server, analyst::work)?;
    beside("investigator", &server, investigator::work)?;
    beside("notices", &server, notify::work)?;
    beside("idle benches", &server, outputs::read_idle_benches)?;
    if let Err(error) = writeln!(lock, "process {} at {}", std::process::id(), listener.url()) {
        tracing::warn!("the data folder does not state who serves it: {error}");
    }
    say!("listening on {}", listener.url());
    notify.say("READY=1");
    let refresh = async {
        let mut seen = 0;
        while let Some(every_s) = notify.watchdog_s {
            server.clock.sleep_s(every_s).await;
            // A supervisor that no longer polls is not alive.
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
    server.analyses.end();
    server.catalog.end();
    server.health.end();
    notify.say("STOPPING=1");
    tracing::info!("stopping; runs in work go on by themselves");
    server.hub.close();
    supervisor.end();
    telemetry.end();
    Ok(())
}
