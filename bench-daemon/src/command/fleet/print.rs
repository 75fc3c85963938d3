//! A fleet in words and as JSON.

use bench_fleet::{
    BenchView, FleetView, JobState,
    client::Outcome,
    view::{JobPage, JobView},
};
use serde_json::{Value, json};

use crate::support::terminal::say;

/// The fleet as it is now: benches, numbers of jobs, and the jobs that were asked for.
pub(super) fn status(view: &FleetView, page: &JobPage) {
    for bench in &view.benches {
        say!("{}", bench_line(bench));
    }
    if view.benches.is_empty() {
        say!("no bench has signed on");
    }
    let counts = JobState::ALL.map(|state| format!("{} {}", view.jobs.of(state), state.name()));
    say!("jobs: {}, {} lost", counts.join(", "), view.jobs.lost);
    for one in &page.jobs {
        say!("{}", job_line(one));
    }
    for (job, why) in &view.stranded {
        say!("no bench can take {job}: {why}");
    }
    if let Some(after) = &page.after {
        say!("there are more jobs: --after {after}");
    }
}

fn bench_line(bench: &BenchView) -> String {
    let off = match bench.verified {
        Some(true) => "off",
        Some(false) => "NOT VERIFIED OFF",
        None if bench.run.is_some() && bench.state.is_some() => "",
        None => "outputs not known",
    };
    let said = bench.held.as_deref().unwrap_or_default();
    let run = bench.run.as_deref().unwrap_or_default();
    let line = format!(
        "{:<24} {:<9} {off:<18} {run}  {said}",
        bench.place.to_string(),
        bench.state_name()
    );
    line.trim_end().to_owned()
}

fn job_line(view: &JobView) -> String {
    let holder = view.job.holder.as_ref();
    let bench = holder.map_or_else(String::new, |holder| holder.place.to_string());
    let (state, job) = (view.state_name(), &view.job);
    let line = format!(
        "{} {state:<9} {bench:<24} {}  {}",
        job.job, job.name, job.words
    );
    line.trim_end().to_owned()
}

/// The same for programs, as `GET /api/v1/fleet` and `GET /api/v1/fleet/jobs` name it.
pub(super) fn json(view: &FleetView, page: &JobPage) -> Value {
    let counts = JobState::ALL.map(|state| (state.name().to_owned(), json!(view.jobs.of(state))));
    let lost = ("lost".to_owned(), json!(view.jobs.lost));
    let counts: serde_json::Map<String, Value> = counts.into_iter().chain([lost]).collect();
    json!({
        "fleet": view.fleet,
        "connected": view.connected,
        "changed_unix_s": view.changed_unix_s,
        "benches": view.benches.iter().map(bench_json).collect::<Vec<_>>(),
        "jobs": counts,
        "stranded": view.stranded,
        "listed": page.jobs.iter().map(job_json).collect::<Vec<_>>(),
        "after": page.after,
    })
}

fn bench_json(bench: &BenchView) -> Value {
    json!({
        "site": bench.place.site,
        "bench": bench.place.bench,
        "state": bench.state_name(),
        "run": bench.run,
        "job": bench.job,
        "left_s": bench.left_s,
        "capabilities": bench.capabilities,
        "held": bench.held,
        "outputs_verified": bench.verified,
    })
}

fn job_json(view: &JobView) -> Value {
    let job = &view.job;
    let holder = job.holder.as_ref();
    json!({
        "job": job.job,
        "name": job.name,
        "state": view.state_name(),
        "needs": job.needs,
        "bench": holder.map(|holder| holder.place.to_string()),
        "run": job.run(),
        "submitted_unix_s": job.asked.unix_s,
        "by": job.asked.by,
        "campaign": job.campaign,
        "cell": job.cell,
        "turn": job.turn,
        "words": job.words,
    })
}

/// Result of an order.
pub(super) fn outcome(outcome: &Outcome) {
    let off = match outcome.verified {
        Some(true) => "off",
        Some(false) => "NOT VERIFIED OFF",
        None => "outputs not known",
    };
    let held = outcome.held.as_deref().map(|held| format!("; {held}"));
    say!(
        "{}/{}: {}; {off}{}",
        outcome.site,
        outcome.bench,
        outcome.words,
        held.unwrap_or_default()
    );
}
