//! Reads the outputs of an idle bench, on request or at an interval that the server's file names.
//! A separate process (`eis-bench outputs`) queries the instruments, so that an instrument that
//! hangs blocks nothing else. A run or a stop ends that process.

use std::{process::Stdio, sync::Arc, time::Duration};

use serde::de::DeserializeOwned;

use super::Server;
use bench_core::{bench::outputs::OutputsState, safety::failure::BUSY_CODE};
use bench_plan::{config, support::quoted::quoted};

/// Time limit for the answers of all instruments of a bench.
const ANSWERS: Duration = Duration::from_secs(60);

/// Why the instruments were not queried.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The request conflicts with the current state.
    #[error("{0}")]
    Busy(String),
    /// The machine.
    #[error("the instruments were not queried: {0}")]
    Machine(String),
}

/// Returns the command that switches a bench off on the server's machine, for use in a shell in
/// any folder.
pub fn safe_command(bench: &config::Bench) -> String {
    let whole = std::fs::canonicalize(&bench.path).unwrap_or_else(|_| bench.path.clone());
    format!("eis-bench safe {}", quoted(&whole))
}

/// Queries the state of every instrument that can move charge; changes nothing on any of them.
///
/// # Errors
/// [`ReadError::Busy`] while a run or a stop is at work on the bench.
pub async fn read(server: &Server, bench: &config::Bench) -> Result<OutputsState, ReadError> {
    if bench.in_process() {
        let why = "expected a bench with instruments, found one that is simulated within a run";
        return Err(ReadError::Busy(why.to_owned()));
    }
    ask(server, bench, "outputs").await
}

/// Runs a command of the program that queries the instruments of a bench, and returns its JSON.
///
/// # Errors
/// [`ReadError::Busy`] while a run or a stop is at work on the bench, or if one of them has ended
/// the command; a command that prints no result.
pub async fn ask<T: DeserializeOwned>(
    server: &Server,
    bench: &config::Bench,
    what: &str,
) -> Result<T, ReadError> {
    if is_at_work(server, &bench.name) {
        return Err(ReadError::Busy(
            "expected a bench on which nothing runs, found a run or a stop in work: its own \
            readings show the outputs"
                .to_owned(),
        ));
    }
    let mut command = tokio::process::Command::new(&server.program);
    command
        .args([what, "--json"])
        .arg(&bench.path)
        .stdin(Stdio::null())
        .kill_on_drop(true)
        .env_remove("NOTIFY_SOCKET");
    let machine = |error: &dyn std::fmt::Display| ReadError::Machine(error.to_string());
    let output = server
        .clock
        .deadline(ANSWERS, command.output())
        .await
        .map_err(|error| machine(&error))?
        .map_err(|error| machine(&error))?;
    serde_json::from_slice(&output.stdout).map_err(|_| {
        let said = String::from_utf8_lossy(&output.stderr);
        let why = said
            .lines()
            .rev()
            .find_map(|line| line.strip_prefix("eis-bench: "))
            .unwrap_or("a run or a stop has ended the reading")
            .to_owned();
        match output.status.code() {
            // The command was ended because the instruments were needed elsewhere.
            None => ReadError::Busy(why),
            Some(code) if code == i32::from(BUSY_CODE) => ReadError::Busy(why),
            Some(_) => ReadError::Machine(why),
        }
    })
}

fn is_at_work(server: &Server, bench: &str) -> bool {
    let runs = server
        .live()
        .get(bench)
        .is_some_and(|live| live.run.as_ref().is_some_and(|run| run.going));
    runs || server.stops().get(bench).is_some_and(|stop| !stop.over)
}

/// Reads every idle bench at the interval of the server's file, forever. Does nothing without an
/// interval.
pub async fn read_idle_benches(server: Arc<Server>) {
    let Some(every_s) = server.settings.read_idle_s else {
        return;
    };
    let one = async |bench: config::Bench| {
        loop {
            server.clock.sleep_s(every_s).await;
            if let Err(ReadError::Machine(why)) = read(&server, &bench).await {
                tracing::warn!("{}: {why}", bench.name);
            }
        }
    };
    let real = server
        .settings
        .benches
        .iter()
        .filter(|bench| !bench.in_process());
    let all: Vec<_> = real.map(|bench| Box::pin(one(bench.clone()))).collect();
    futures_util::future::join_all(all).await;
}
