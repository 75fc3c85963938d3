//! Values of the API, which `--json` of the command line prints too.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    client::Outcome,
    job::{JobState, Needs},
    view::{BenchView, FleetView, JobCounts, JobPage, JobView},
};

/// The fleet as it is now.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetNow {
    /// Its name.
    fleet: String,
    /// The NATS server answers. Without it benches continue their jobs, and take no other.
    connected: bool,
    /// Address of the NATS server.
    server: String,
    /// Time of the latest change of a bench, s since 1970 by the calendar of the NATS server.
    changed_unix_s: f64,
    /// Its benches, also silent ones.
    benches: Vec<FleetBench>,
    /// Numbers of jobs.
    jobs: FleetJobCounts,
    /// Jobs that wait and that no bench of the fleet can take, with the reason.
    stranded: Vec<StrandedJob>,
}

/// A bench of the fleet.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetBench {
    /// Its site.
    site: String,
    /// Its name there.
    bench: String,
    /// `idle`, `running`, `held`, `draining`, `latched`, `asking` or `silent`.
    state: &'static str,
    /// Time since its last message, s.
    silent_s: f64,
    /// The run in work.
    run: Option<String>,
    /// The job that it has.
    job: Option<String>,
    /// Time left of the run, s.
    left_s: Option<f64>,
    /// Its properties.
    capabilities: FleetCapabilities,
    /// Why no run begins on it.
    held: Option<String>,
    /// Every output is known to be off; null if that is unknown, or a run is in work.
    outputs_verified: Option<bool>,
}

/// Properties of a bench.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetCapabilities {
    /// Greatest current that its instruments can drive, A.
    current_a: f64,
    /// Least and greatest temperature that its bath can hold, °C; null without a bath.
    #[serde(rename = "temperature_c")]
    temperature_degc: Option<[f64; 2]>,
    /// Fixtures that its jig can take.
    fixtures: Vec<String>,
    /// Every instrument is simulated.
    simulated: bool,
}

/// Numbers of jobs by state.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetJobCounts {
    queued: usize,
    claimed: usize,
    started: usize,
    done: usize,
    failed: usize,
    cancelled: usize,
    lost: usize,
}

/// A job that no bench can take.
#[derive(Debug, Serialize, ToSchema)]
pub struct StrandedJob {
    /// The job.
    job: String,
    /// Why the benches do not take it.
    why: String,
}

/// Requirements of a job on its bench.
#[derive(Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FleetNeeds {
    /// Greatest current that the bench must be able to drive, A.
    current_a: Option<f64>,
    /// Temperature that the bench must be able to hold, °C.
    #[serde(rename = "temperature_c")]
    temperature_degc: Option<f64>,
    /// Fixture that the jig must be able to take: `cell`, `shunt`, `fake_cell` or `short`.
    fixture: Option<String>,
    /// This bench and no other.
    bench: Option<String>,
    /// A bench of this site.
    site: Option<String>,
    /// A simulated bench, or a real one.
    simulated: Option<bool>,
}

/// A job.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetJob {
    /// Its name.
    job: String,
    /// Name of the experiment.
    name: String,
    /// `queued`, `claimed`, `started`, `lost`, `done`, `failed` or `cancelled`.
    state: &'static str,
    /// Its requirements.
    needs: FleetNeeds,
    /// The bench that has the job, or had it last: `SITE/BENCH`.
    bench: Option<String>,
    /// Its run, once there may be one.
    run: Option<String>,
    /// SHA-256 of the run's list of hashes, by which a catalogue names it, once the run has ended.
    content_sha256: Option<String>,
    /// When it was submitted, s since 1970.
    submitted_unix_s: f64,
    /// Who submitted it.
    by: String,
    /// Its campaign.
    campaign: Option<String>,
    /// Label of its cell.
    cell: Option<String>,
    /// Number of times that it was put into the queue.
    turn: u32,
    /// Remarks on it, in words.
    words: String,
}

/// A page of jobs.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetJobs {
    /// In the order of the queue.
    pub jobs: Vec<FleetJob>,
    /// Last job of the page, for the request of the next one; null at the end.
    pub after: Option<String>,
}

/// Result of an order to a bench.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetOutcome {
    /// Its site.
    pub site: String,
    /// The bench.
    pub bench: String,
    /// The NATS server keeps the order: a bench that is cut off follows it once it is back.
    pub kept: bool,
    /// The bench has answered.
    pub heard: bool,
    /// Why no run begins on it now.
    pub held: Option<String>,
    /// Every output is known to be off; null if the bench did not answer.
    pub outputs_verified: Option<bool>,
    /// Remarks on it, in words.
    pub words: String,
    /// Report of a stop, as `POST /benches/B/stop` of its own server answers.
    pub report: Option<serde_json::Value>,
}

impl From<BenchView> for FleetBench {
    fn from(view: BenchView) -> Self {
        let can = &view.capabilities;
        Self {
            state: view.state_name(),
            capabilities: FleetCapabilities {
                current_a: can.current_a,
                temperature_degc: can.temperature_degc,
                fixtures: can.fixtures.clone(),
                simulated: can.simulated,
            },
            site: view.place.site,
            bench: view.place.bench,
            silent_s: view.silent_s,
            run: view.run,
            job: view.job,
            left_s: view.left_s,
            held: view.held,
            outputs_verified: view.verified,
        }
    }
}

impl FleetNow {
    /// Converts the view of the fleet on a NATS server.
    pub fn of(view: FleetView, server: String) -> Self {
        let stranded = view.stranded.into_iter();
        Self {
            fleet: view.fleet,
            connected: view.connected,
            server,
            changed_unix_s: view.changed_unix_s,
            jobs: (&view.jobs).into(),
            benches: view.benches.into_iter().map(Into::into).collect(),
            stranded: stranded
                .map(|(job, why)| StrandedJob { job, why })
                .collect(),
        }
    }
}

impl From<&JobCounts> for FleetJobCounts {
    fn from(counts: &JobCounts) -> Self {
        Self {
            queued: counts.of(JobState::Queued),
            claimed: counts.of(JobState::Claimed),
            started: counts.of(JobState::Started),
            done: counts.of(JobState::Done),
            failed: counts.of(JobState::Failed),
            cancelled: counts.of(JobState::Cancelled),
            lost: counts.lost,
        }
    }
}

impl From<JobView> for FleetJob {
    fn from(view: JobView) -> Self {
        let (state, run) = (view.state_name(), view.job.run());
        let job = view.job;
        Self {
            state,
            run,
            bench: job.holder.map(|holder| holder.place.to_string()),
            job: job.job,
            name: job.name,
            needs: job.needs.into(),
            content_sha256: job.content_sha256,
            submitted_unix_s: job.asked.unix_s,
            by: job.asked.by,
            campaign: job.campaign,
            cell: job.cell,
            turn: job.turn,
            words: job.words,
        }
    }
}

impl From<JobPage> for FleetJobs {
    fn from(page: JobPage) -> Self {
        Self {
            jobs: page.jobs.into_iter().map(Into::into).collect(),
            after: page.after,
        }
    }
}

impl From<Needs> for FleetNeeds {
    fn from(needs: Needs) -> Self {
        Self {
            current_a: needs.current_a,
            temperature_degc: needs.temperature_degc,
            fixture: needs.fixture,
            bench: needs.bench,
            site: needs.site,
            simulated: needs.simulated,
        }
    }
}

impl From<FleetNeeds> for Needs {
    fn from(needs: FleetNeeds) -> Self {
        Self {
            current_a: needs.current_a,
            temperature_degc: needs.temperature_degc,
            fixture: needs.fixture,
            bench: needs.bench,
            site: needs.site,
            simulated: needs.simulated,
        }
    }
}

impl From<Outcome> for FleetOutcome {
    fn from(outcome: Outcome) -> Self {
        Self {
            site: outcome.site,
            bench: outcome.bench,
            kept: outcome.kept,
            heard: outcome.heard,
            held: outcome.held,
            outputs_verified: outcome.verified,
            words: outcome.words,
            report: outcome.report,
        }
    }
}

/// Returns the name of an experiment by its text.
///
/// # Errors
/// The text is not TOML, or names no experiment.
pub fn name_of(text: &str) -> Result<String, String> {
    #[derive(Deserialize)]
    struct Named {
        name: String,
    }
    let named: Result<Named, _> = toml::from_str(text);
    named
        .map(|named| named.name)
        .map_err(|error| error.message().to_owned())
}
