//! Arguments of the commands to a fleet.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use crate::{
    config::DEFAULT_SERVER,
    job::Needs,
    quantity,
    view::{JobFilter, JobView, MOST_JOBS},
};

/// Which fleet, and how it is reached.
#[derive(Debug, Args)]
pub struct ConnectArgs {
    /// File of an agent.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["fleet", "credentials", "ca"])]
    pub(super) config: Option<PathBuf>,
    /// Name of the fleet, without a file.
    #[arg(long, value_name = "NAME")]
    pub(super) fleet: Option<String>,
    /// Address of the NATS server: tls://HOST:PORT, or nats://HOST:PORT on this machine.
    #[arg(long, value_name = "ADDRESS", default_value = DEFAULT_SERVER)]
    pub(super) server: String,
    /// File, mode 0600, with what the NATS server asks for.
    #[arg(long, value_name = "FILE")]
    pub(super) credentials: Option<PathBuf>,
    /// Certificates that the NATS server's is checked against, PEM.
    #[arg(long, value_name = "FILE")]
    pub(super) ca: Option<PathBuf>,
}

/// Commands to a fleet.
#[derive(Debug, Subcommand)]
pub enum Act {
    /// Show the benches, which of them answer, and the jobs that have not ended.
    Status(StatusArgs),
    /// Put an experiment into the queue; the first free bench that fits takes it.
    Submit(SubmitArgs),
    /// Put the experiments of a campaign over benches into the queue, each for its bench and in its
    /// order, except those that are in the queue already. Needs the program `eis-bench`.
    Campaign {
        /// The file of the campaign; its benches are named SITE/BENCH, or BENCH alone.
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Remove a waiting job, or all waiting jobs of a campaign, from the queue.
    Cancel(CancelArgs),
    /// Revoke a hold, drain or stop of a bench; or put a started job whose bench is gone back into the
    /// queue.
    Release(OrderArgs),
    /// Begin no further run on a bench; an active run continues.
    Hold(OrderArgs),
    /// Let a bench take no further job; its jobs continue.
    Drain(OrderArgs),
    /// Stop a bench, or all benches, now, and print the states that were read back.
    Stop(StopArgs),
    /// Remove ended jobs with their texts, or a bench that is gone, from the records.
    Forget(ForgetArgs),
}

/// Jobs that are cancelled.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct CancelArgs {
    /// The job.
    pub(super) job: Option<String>,
    /// All waiting jobs of this campaign.
    #[arg(long, value_name = "LABEL")]
    pub(super) campaign: Option<String>,
}

/// Records that are removed.
#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
pub struct ForgetArgs {
    /// A bench that has signed off or is silent, SITE/BENCH. Its orders are kept.
    pub(super) bench: Option<String>,
    /// Jobs that ended longer ago than this duration, such as "90 d".
    #[arg(long = "older", value_name = "DURATION", value_parser = quantity::duration_s)]
    pub(super) older_s: Option<f64>,
}

/// Jobs that are listed.
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// List ended jobs too.
    #[arg(long)]
    all: bool,
    /// List jobs in this state.
    #[arg(long, value_name = "STATE", value_parser = JobView::STATES)]
    state: Option<String>,
    /// List jobs of this campaign.
    #[arg(long, value_name = "LABEL")]
    campaign: Option<String>,
    /// List jobs after this one; at most 1000 are listed at once.
    #[arg(long, value_name = "JOB")]
    after: Option<String>,
}

impl StatusArgs {
    pub(super) fn filter(&self) -> JobFilter {
        JobFilter {
            state: self.state.clone(),
            open: !self.all && self.state.is_none(),
            campaign: self.campaign.clone(),
            after: self.after.clone(),
            most: MOST_JOBS,
        }
    }
}

/// Work for the fleet.
#[derive(Debug, Args)]
pub struct SubmitArgs {
    /// The experiment. Files that it names are those of the bench that takes it.
    pub(super) experiment: PathBuf,
    /// Number of jobs.
    #[arg(long, default_value_t = 1)]
    pub(super) count: usize,
    /// Seed of the first job; each further job has the next one.
    #[arg(long)]
    pub(super) seed: Option<u64>,
    /// Label of a campaign.
    #[arg(long, value_name = "LABEL")]
    pub(super) campaign: Option<String>,
    /// Label of the cell.
    #[arg(long, value_name = "LABEL")]
    pub(super) cell: Option<String>,
    /// Greatest current that the bench must be able to drive, A.
    #[arg(long = "current", value_name = "CURRENT", value_parser = quantity::current_a)]
    current_a: Option<f64>,
    /// Temperature that the bench must be able to hold, °C.
    #[arg(
        long = "temperature",
        value_name = "TEMPERATURE",
        allow_negative_numbers = true,
        value_parser = quantity::temperature_degc
    )]
    temperature_degc: Option<f64>,
    /// Fixture that the jig must be able to take: cell, shunt, fake_cell or short.
    #[arg(long, value_name = "FIXTURE")]
    fixture: Option<String>,
    /// This bench and no other, by its name.
    #[arg(long, value_name = "NAME")]
    bench: Option<String>,
    /// A bench of this site.
    #[arg(long, value_name = "NAME")]
    site: Option<String>,
    /// A simulated bench only.
    #[arg(long)]
    simulated: bool,
}

impl SubmitArgs {
    pub(super) fn needs(&self) -> Needs {
        Needs {
            current_a: self.current_a,
            temperature_degc: self.temperature_degc,
            fixture: self.fixture.clone(),
            bench: self.bench.clone(),
            site: self.site.clone(),
            simulated: self.simulated.then_some(true),
        }
    }
}

/// An order to a bench.
#[derive(Debug, Args)]
pub struct OrderArgs {
    /// The bench, SITE/BENCH; `release` takes a job too.
    pub(super) what: String,
    /// Reason, which is kept with the bench or the job.
    #[arg(long, value_name = "WORDS")]
    pub(super) why: String,
}

/// Benches that are stopped.
#[derive(Debug, Args)]
pub struct StopArgs {
    /// The bench, SITE/BENCH.
    #[arg(required_unless_present = "all")]
    pub(super) bench: Option<String>,
    /// Stop every bench of the fleet.
    #[arg(long, conflicts_with = "bench")]
    pub(super) all: bool,
    /// Reason, which is kept with the bench.
    #[arg(long, value_name = "WORDS", default_value = "stopped by hand")]
    pub(super) why: String,
}
