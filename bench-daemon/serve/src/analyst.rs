//! Runs the analyses that users have requested. Each is a command of this program in a separate
//! process. They run one after the other, so that neither the server nor a run waits for them.

use std::{
    fs::File, os::unix::fs::OpenOptionsExt, path::Path, process::Stdio, sync::Arc, time::Duration,
};

use instruments::clock;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use tokio::process::Command;

use super::{
    Server,
    analyses::{Analysis, OUTPUT, Progress, State},
};
use bench_core::{
    operator::progress::{PROGRESS_LINE, PROGRESS_VARIABLE},
    safety::failure::INVALID_CODE,
};
use bench_plan::support::confined_path::tail;

/// Interval between two reads of a process's output, s.
const LOOK_S: f64 = 0.5;
/// Time that a process has to end when it is cancelled.
const PATIENCE: Duration = Duration::from_secs(3);

/// Does one analysis after the other, for ever.
pub async fn work(server: Arc<Server>) {
    loop {
        match server.analyses.next(&server.hub) {
            Some(analysis) => one(&server, &analysis).await,
            None => server.analyses.more.notified().await,
        }
    }
}

async fn one(server: &Server, analysis: &Analysis) {
    let analyses = &server.analyses;
    let outcome = process(server, analysis).await;
    analyses.change(&server.hub, &analysis.id, |one| {
        one.left_s = None;
        if one.state != State::InWork {
            return;
        }
        one.ended_unix_s = Some(clock::unix_time_s());
        (one.state, one.message) = match outcome {
            Ok(message) => (State::Done, message),
            Err(message) => (State::Failed, Some(message)),
        };
        if one.state == State::Done {
            one.progress.done = Some(1.0);
        }
    });
    server.catalog.refresh_analysis(&analysis.id);
}

/// Runs the process; gives a remark on its results.
async fn process(server: &Server, analysis: &Analysis) -> Result<Option<String>, String> {
    let failed = |error: &dyn std::fmt::Display| error.to_string();
    let folder = server.analyses.folder.join(&analysis.id);
    let arguments = server.analyses.arguments(&analysis.id)?;
    let log = File::options()
        .create(true)
        .append(true)
        .mode(0o640)
        .open(folder.join(OUTPUT))
        .map_err(|error| failed(&error))?;
    let errors = log.try_clone().map_err(|error| failed(&error))?;
    // The cores are the runs' first.
    let threads = std::thread::available_parallelism().map_or(1, |cores| cores.get().div_ceil(2));
    let mut child = Command::new("nice")
        .arg("-n10")
        .arg(&server.program)
        .args(&arguments)
        .current_dir(&folder)
        .stdin(Stdio::null())
        .stdout(log)
        .stderr(errors)
        .process_group(0)
        .kill_on_drop(true)
        .env("RAYON_NUM_THREADS", threads.to_string())
        .env("POLARS_MAX_THREADS", threads.to_string())
        .env(PROGRESS_VARIABLE, "lines")
        .env_remove("NOTIFY_SOCKET")
        .env_remove("WATCHDOG_USEC")
        .spawn()
        .map_err(|error| failed(&error))?;
    let analyses = &server.analyses;
    let pid = child
        .id()
        .and_then(|id| i32::try_from(id).ok())
        .unwrap_or(0);
    let group = Pid::from_raw(-pid);
    analyses.change(&server.hub, &analysis.id, |one| one.pid = Some(pid));
    let mut is_ending = false;
    let status = loop {
        // A wake-up that was meant for an earlier analysis has no effect.
        if !is_ending && !analyses.is_in_work(&analysis.id) {
            is_ending = true;
            let _ = kill(group, Signal::SIGTERM);
            if server.clock.deadline(PATIENCE, child.wait()).await.is_err() {
                let _ = kill(group, Signal::SIGKILL);
            }
        }
        tokio::select! {
            status = child.wait() => break status.map_err(|error| failed(&error))?,
            () = analyses.cancel.notified() => {}
            () = server.clock.sleep_s(LOOK_S) => look(server, analysis, &folder),
        }
    };
    look(server, analysis, &folder);
    let text = tail(&folder, OUTPUT);
    let last = text
        .lines()
        .rev()
        .find_map(|line| line.strip_prefix("eis-bench: "));
    match status.code() {
        Some(0) => Ok(None),
        // Data that cannot be diagnosed are a result.
        Some(code) if code == i32::from(INVALID_CODE) => Ok(last.map(str::to_owned)),
        _ => Err(last.map_or_else(|| format!("its process ended with {status}"), str::to_owned)),
    }
}

/// Reads the progress of a process and publishes it if it has changed.
fn look(server: &Server, analysis: &Analysis, folder: &Path) {
    let text = tail(folder, OUTPUT);
    let Some(words) = text
        .lines()
        .rev()
        .find_map(|line| line.strip_prefix(PROGRESS_LINE))
    else {
        return;
    };
    let known = server.analyses.lock().iter().any(|one| {
        one.id == analysis.id && one.progress.words == words && one.state == State::InWork
    });
    if known {
        return;
    }
    let elapsed_s = clock::unix_time_s() - analysis.began_unix_s.unwrap_or_else(clock::unix_time_s);
    server.analyses.change(&server.hub, &analysis.id, |one| {
        let done = share(words);
        one.left_s = done
            .filter(|done| *done > 0.0)
            .map(|done| elapsed_s * (1.0 - done) / done);
        one.progress = Progress {
            done,
            words: words.to_owned(),
        };
    });
}

/// Parses the completed fraction from a text such as `searches: 3 of 12`.
fn share(words: &str) -> Option<f64> {
    let (before, after) = words.rsplit_once(" of ")?;
    let done: f64 = before.rsplit(' ').next()?.parse().ok()?;
    let of: f64 = after.split(' ').next()?.parse().ok()?;
    (of > 0.0 && done <= of).then(|| done / of)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_read_where_the_words_count() {
        assert_eq!(share("searches: 3 of 12"), Some(0.25));
        assert_eq!(share("demo, 4 RC: 12 of 12 starts"), Some(1.0));
        assert_eq!(share("the ranking of effects"), None);
        assert_eq!(share("13 of 12"), None);
    }
}
