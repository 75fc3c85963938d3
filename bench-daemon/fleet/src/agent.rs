//! An agent beside a server of benches: it speaks the HTTP API of the server on one side, and NATS
//! on the other side, and serves the page and the API of the fleet.
//!
//! In reading order: `server` (calls to the server), `follow` (its state), `bench` (a bench of it in
//! the fleet), `app`, `caller`, `guard`, `routes`, `stops`, `listener`.

mod app;
mod bench;
mod caller;
mod follow;
mod forward;
mod guard;
mod listener;
mod metrics;
mod openapi;
mod page;
mod pass;
mod refusal;
mod router;
mod routes;
mod server;
mod stops;

use std::{fs::File, path::Path, sync::Arc, time::Duration};

use axum::http::StatusCode;
use instruments_link::clock::{Clock, TimeMode};
use tokio::signal::unix::{SignalKind, signal};

use crate::{
    config::{AgentFile, check_name},
    failure::Failure,
    fleet::{Fleet, Joining},
    local::LocalBench,
    terminal::say,
};
use app::{App, AppState, Joined};
use bench::ServedBench;
use caller::Whoami;
use follow::Follower;
use listener::Listener;
use server::{BenchServer, Call, CallError};

/// Interval between two attempts to reach the server, s.
const RETRY_S: f64 = 2.0;
/// Time that an agent waits for the broker before it exits.
const LEAVE: Duration = Duration::from_secs(2);
/// Scopes that the token of an agent must have.
const SCOPES: [&str; 4] = ["read", "operate", "energise", "fleet"];

/// Runs an agent until a signal requests a stop. Runs of the benches continue.
///
/// # Errors
/// The file is invalid, or an address, a certificate, a token or a data folder cannot be used.
pub fn run(path: &Path) -> Result<(), Failure> {
    let file = AgentFile::load(path)?;
    std::fs::create_dir_all(&file.data)?;
    let lock = File::options()
        .create(true)
        .append(true)
        .open(file.data.join("lock"))?;
    if lock.try_lock().is_err() {
        let data = file.data.display();
        return Err(Failure::Usage(format!(
            "{data}: expected a data folder of its own, found one that another agent uses"
        )));
    }
    // A shutdown does not wait for a request that computes.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let outcome = runtime.block_on(until_stopped(&file));
    runtime.shutdown_background();
    outcome
}

async fn until_stopped(file: &AgentFile) -> Result<(), Failure> {
    let mut interrupt = signal(SignalKind::interrupt())?;
    let mut terminate = signal(SignalKind::terminate())?;
    let server = Arc::new(BenchServer::open(&file.bench_server)?);
    let clock = Clock::start(TimeMode::Real);
    let is_local = file.listen.ip().is_loopback();
    let app = AppState::new(server, file.settings.clone(), clock.clone(), is_local);
    let listener = Listener::bind(file).await?;
    let router = router::router(&app);
    say!("listening on {}", listener.url());
    let outcome = tokio::select! {
        () = listener.accept(&router, &clock) => Ok(()),
        Err(failure) = work(&app, file) => Err(failure),
        _ = interrupt.recv() => Ok(()),
        _ = terminate.recv() => Ok(()),
    };
    // Signs off. Runs continue, and jobs stay with their benches.
    if let Some(joined) = app.joined.get() {
        let _ = clock.deadline(LEAVE, joined.fleet.end()).await;
    }
    outcome
}

/// Joins the fleet once the server answers, and then follows the server until the agent ends.
///
/// # Errors
/// The server refuses the token, or the names of its benches cannot be used in a fleet.
async fn work(app: &App, file: &AgentFile) -> Result<(), Failure> {
    let known = reach(app).await?;
    for bench in &known.benches {
        check_name(bench).map_err(Failure::Usage)?;
    }
    let follower = Follower::of(&app.server, &app.clock);
    let bench = |name: &String| -> Arc<dyn LocalBench> {
        Arc::new(ServedBench::new(name, &app.server, &follower))
    };
    let fleet = Fleet::join(Joining {
        settings: file.settings.clone(),
        folder: file.data.clone(),
        benches: known.benches.iter().map(bench).collect(),
    });
    let _ = app.joined.set(Joined {
        fleet,
        benches: known.benches,
    });
    follower.follow().await;
    Ok(())
}

/// Waits until the server answers, and returns the benches that the token of the agent may access.
///
/// # Errors
/// The server refuses the token, or the token lacks scopes.
async fn reach(app: &App) -> Result<Whoami, Failure> {
    let mut reported = String::new();
    loop {
        let server = app.server.clone();
        let asked = tokio::task::spawn_blocking(move || server.call(Call::get("/whoami"))).await;
        match asked.map_err(std::io::Error::other)? {
            Ok(known) => return has_scopes(known),
            Err(CallError::Refused(refusal))
                if [StatusCode::UNAUTHORIZED, StatusCode::FORBIDDEN].contains(&refusal.status) =>
            {
                let (url, message) = (app.server.url(), refusal.message);
                return Err(Failure::Usage(format!(
                    "token_file: the server {url} refuses the token: {message}"
                )));
            }
            Err(error) => {
                let words = error.into_away().to_string();
                if words != reported {
                    tracing::warn!("{words}; it is tried again");
                    reported = words;
                }
            }
        }
        app.clock.sleep_s(RETRY_S).await;
    }
}

fn has_scopes(known: Whoami) -> Result<Whoami, Failure> {
    let lacks = SCOPES
        .iter()
        .filter(|scope| !known.scopes.iter().any(|one| one == *scope));
    let lacks: Vec<&str> = lacks.copied().collect();
    if lacks.is_empty() {
        return Ok(known);
    }
    let (name, lacks, all) = (&known.name, lacks.join(", "), SCOPES.join(","));
    Err(Failure::Usage(format!(
        "token_file: expected a token with the scopes {all}, found {name:?} without {lacks}; \
        `eis-bench token add SERVER.toml NAME --scope {all}` makes one"
    )))
}
