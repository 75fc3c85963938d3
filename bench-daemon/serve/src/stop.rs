//! Stop of a bench: ends its run now, and reads the outputs back. First the run is asked to end in
//! safe state, as by Ctrl-C. Then `eis-bench safe` switches off over its own connections and reads
//! back, whether the run has ended or not.

use std::{path::PathBuf, process::Stdio, sync::Arc, time::Duration};

use analysis::run_folder::JOURNAL;
use instruments::clock;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};

use super::{
    Server,
    live::{OutputRead, StopReport},
    queue::HeldBy,
};
use bench_core::{
    bench::SafeReport,
    operator::run_control::{RunAction, RunControl},
    safety::state::{Holder, State},
};
use bench_plan::{config, support::locks};

/// Time limit for `eis-bench safe`, which tries each instrument several times.
const SAFE: Duration = Duration::from_secs(90);
/// A run that was starting when the stop came is ended in a second turn; no run begins after the
/// first.
const TURNS: usize = 3;
/// Interval between two checks whether the run has ended, s.
const LOOK_S: f64 = 0.1;

/// The author of a stop.
#[derive(Debug, Clone, Copy)]
pub struct Stopper<'a> {
    /// The side that holds the bench after the stop.
    pub held_by: HeldBy,
    /// Name.
    pub name: &'a str,
}

/// Stops a bench. Requests that arrive while it is being stopped share the outcome.
pub async fn stop(server: &Arc<Server>, bench: &config::Bench, by: Stopper<'_>) -> StopReport {
    let mut report = StopReport {
        bench: bench.name.clone(),
        by: by.name.to_owned(),
        held_by: by.held_by,
        unix_s: clock::unix_time_s(),
        ..StopReport::default()
    };
    let joined = {
        let mut stops = server.stops();
        let under_way = stops.get(&bench.name).is_some_and(|stop| !stop.over);
        if !under_way {
            stops.insert(bench.name.clone(), report.clone());
        }
        under_way
    };
    if joined {
        // Each side must take back its own.
        hold(server, report.held_by, &report);
        return outcome(server, &bench.name).await;
    }
    server.hub.tell("stop", &report);
    // No run begins until the stop is over, whatever the disk does; after that, the hold prevents
    // it.
    let mut gone = end_run(server, bench, &mut report).await;
    hold(server, report.held_by, &report);
    switch_off(server, bench, gone, &mut report).await;
    for _ in 1..TURNS {
        if !gone || in_work(server, bench).is_none() {
            break;
        }
        gone = again(server, bench, &mut report).await;
    }
    if report.verified && in_work(server, bench).is_some() {
        report.verified = false;
        report
            .steps
            .push("a process runs the bench again: LOOK AT THE BENCH".to_owned());
    }
    report.over = true;
    server.stops().insert(bench.name.clone(), report.clone());
    server.hub.tell("stop", &report);
    server.tell_queue();
    report
}

/// Ends a run that started while the outputs were switched off. Returns whether no run is active
/// any more.
async fn again(server: &Arc<Server>, bench: &config::Bench, report: &mut StopReport) -> bool {
    report.verified = false;
    report.outputs.clear();
    report.message.clear();
    report.read.clear();
    report.read_unix_s = None;
    tell(
        server,
        report,
        "a run was being begun when the stop came: once more".to_owned(),
    );
    let gone = end_run(server, bench, report).await;
    switch_off(server, bench, gone, report).await;
    gone
}

/// Holds a bench after its stop, for one side.
pub fn hold(server: &Server, by: HeldBy, report: &StopReport) {
    let held = server.queue().hold(by, &report.bench, &report.held());
    if let Err(error) = held {
        tracing::error!("{error}");
    }
}

async fn outcome(server: &Arc<Server>, bench: &str) -> StopReport {
    loop {
        if let Some(report) = server.stops().get(bench).filter(|stop| stop.over) {
            return report.clone();
        }
        server.clock.sleep_s(LOOK_S).await;
    }
}

fn tell(server: &Server, report: &mut StopReport, step: String) {
    report.steps.push(step);
    server.stops().insert(report.bench.clone(), report.clone());
    server.hub.tell("stop", report);
}

/// Asks the run to end and waits for it. Returns whether no run is active any more.
async fn end_run(server: &Server, bench: &config::Bench, report: &mut StopReport) -> bool {
    let Some((pid, folder)) = in_work(server, bench) else {
        tell(server, report, "no run was in work".to_owned());
        return true;
    };
    // Before anything is written: a disk that hangs must not hold up the signal.
    let asked = kill(Pid::from_raw(pid), Signal::SIGTERM);
    if let Err(error) = (RunControl {
        action: RunAction::Abort,
        ..RunControl::read(&folder)
    })
    .write(&folder)
    {
        tracing::error!("{error}");
    }
    tell(
        server,
        report,
        match asked {
            Ok(()) => format!("process {pid} was asked to end in safe state"),
            Err(error) => format!("process {pid} cannot be asked to end: {error}"),
        },
    );
    let until_s = server.clock.now_s() + server.settings.stop_wait_s;
    while server.clock.now_s() < until_s {
        if in_work(server, bench).is_none() {
            tell(server, report, format!("process {pid} has ended"));
            return true;
        }
        server.clock.sleep_s(LOOK_S).await;
    }
    let wait_s = server.settings.stop_wait_s;
    if bench.in_process() {
        // No output outside the process could stay on.
        let _ = kill(Pid::from_raw(pid), Signal::SIGKILL);
    }
    tell(
        server,
        report,
        format!(
            "process {pid} has not ended within {wait_s} s: it is killed, and the bench is \
            switched off beside it"
        ),
    );
    false
}

/// Returns the process that runs the bench, and its run folder. Never returns 0 or 1, because a
/// signal to these would reach whole groups.
fn in_work(server: &Server, bench: &config::Bench) -> Option<(i32, PathBuf)> {
    let holder = || {
        let state = State::of(bench).ok().flatten()?;
        let pid = locks::holder(&state.path("lock"))?;
        let known: Option<Holder> = std::fs::read_to_string(state.path("lock"))
            .ok()
            .and_then(|text| serde_json::from_str(&text).ok());
        Some((pid, known.map(|holder| holder.run).unwrap_or_default()))
    };
    let ours = || {
        let item = server.queue().in_work(&bench.name)?.clone();
        let folder = server.runs().join(&item.run);
        let pid = locks::holder(&folder.join(JOURNAL))
            .or_else(|| item.process.map(|process| process.pid))?;
        // A process that has ended waits as a zombie until the supervisor has taken note of it.
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
        (!stat.rsplit(')').next()?.trim_start().starts_with('Z')).then_some((pid, folder))
    };
    holder().or_else(ours).filter(|(pid, _)| *pid > 1)
}

/// Switches off and reads back, over connections of its own.
async fn switch_off(server: &Server, bench: &config::Bench, gone: bool, report: &mut StopReport) {
    let mut command = tokio::process::Command::new(&server.program);
    command
        .args(["safe", "--json", "--by", "stop"])
        .arg(&bench.path)
        .stdin(Stdio::null())
        .kill_on_drop(true)
        .env_remove("NOTIFY_SOCKET");
    if !gone {
        command.arg("--kill");
    }
    let output = match server.clock.deadline(SAFE, command.output()).await {
        Ok(Ok(output)) => output,
        Ok(Err(error)) => {
            return tell(
                server,
                report,
                format!("`eis-bench safe` cannot be started: {error}: LOOK AT THE BENCH"),
            );
        }
        Err(_) => {
            return tell(
                server,
                report,
                "`eis-bench safe` did not come to an end: LOOK AT THE BENCH".to_owned(),
            );
        }
    };
    let wording = String::from_utf8_lossy(&output.stdout).into_owned();
    if bench.in_process() {
        report.simulated = output.status.success() && in_work(server, bench).is_none();
        let ended = "nothing of this bench is outside the run's process, and none runs: no output \
        was read back";
        return tell(
            server,
            report,
            if report.simulated {
                ended
            } else {
                "the run's process has not ended"
            }
            .to_owned(),
        );
    }
    // The last report counts: there are two if the run ended late.
    let printed = wording
        .lines()
        .rev()
        .find_map(|line| serde_json::from_str::<SafeReport>(line).ok());
    let words = printed
        .as_ref()
        .filter(|printed| !printed.verified)
        .map(|printed| format!("LOOK AT THE BENCH: {}", printed.message));
    if let Some(printed) = &printed {
        report.message.clone_from(&printed.message);
        report.read.clone_from(&printed.read);
        report.read_unix_s = printed.read_unix_s;
        report.outputs = printed.outputs.iter().map(OutputRead::from).collect();
    }
    report.verified = output.status.success()
        && printed.is_some_and(|printed| printed.verified && !printed.outputs.is_empty());
    let last = String::from_utf8_lossy(&output.stderr)
        .lines()
        .last()
        .unwrap_or_default()
        .to_owned();
    tell(
        server,
        report,
        if report.verified {
            report.read.clone()
        } else {
            words.unwrap_or(last)
        },
    );
}
