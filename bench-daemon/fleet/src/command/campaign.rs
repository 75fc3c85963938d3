//! Puts a campaign over benches into the queue of a fleet. `eis-bench campaign plan` reads the file
//! of the campaign and makes the experiments, so that their seeds and texts have one source.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use serde::Deserialize;

use crate::{
    client::{Client, Submission},
    error::FleetError,
    failure::Failure,
    job::{JobState, Needs},
    view::{JobFilter, MOST_JOBS},
};

/// The program that plans campaigns.
const PLANNER: &str = "eis-bench";

/// A campaign as `eis-bench campaign plan --json` prints it.
#[derive(Debug, Deserialize)]
pub(super) struct PlannedCampaign {
    /// Its name.
    pub(super) campaign: String,
    experiments: Vec<PlannedVisit>,
}

/// An experiment of a campaign.
#[derive(Debug, Deserialize)]
struct PlannedVisit {
    bench: String,
    cell: String,
    seed: u64,
    text: String,
}

impl PlannedCampaign {
    /// Plans the campaign of a file.
    ///
    /// # Errors
    /// The file is invalid, or the program `eis-bench` is missing.
    pub(super) fn plan(file: &Path) -> Result<Self, Failure> {
        let program = planner();
        let planned = Command::new(&program)
            .args(["campaign", "plan", "--json"])
            .arg(file)
            .stdin(Stdio::null())
            .output();
        let planned = planned.map_err(|error| {
            let program = program.display();
            Failure::Usage(format!(
                "expected the program {PLANNER} beside this one or in the PATH, which plans the \
                campaign, found {program}: {error}"
            ))
        })?;
        if !planned.status.success() {
            let text = String::from_utf8_lossy(&planned.stderr);
            let message = text
                .lines()
                .rev()
                .find_map(|line| line.strip_prefix("eis-bench: "));
            return Err(Failure::Usage(message.unwrap_or(text.trim()).to_owned()));
        }
        serde_json::from_slice(&planned.stdout).map_err(|error| {
            let program = program.display();
            Failure::Usage(format!(
                "expected the plan of a campaign from {program}, of the version of this program, \
                found another text: {error}"
            ))
        })
    }

    /// Returns the jobs that are not in `known`, the seeds of recorded jobs. A visit is identified
    /// by its seed, which follows from the campaign's file.
    pub(super) fn missing(self, known: &BTreeSet<u64>, by: &str) -> Vec<Submission> {
        let campaign = self.campaign;
        let visits = self.experiments.into_iter();
        let missing = visits.filter(|visit| !known.contains(&visit.seed));
        missing
            .map(|visit| submission(&campaign, visit, by))
            .collect()
    }
}

/// Returns the path of `eis-bench`: beside this program, or a name for the PATH.
fn planner() -> PathBuf {
    let beside = std::env::current_exe().ok();
    let beside = beside.map(|own| own.with_file_name(PLANNER));
    beside
        .filter(|path| path.is_file())
        .unwrap_or_else(|| PLANNER.into())
}

/// Returns the seeds of the jobs of a campaign that are on record and were not cancelled.
///
/// # Errors
/// The broker does not answer.
pub(super) async fn seeds(
    client: &Client,
    fleet: &str,
    campaign: &str,
) -> Result<BTreeSet<u64>, FleetError> {
    let looking = client.seer(fleet).await?;
    let mut seeds = BTreeSet::new();
    let mut filter = JobFilter {
        state: None,
        open: false,
        campaign: Some(campaign.to_owned()),
        after: None,
        most: MOST_JOBS,
    };
    loop {
        let page = looking.seer.jobs(&filter);
        // A cancelled job was not executed.
        let jobs = page.jobs.iter().map(|view| &view.job);
        let jobs = jobs.filter(|job| job.state != JobState::Cancelled);
        seeds.extend(jobs.filter_map(|job| job.seed));
        filter.after = page.after;
        if filter.after.is_none() {
            return Ok(seeds);
        }
    }
}

fn submission(campaign: &str, visit: PlannedVisit, by: &str) -> Submission {
    let (site, bench) = match visit.bench.split_once('/') {
        Some((site, bench)) => (Some(site.to_owned()), bench.to_owned()),
        None => (None, visit.bench),
    };
    Submission {
        name: campaign.to_owned(),
        text: visit.text,
        needs: Needs {
            site,
            bench: Some(bench),
            ..Needs::default()
        },
        count: 1,
        seed: Some(visit.seed),
        campaign: Some(campaign.to_owned()),
        cell: Some(visit.cell),
        by: by.to_owned(),
    }
}
