//! The fleet as it is shown: benches with their last reports, and jobs.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use crate::{
    error::FleetError,
    job::{Job, JobState, Place},
    link::Link,
    local::{BenchState, Capabilities},
    record::BenchRecord,
    watched::{Seen, Watched},
};

/// Maximum number of jobs of one page.
pub const MOST_JOBS: usize = 1000;

/// A bench as it is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct BenchView {
    /// The bench.
    pub place: Place,
    /// Its state; `None` if it is silent or has signed off.
    pub state: Option<BenchState>,
    /// It takes no further job.
    pub draining: bool,
    /// Time since its last message, s.
    pub silent_s: f64,
    /// The run in work.
    pub run: Option<String>,
    /// The job that it has.
    pub job: Option<String>,
    /// Time left of the run, s.
    pub left_s: Option<f64>,
    /// Its properties.
    pub capabilities: Capabilities,
    /// Why no run may begin on it.
    pub held: Option<String>,
    /// Every output is known to be off; `None` if that is unknown.
    pub verified: Option<bool>,
}

impl BenchView {
    /// Names of the states.
    pub const STATES: [&'static str; 7] = [
        "idle", "running", "held", "draining", "latched", "asking", "silent",
    ];

    /// Returns its state in one word, as in the API.
    pub fn state_name(&self) -> &'static str {
        match self.state {
            None => "silent",
            Some(BenchState::Latched) => "latched",
            Some(BenchState::Asking) => "asking",
            Some(BenchState::Running) => "running",
            Some(BenchState::Held) => "held",
            Some(BenchState::Idle) if self.draining => "draining",
            Some(BenchState::Idle) => "idle",
        }
    }
}

/// Numbers of a fleet, as a daemon counts them for its metrics.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tally {
    /// Jobs.
    pub jobs: JobCounts,
    /// Benches by [`BenchView::STATES`].
    pub benches: BTreeMap<&'static str, usize>,
    /// Jobs that wait and that no bench of the fleet can take.
    pub stranded: usize,
}

/// Numbers of jobs by state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct JobCounts {
    /// By [`JobState::ALL`].
    pub by_state: [usize; 6],
    /// Started jobs whose bench is silent, or does not know them.
    pub lost: usize,
}

impl JobCounts {
    /// Returns the number of jobs in a state; lost jobs are counted separately from started ones.
    pub fn of(&self, state: JobState) -> usize {
        let count = self.by_state[state.index()];
        match state {
            JobState::Started => count - self.lost,
            _ => count,
        }
    }
}

/// The fleet as it is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct FleetView {
    /// Its name.
    pub fleet: String,
    /// The broker is there.
    pub connected: bool,
    /// When the broker stored the latest change of a bench, s since 1970 by its calendar.
    pub changed_unix_s: f64,
    /// Its benches.
    pub benches: Vec<BenchView>,
    /// Numbers of jobs.
    pub jobs: JobCounts,
    /// Jobs that wait and that no bench of the fleet can take, with the reason.
    pub stranded: BTreeMap<String, String>,
}

impl FleetView {
    /// Returns a fleet whose broker has been unreachable since the first request.
    pub fn unseen(fleet: &str) -> Self {
        Self {
            fleet: fleet.to_owned(),
            connected: false,
            changed_unix_s: 0.0,
            benches: Vec::new(),
            jobs: JobCounts::default(),
            stranded: BTreeMap::new(),
        }
    }
}

/// Conditions on jobs.
#[derive(Debug, Clone, Default)]
pub struct JobFilter {
    /// In this state; `lost` is one too.
    pub state: Option<String>,
    /// Not yet over.
    pub open: bool,
    /// Of this campaign.
    pub campaign: Option<String>,
    /// After this job.
    pub after: Option<String>,
    /// Maximum number of jobs.
    pub most: usize,
}

/// A job as it is shown.
#[derive(Debug, Clone, PartialEq)]
pub struct JobView {
    /// The job.
    pub job: Job,
    /// Whether its bench is silent or does not know it.
    pub is_lost: bool,
}

impl JobView {
    /// Names of the states.
    pub const STATES: [&'static str; 7] = [
        "queued",
        "claimed",
        "started",
        "lost",
        "done",
        "failed",
        "cancelled",
    ];

    /// Returns its state in one word, as in the API.
    pub fn state_name(&self) -> &'static str {
        if self.is_lost {
            "lost"
        } else {
            self.job.state.name()
        }
    }
}

/// A page of jobs.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JobPage {
    /// In the order of the queue.
    pub jobs: Vec<JobView>,
    /// The last job of the page, if there are more.
    pub after: Option<String>,
}

/// Replies of benches to a query of their state; benches that did not reply are absent.
#[derive(Debug, Default)]
pub struct Looks(pub(crate) BTreeMap<Place, Option<BenchRecord>>);

impl Looks {
    /// Benches that did not answer.
    pub fn silent(&self) -> Vec<&Place> {
        let silent = self.0.iter().filter(|(_, answer)| answer.is_none());
        silent.map(|(place, _)| place).collect()
    }
}

/// Holds the observed state of the fleet.
pub struct Seer {
    link: Arc<Link>,
    fleet: String,
    jobs: Arc<Watched<Job>>,
    benches: Arc<Watched<BenchRecord>>,
    /// Replies of the queried benches.
    asked: Mutex<Looks>,
}

impl Seer {
    /// Creates an empty view; another watcher follows the jobs.
    pub(crate) fn of(link: &Arc<Link>, fleet: &str, jobs: &Arc<Watched<Job>>) -> Arc<Self> {
        Arc::new(Self {
            link: link.clone(),
            fleet: fleet.to_owned(),
            jobs: jobs.clone(),
            benches: Watched::dated(),
            asked: Mutex::default(),
        })
    }

    /// Follows the benches until the task is aborted.
    pub(crate) async fn follow(self: Arc<Self>) {
        let (link, bucket) = (self.link.clone(), self.link.benches.clone());
        self.benches.clone().follow(link, bucket).await;
    }

    /// Returns whether every job and bench has been received.
    pub fn is_whole(&self) -> bool {
        self.jobs.is_whole() && self.benches.is_whole()
    }

    /// Applies the replies of benches: they are newer than the last reports, and benches that did
    /// not reply count as silent.
    pub fn asked(&self, looks: Looks) {
        *self.asked.lock().unwrap_or_else(PoisonError::into_inner) = looks;
    }

    /// Returns all benches that have ever registered.
    pub fn places(&self) -> Vec<Place> {
        self.benches
            .with(|all| all.values().map(|seen| seen.value.place.clone()).collect())
    }

    /// Returns the present view of the fleet.
    pub fn view(&self) -> FleetView {
        let benches = self.bench_views();
        let changed = self.benches.with(|all| {
            let times = all.values().map(|seen| seen.broker_unix_s);
            times.fold(0.0, f64::max)
        });
        FleetView {
            fleet: self.fleet.clone(),
            connected: self.link.is_connected(),
            changed_unix_s: changed,
            jobs: self.counts(&benches),
            stranded: self.stranded(&benches),
            benches,
        }
    }

    /// Reads the last report of every bench once, and counts them.
    ///
    /// # Errors
    /// The broker does not answer.
    pub(crate) async fn tally(&self) -> Result<Tally, FleetError> {
        self.benches.read(&self.link, &self.link.benches).await?;
        let views = self.bench_views();
        let mut benches = BTreeMap::from(BenchView::STATES.map(|state| (state, 0)));
        for view in &views {
            *benches.entry(view.state_name()).or_default() += 1;
        }
        Ok(Tally {
            jobs: self.counts(&views),
            stranded: self.stranded(&views).len(),
            benches,
        })
    }

    fn counts(&self, benches: &[BenchView]) -> JobCounts {
        let mut counts = JobCounts::default();
        self.jobs.with_all(|kept| {
            for seen in kept.records.values() {
                counts.by_state[seen.value.state.index()] += 1;
                counts.lost += usize::from(self.is_lost(seen, benches));
            }
            for state in kept.classes.values() {
                counts.by_state[*state] += 1;
            }
        });
        counts
    }

    fn stranded(&self, benches: &[BenchView]) -> BTreeMap<String, String> {
        self.jobs.with(|jobs| {
            let jobs = jobs.values().map(|seen| &seen.value);
            jobs.filter_map(|job| Some((job.job.clone(), stranded_by(job, benches)?)))
                .collect()
        })
    }

    fn bench_views(&self) -> Vec<BenchView> {
        let now_s = self.link.clock.now_s();
        let asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        let view = |seen: &Seen<BenchRecord>| {
            let silent_s = now_s - seen.since_s;
            match asked.0.get(&seen.value.place) {
                Some(Some(answer)) => shown(answer, 0.0),
                Some(None) => BenchView {
                    silent_s,
                    ..shown(&seen.value, f64::INFINITY)
                },
                None => shown(&seen.value, silent_s),
            }
        };
        self.benches.with(|all| all.values().map(view).collect())
    }

    /// Returns whether a started job is abandoned, as far as is visible: its bench is silent, or
    /// has reported since without naming the job.
    fn is_lost(&self, seen: &Seen<Job>, benches: &[BenchView]) -> bool {
        let job = &seen.value;
        let (JobState::Started, Some(holder)) = (job.state, &job.holder) else {
            return false;
        };
        let bench = benches.iter().find(|bench| bench.place == holder.place);
        let Some(bench) = bench else { return true };
        let lease_s = self.benches.get(&bench.place.key());
        let lease_s = lease_s.map_or(0.0, |seen| seen.value.lease_s);
        let is_old = self.link.clock.now_s() - seen.since_s > lease_s;
        bench.state.is_none() || (is_old && bench.job.as_ref() != Some(&job.job))
    }

    /// Returns the jobs that meet every condition, one page at a time.
    pub fn jobs(&self, filter: &JobFilter) -> JobPage {
        let benches = self.bench_views();
        let most = filter.most.clamp(1, MOST_JOBS);
        let mut found: Vec<JobView> = self.jobs.with(|jobs| {
            let after = filter.after.clone().unwrap_or_default();
            let later = jobs
                .range::<String, _>((std::ops::Bound::Excluded(after), std::ops::Bound::Unbounded));
            let shown = later.map(|(_, seen)| JobView {
                is_lost: self.is_lost(seen, &benches),
                job: seen.value.clone(),
            });
            let wanted = |view: &JobView| {
                let campaign = filter.campaign.as_ref();
                campaign.is_none_or(|name| view.job.campaign.as_ref() == Some(name))
                    && !(filter.open && view.job.state.is_over())
                    && (filter.state.as_deref()).is_none_or(|state| view.state_name() == state)
            };
            shown.filter(wanted).take(most + 1).collect()
        });
        let is_cut = found.len() > most;
        found.truncate(most);
        let last = found.last().map(|view| view.job.job.clone());
        JobPage {
            jobs: found,
            after: last.filter(|_| is_cut),
        }
    }
}

/// Returns a bench as it reported itself `silent_s` ago.
fn shown(record: &BenchRecord, silent_s: f64) -> BenchView {
    let is_heard = !record.left && silent_s <= record.lease_s;
    let signed_off = record.left.then(|| "its daemon has signed off".to_owned());
    BenchView {
        place: record.place.clone(),
        state: is_heard.then_some(record.state),
        draining: record.draining,
        silent_s,
        run: record.run.clone(),
        job: record.job.clone(),
        left_s: record.left_s,
        capabilities: record.capabilities.clone(),
        held: signed_off.or_else(|| record.held.clone()),
        // A state from before the silence may be outdated.
        verified: record.verified.filter(|_| is_heard),
    }
}

/// Describes why no bench of the fleet can take a waiting job, or returns `None` if one can.
fn stranded_by(job: &Job, benches: &[BenchView]) -> Option<String> {
    if job.state != JobState::Queued {
        return None;
    }
    if benches.is_empty() {
        return Some("no bench has signed on".to_owned());
    }
    let mut reasons = Vec::new();
    for bench in benches {
        let silent = || bench.state.is_none().then(|| "it is silent".to_owned());
        let unfit = job.unfit(&bench.place, &bench.capabilities);
        let why = unfit.or_else(silent)?;
        reasons.push(format!("{}: {why}", bench.place));
    }
    Some(first_of(&reasons))
}

/// Joins the first reasons, and the number of further ones.
fn first_of(reasons: &[String]) -> String {
    const MOST_LISTED: usize = 3;
    let first = reasons
        .iter()
        .take(MOST_LISTED)
        .cloned()
        .collect::<Vec<_>>();
    match reasons.len().saturating_sub(MOST_LISTED) {
        0 => first.join("; "),
        more => format!("{}; and {more} more", first.join("; ")),
    }
}
