//! Puts a campaign over benches into the queue of a fleet.

use std::collections::BTreeSet;

use bench_fleet::{
    Client, FleetError, JobState, Needs, Submission,
    view::{JobFilter, MOST_JOBS},
};

use crate::{
    campaign::{CampaignFile, Design, Visit},
    config::ConfigError,
};

/// Returns the jobs of a campaign that are not in `known`, the seeds of recorded jobs. A visit is
/// identified by its seed, which follows from the campaign's file.
pub(super) fn missing(
    file: &CampaignFile,
    known: &BTreeSet<u64>,
    by: &str,
) -> Result<Vec<Submission>, ConfigError> {
    let design = Design::of(file);
    let turns = design.benches.iter().map(Vec::len).max().unwrap_or(0);
    // In turn over the benches: none waits for the whole plan of another.
    let visits = (0..turns)
        .flat_map(|turn| design.benches.iter().filter_map(move |all| all.get(turn)))
        .filter(|visit| !known.contains(&file.seed_of(visit)));
    visits.map(|visit| submission(file, visit, by)).collect()
}

/// Seeds of the jobs of a campaign that are on record and were not cancelled.
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

fn submission(file: &CampaignFile, visit: &Visit, by: &str) -> Result<Submission, ConfigError> {
    let seed = file.seed_of(visit);
    let name = &file.benches[visit.bench].name;
    let (site, bench) = match name.split_once('/') {
        Some((site, bench)) => (Some(site), bench),
        None => (None, name.as_str()),
    };
    Ok(Submission {
        name: file.name.clone(),
        text: file.text(visit, None, str::to_owned)?,
        needs: Needs {
            site: site.map(str::to_owned),
            bench: Some(bench.to_owned()),
            ..Needs::default()
        },
        count: 1,
        seed: Some(seed),
        campaign: Some(file.name.clone()),
        cell: Some(visit.cell.name.clone()),
        by: by.to_owned(),
    })
}
