//! Sends runs to the archive with processes of this program. `eis-bench archive push` runs after
//! the end of each run and analysis, and at the start and every hour for runs that are not
//! archived yet. While the store is unreachable, it is retried after increasing pauses.

use std::{process::Stdio, sync::Arc};

use instruments::clock;
use tokio::process::Command;

use super::{Server, archive::Wanted};
use crate::support::chance::chance;

/// Pauses before a push is begun again, the first and the longest, s. Each is twice the one before.
const PAUSES_S: [f64; 2] = [2.0, 300.0];
/// Interval between two checks for captures that are due to be moved, s.
const THIN_S: f64 = 6.0 * 3600.0;
/// Interval without a push after which all runs are checked again, s. A run that another process
/// held when it was due sends no notification when it becomes free.
const LOOK_AGAIN_S: f64 = 3600.0;
/// Interval between two reads of the receipts while runs are sent, s.
const LOOK_S: f64 = 30.0;
/// Exit code of a push that has done its work and found runs that do not go into the store as they are.
const REFUSED_CODE: i32 = 10;

/// Sends runs that are not in the store yet, and then every run that ends, forever. Returns at
/// once if no archive is configured.
pub async fn work(server: Arc<Server>) {
    let Some(archive) = &server.settings.archive else {
        return;
    };
    let (keeper, clock) = (&server.archive, &server.clock);
    keeper.wanted().all = true;
    let (mut pause_s, mut thinned_s) = (PAUSES_S[0], None);
    loop {
        let wanted = std::mem::take(&mut *keeper.wanted());
        if !wanted.is_empty() {
            if let Err(trouble) = push(&server, wanted).await {
                let wait_s = pause_s * (0.5 + chance());
                keeper.wanted().all = true;
                tracing::warn!("the archive is not up to date, again in {wait_s:.0} s: {trouble}");
                keeper.now().trouble = Some(trouble);
                keeper.now().again_unix_s = Some(clock::unix_time_s() + wait_s);
                clock.sleep_s(wait_s).await;
                pause_s = (2.0 * pause_s).min(PAUSES_S[1]);
                continue;
            }
            pause_s = PAUSES_S[0];
        }
        let due = thinned_s.is_none_or(|thinned_s| clock.now_s() - thinned_s >= THIN_S);
        if archive.captures_after_s.is_some() && due {
            thinned_s = Some(clock.now_s());
            let thinned = process(&server, "thin", &[]).await;
            if let Err(trouble) = thinned {
                tracing::warn!("captures stay where they are: {trouble}");
            }
            keeper.look(&server.settings);
        }
        tokio::select! {
            () = keeper.more.notified() => {}
            () = clock.sleep_s(LOOK_AGAIN_S) => keeper.wanted().all = true,
        }
    }
}

async fn push(server: &Server, wanted: Wanted) -> Result<(), String> {
    let keeper = &server.archive;
    keeper.now().in_work = true;
    keeper.look(&server.settings);
    let arguments = wanted.arguments();
    let mut pushing = std::pin::pin!(process(server, "push", &arguments));
    let pushed = loop {
        tokio::select! {
            pushed = &mut pushing => break pushed,
            () = server.clock.sleep_s(LOOK_S) => keeper.look(&server.settings),
        }
    };
    keeper.now().in_work = false;
    keeper.now().trouble = None;
    keeper.now().again_unix_s = None;
    keeper.look(&server.settings);
    pushed
}

/// Runs `eis-bench archive` on the file of the server, with low priority: the cores are the runs' first.
async fn process(server: &Server, act: &str, runs: &[String]) -> Result<(), String> {
    let failed = |error: std::io::Error| error.to_string();
    let output = Command::new("nice")
        .arg("-n10")
        .arg(&server.program)
        .args(["archive", act])
        .arg(&server.settings.file)
        .args(runs)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .process_group(0)
        .env("POLARS_MAX_THREADS", "1")
        .env_remove("NOTIFY_SOCKET")
        .env_remove("WATCHDOG_USEC")
        .output()
        .await
        .map_err(failed)?;
    let text = String::from_utf8_lossy(&output.stderr);
    let mut last = text.lines().rev();
    let last = last.find_map(|line| line.strip_prefix("eis-bench: "));
    match output.status.code() {
        // The receipt of a refused run records the reason. The run is not sent again before it
        // changes.
        Some(0 | REFUSED_CODE) => Ok(()),
        _ => Err(last.map_or_else(
            || format!("its process ended with {}", output.status),
            str::to_owned,
        )),
    }
}
