//! Prints a fleet as text and as JSON.

use serde::Serialize;

use crate::{
    api::{FleetJob, FleetJobs, FleetNow},
    client::Outcome,
    job::JobState,
    terminal::say,
    view::{BenchView, FleetView, JobPage, JobView},
};

/// Prints the present state of the fleet: benches, numbers of jobs, and the requested jobs.
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

/// Returns the state of the fleet as JSON: `GET /api/v1/fleet`, together with the jobs of `GET
/// /api/v1/fleet/jobs`.
#[derive(Debug, Serialize)]
pub(super) struct Status {
    #[serde(flatten)]
    now: FleetNow,
    listed: Vec<FleetJob>,
    after: Option<String>,
}

impl Status {
    /// Returns the header of a fleet on this NATS server.
    pub(super) fn of(view: FleetView, page: JobPage, server: String) -> Self {
        let FleetJobs { jobs, after } = page.into();
        Self {
            now: FleetNow::of(view, server),
            listed: jobs,
            after,
        }
    }
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
