//! Requests of people to a fleet: submit, cancel, put back, hold, drain, stop, forget.

mod forget;

use std::{sync::Arc, time::Duration};

use futures_util::future::join_all;
use instruments_link::clock;
use serde::de::{DeserializeOwned, IgnoredAny};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::{
    error::FleetError,
    job::{Asked, Job, JobState, LONGEST_NAME, Needs, Place, is_plain},
    link::{Bucket, Link, Stored, Swap, Write, hex, random},
    record::{BenchAnswer, BenchRecord, Question},
    settings::FleetSettings,
    standing::{OrderKind, Said},
    view::{Looks, Seer},
    watched::Watched,
};

pub use forget::{Ages, Forgotten};

/// Maximum size of the text of an experiment, bytes: half of a broker's message limit.
const LONGEST_TEXT: usize = 512 * 1024;
/// Maximum number of jobs of one submission.
pub const MOST_COUNT: usize = 10_000;
/// Number of jobs that are queued concurrently; their replies are awaited together.
const AT_ONCE: usize = 64;
/// Timeout of a state query of a bench; after it, the bench counts as not heard.
const LOOK: Duration = Duration::from_secs(3);
/// Timeout of a state query if much depends on the reply: before a bench replies it queries the
/// broker, 3 s, and may write to a slow disk.
const PATIENT_LOOK: Duration = Duration::from_secs(10);
/// Timeout of a stop, which reads every output back: `eis-bench safe` takes at most 90 s, after
/// the run had 10 s to end on its own.
const STOP: Duration = Duration::from_secs(120);
/// Timeout of the list of all jobs and benches, s.
const WHOLE_S: f64 = 10.0;
/// Maximum number of attempts to write a record that others write, too.
const ATTEMPTS: usize = 20;

/// Work to be put into the queue.
#[derive(Debug, Clone, Default)]
pub struct Submission {
    /// Name of the experiment.
    pub name: String,
    /// Its text, TOML.
    pub text: String,
    /// Requirements on the bench.
    pub needs: Needs,
    /// Number of jobs of this experiment.
    pub count: usize,
    /// Seed of the first job, instead of that of the experiment; each further job has the next one.
    pub seed: Option<u64>,
    /// Label of a campaign.
    pub campaign: Option<String>,
    /// Label of the cell.
    pub cell: Option<String>,
    /// Name of the caller.
    pub by: String,
}

/// A command of a user to a bench.
#[derive(Debug, Clone)]
pub struct Command {
    /// Kind of the order.
    pub kind: OrderKind,
    /// Name of the caller.
    pub by: String,
    /// Why.
    pub why: String,
}

/// Result of an order to a bench.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Its site.
    pub site: String,
    /// The bench.
    pub bench: String,
    /// Whether the broker stores the order: a disconnected bench follows it once it is connected
    /// again.
    pub kept: bool,
    /// The bench has answered.
    pub heard: bool,
    /// Why no run may begin on it now.
    pub held: Option<String>,
    /// Whether every output is known to be off; `None` if the bench did not reply or runs.
    pub verified: Option<bool>,
    /// Remarks on it, in words.
    pub words: String,
    /// Report of a stop by the bench's own server.
    pub report: Option<serde_json::Value>,
}

/// A connection to a fleet for people.
#[derive(Clone)]
pub struct Client {
    link: Arc<Link>,
}

impl Client {
    /// Creates a client with an existing connection.
    pub(crate) fn through(link: Arc<Link>) -> Self {
        Self { link }
    }

    /// Creates a client with its own connection.
    ///
    /// # Errors
    /// The broker is unreachable or refuses the connection.
    pub async fn connect(settings: &FleetSettings) -> Result<Self, FleetError> {
        Link::open(settings).await.map(Self::through)
    }

    /// Returns whether the broker was reachable at the last contact.
    pub fn is_connected(&self) -> bool {
        self.link.is_connected()
    }

    /// Puts jobs into the queue. Each is queued exactly once, even if replies are lost.
    ///
    /// # Errors
    /// The submission is invalid, or the broker does not answer.
    pub async fn submit(&self, submission: &Submission) -> Result<Vec<String>, FleetError> {
        self.submit_all(std::slice::from_ref(submission)).await
    }

    /// Puts several experiments into the queue, in their order; returns the names of the jobs.
    ///
    /// # Errors
    /// As [`Client::submit`]; some of the jobs may already be in the queue.
    pub async fn submit_all(&self, all: &[Submission]) -> Result<Vec<String>, FleetError> {
        all.iter().try_for_each(check)?;
        let batch = batch()?;
        let mut jobs: Vec<Job> = Vec::new();
        for submission in all {
            let text_sha256 = self.keep_text(&submission.text).await?;
            for index in 0..submission.count {
                let name = format!("{batch}-{:07}", jobs.len() + 1);
                jobs.push(job_of(submission, name, index, &text_sha256));
            }
        }
        for some in jobs.chunks(AT_ONCE) {
            let put = join_all(some.iter().map(|job| self.put(job))).await;
            put.into_iter().collect::<Result<(), _>>()?;
        }
        Ok(jobs.into_iter().map(|job| job.job).collect())
    }

    /// Stores the text of an experiment under its hash.
    async fn keep_text(&self, text: &str) -> Result<String, FleetError> {
        let key = hex(&Sha256::digest(text.as_bytes()));
        let texts = &self.link.texts;
        for _ in 0..ATTEMPTS {
            // An existing text is written again, so that it is not removed before its jobs exist.
            let found = texts.get::<IgnoredAny>(&key).await?;
            let revision = found.map_or(0, |found| found.revision);
            if let Swap::Written(_) = texts.swap(&key, &text, revision).await? {
                return Ok(key);
            }
        }
        Err(FleetError::Conflict(
            "others write the same text all the time: nothing was submitted".to_owned(),
        ))
    }

    async fn put(&self, job: &Job) -> Result<(), FleetError> {
        let write = Write {
            bucket: &self.link.jobs,
            key: &job.job,
            value: job,
            revision: 0,
        };
        let surely = self
            .link
            .swap_surely(write, |found: &Job| found.job == job.job);
        let patience = Duration::from_secs(30);
        match self.link.clock.deadline(patience, surely).await {
            Ok(Swap::Written(_)) => Ok(()),
            Ok(Swap::Lost) => Err(FleetError::Conflict(format!(
                "expected a new name of a job, found one that is there: {}",
                job.job
            ))),
            Err(_) => Err(FleetError::Unreachable(format!(
                "whether {} is in the queue is not known: look with `fleet status` before it is \
                submitted again",
                job.job
            ))),
        }
    }

    /// Removes a waiting job from the queue.
    ///
    /// # Errors
    /// A bench has the job, the job has ended, or the broker does not answer.
    pub async fn cancel(&self, job: &str, by: &str) -> Result<(), FleetError> {
        let found = self.job(job).await?;
        if found.value.state != JobState::Queued {
            return Err(FleetError::Conflict(format!(
                "{job}: expected a job that waits, found one that is {}",
                found.value.state.name()
            )));
        }
        self.change(&found, &cancelled(&found.value, by)).await
    }

    /// Removes every waiting job of a campaign from the queue; returns their number.
    ///
    /// # Errors
    /// The broker does not answer; some of the jobs may already be removed.
    pub async fn cancel_campaign(&self, campaign: &str, by: &str) -> Result<usize, FleetError> {
        let jobs = self.whole::<Job>(&self.link.jobs).await?;
        let waits =
            |job: &Job| job.state == JobState::Queued && job.campaign.as_deref() == Some(campaign);
        let waiting: Vec<_> = jobs.with(|jobs| {
            let waiting = jobs.values().filter(|seen| waits(&seen.value));
            waiting.cloned().collect()
        });
        let mut count = 0;
        for seen in &waiting {
            let (key, next) = (&seen.value.job, cancelled(&seen.value, by));
            // A job that a bench has claimed meanwhile is no longer waiting.
            let swap = self.link.jobs.swap(key, &next, seen.revision).await?;
            count += usize::from(swap != Swap::Lost);
        }
        Ok(count)
    }

    /// Puts a started job whose bench is gone back into the queue, after a person has decided
    /// that it may run again.
    ///
    /// # Errors
    /// The job is not started, a bench that answers has it, or the broker does not answer.
    pub async fn release_job(&self, job: &str, by: &str, why: &str) -> Result<(), FleetError> {
        let found = self.job(job).await?;
        let holder = found.value.holder.as_ref();
        let (JobState::Started, Some(holder)) = (found.value.state, holder) else {
            return Err(FleetError::Conflict(format!(
                "{job}: expected a job whose run was started, found one that is {}",
                found.value.state.name()
            )));
        };
        self.is_gone(&holder.place, job).await?;
        let words = format!("put back by {by}: {why}");
        self.change(&found, &found.value.released(words)).await
    }

    /// Checks that a bench no longer has a job: it does not answer, or it reports so itself. An
    /// invalid reply does not count as such a report.
    async fn is_gone(&self, place: &Place, job: &str) -> Result<(), FleetError> {
        let conflict = |found: &str| {
            Err(FleetError::Conflict(format!(
                "{job}: expected a job whose bench is gone, found that {place} {found}"
            )))
        };
        let answer: Option<Value> = self.link.ask(place, &Question::Look, PATIENT_LOOK).await;
        if !self.link.is_connected() {
            let words = "whether the bench answers is not known: ask again".to_owned();
            return Err(FleetError::Unreachable(words));
        }
        let Some(answer) = answer else { return Ok(()) };
        let jobs = answer["jobs"].as_array();
        let record: Option<Stored<Value>> = self.link.benches.get(&place.key()).await?;
        let signed_on = record.map(|record| record.value["nonce"].clone());
        match jobs {
            Some(jobs) if jobs.iter().any(|one| one == job) => {
                conflict("has it and answers: stop it there first")
            }
            None => conflict("answers, and does not say which jobs it has: look at it there"),
            Some(_) if signed_on != Some(answer["record"]["nonce"].clone()) => {
                conflict("is answered for by another process than the one that is signed on")
            }
            Some(_) => Ok(()),
        }
    }

    /// Gives an order to a bench. The broker stores it, and the bench receives a request to follow
    /// it now.
    ///
    /// # Errors
    /// There is no such bench. An unreachable broker is reported in the outcome instead, because a
    /// stop may still reach the bench.
    pub async fn order(&self, place: &Place, command: &Command) -> Result<Outcome, FleetError> {
        let is_known = is_plain(&place.site)
            && is_plain(&place.bench)
            && self.knows(place, command.kind).await?;
        if !is_known {
            return Err(unknown_bench(place));
        }
        self.say(place, command).await
    }

    /// Returns whether a bench has ever registered. A stop is sent even without that answer.
    async fn knows(&self, place: &Place, kind: OrderKind) -> Result<bool, FleetError> {
        let found = self.link.benches.get::<BenchRecord>(&place.key()).await;
        match (found, kind) {
            (Err(_), OrderKind::Stop) => Ok(true),
            (found, _) => found.map(|found| found.is_some()),
        }
    }

    /// Stops every bench of the fleet at once.
    ///
    /// # Errors
    /// The broker does not answer: the list of benches is then unknown.
    pub async fn stop_all(&self, by: &str, why: &str) -> Result<Vec<Outcome>, FleetError> {
        // Reads the benches only: a stop does not wait for the records of the jobs. Uses their
        // keys, so that a bench with an invalid record is stopped too.
        let benches = self.whole::<IgnoredAny>(&self.link.benches).await?;
        let places: Vec<Place> =
            benches.with(|all| all.keys().filter_map(|key| Place::of_key(key)).collect());
        self.stop_these(&places, by, why).await
    }

    /// Stops these benches at once, whether the broker can store the order or not.
    ///
    /// # Errors
    /// The random numbers of the operating system are unavailable.
    pub async fn stop_these(
        &self,
        places: &[Place],
        by: &str,
        why: &str,
    ) -> Result<Vec<Outcome>, FleetError> {
        let command = Command {
            kind: OrderKind::Stop,
            by: by.to_owned(),
            why: why.to_owned(),
        };
        let said = places.iter().map(|place| self.say(place, &command));
        join_all(said).await.into_iter().collect()
    }

    async fn say(&self, place: &Place, command: &Command) -> Result<Outcome, FleetError> {
        let said = Said {
            id: random()?,
            by: command.by.clone(),
            why: command.why.clone(),
            unix_s: clock::unix_time_s(),
        };
        let is_stop = command.kind == OrderKind::Stop;
        let (question, patience) = match command.kind {
            OrderKind::Stop => (Question::Stop(said.clone()), STOP),
            _ => (Question::Look, LOOK),
        };
        let ask = self.link.ask::<BenchAnswer>(place, &question, patience);
        let keep = self.keep_order(place, command.kind, &said);
        // A stop is sent at once; any other order is stored first, so that the bench finds it.
        let (kept, answer) = if is_stop {
            let (answer, kept) = tokio::join!(ask, keep);
            (kept, answer)
        } else {
            let kept = keep.await;
            kept.clone()?;
            (kept, ask.await)
        };
        Ok(outcome(place, &kept, answer.as_ref()))
    }

    async fn keep_order(
        &self,
        place: &Place,
        kind: OrderKind,
        said: &Said,
    ) -> Result<(), FleetError> {
        for _ in 0..ATTEMPTS {
            let found = self.link.standing(place).await?;
            let next = found.value.with(kind, said.clone());
            let orders = &self.link.orders;
            if let Swap::Written(_) = orders.swap(&place.key(), &next, found.revision).await? {
                return Ok(());
            }
        }
        Err(FleetError::Conflict(format!(
            "{place}: others give it orders all the time: nothing was kept"
        )))
    }

    async fn job(&self, job: &str) -> Result<Stored<Job>, FleetError> {
        // A text that is not a valid key of the broker is not a job.
        let found = match is_plain(job) {
            true => self.link.job(job).await?,
            false => None,
        };
        found.ok_or_else(|| FleetError::Unknown {
            what: "a job",
            found: job.to_owned(),
        })
    }

    async fn change(&self, found: &Stored<Job>, next: &Job) -> Result<(), FleetError> {
        let jobs = &self.link.jobs;
        match jobs.swap(&next.job, next, found.revision).await? {
            Swap::Written(_) => Ok(()),
            Swap::Lost => Err(FleetError::Conflict(format!(
                "{}: it has changed meanwhile: look again",
                next.job
            ))),
        }
    }

    /// Returns the present state of every record of a bucket.
    async fn whole<T>(&self, bucket: &Bucket) -> Result<Arc<Watched<T>>, FleetError>
    where
        T: DeserializeOwned + Clone + Send + 'static,
    {
        let records = Watched::keeping_all();
        let follow = records.clone().follow(self.link.clone(), bucket.clone());
        let follow = tokio::spawn(follow);
        let whole = self.until(|| records.is_whole()).await;
        follow.abort();
        whole.map(|()| records)
    }

    async fn until(&self, is_so: impl Fn() -> bool) -> Result<(), FleetError> {
        let until_s = self.link.clock.now_s() + WHOLE_S;
        while !is_so() {
            if self.link.clock.now_s() > until_s {
                return Err(FleetError::Unreachable(
                    "its records do not come".to_owned(),
                ));
            }
            self.link.clock.sleep_s(0.02).await;
        }
        Ok(())
    }

    /// Watches the fleet as long as the returned value lives.
    ///
    /// # Errors
    /// The records of the broker do not arrive.
    pub async fn seer(&self, fleet: &str) -> Result<Looking, FleetError> {
        let looking = Looking::begin(&self.link, fleet, &Watched::keeping_all());
        self.until(|| looking.seer.is_whole()).await?;
        Ok(looking)
    }

    /// Queries the present state of benches. Benches that do not reply are included.
    pub async fn look(&self, places: &[Place]) -> Looks {
        let ask = |place: &Place| {
            let place = place.clone();
            async move {
                let answer = self.link.ask(&place, &Question::Look, LOOK).await;
                (place, answer.map(|answer: BenchAnswer| answer.record))
            }
        };
        Looks(join_all(places.iter().map(ask)).await.into_iter().collect())
    }
}

/// A subscription to the state of the fleet.
pub struct Looking {
    /// The watcher that holds the state.
    pub seer: Arc<Seer>,
    _tasks: tokio::task::JoinSet<()>,
}

impl Looking {
    /// Starts to follow all benches and these jobs. Must be called inside a runtime.
    pub(crate) fn begin(link: &Arc<Link>, fleet: &str, jobs: &Arc<Watched<Job>>) -> Self {
        let seer = Seer::of(link, fleet, jobs);
        let mut tasks = tokio::task::JoinSet::new();
        tasks.spawn(jobs.clone().follow(link.clone(), link.jobs.clone()));
        tasks.spawn(seer.clone().follow());
        Self {
            seer,
            _tasks: tasks,
        }
    }
}

fn outcome(place: &Place, kept: &Result<(), FleetError>, answer: Option<&BenchAnswer>) -> Outcome {
    let heard = answer.is_some();
    let words = match (kept, heard) {
        (Ok(()), true) => "it has heard".to_owned(),
        (Ok(()), false) => "it does not answer: it follows as soon as it hears".to_owned(),
        (Err(error), true) => format!("it has heard; the order is not kept: {error}"),
        (Err(error), false) => {
            format!("IT WAS NOT REACHED: stop it at its own server or its switch ({error})")
        }
    };
    let record = answer.map(|answer| &answer.record);
    let report = answer.and_then(|answer| answer.report.clone());
    // A simulated bench has no output that could be read back.
    let proven =
        |report: &serde_json::Value| report["verified"] == true || report["simulated"] == true;
    let read_back = report.as_ref().map(proven);
    Outcome {
        site: place.site.clone(),
        bench: place.bench.clone(),
        kept: kept.is_ok(),
        heard,
        held: record.and_then(|record| record.held.clone()),
        verified: read_back.or_else(|| record.and_then(|record| record.verified)),
        words,
        report,
    }
}

fn cancelled(job: &Job, by: &str) -> Job {
    Job {
        state: JobState::Cancelled,
        words: format!("cancelled by {by}"),
        ..job.clone()
    }
}

fn unknown_bench(place: &Place) -> FleetError {
    FleetError::Unknown {
        what: "a bench SITE/BENCH",
        found: place.to_string(),
    }
}

fn check(submission: &Submission) -> Result<(), FleetError> {
    let unfit = |text: String| Err(FleetError::Unfit(text));
    let name = &submission.name;
    if !is_plain(name) {
        return unfit(format!(
            "name: expected 1 to {LONGEST_NAME} letters, digits, `-` and `_`, found {name:?}"
        ));
    }
    if !(1..=MOST_COUNT).contains(&submission.count) {
        let count = submission.count;
        return unfit(format!("count: expected 1 to {MOST_COUNT}, found {count}"));
    }
    if submission.text.len() > LONGEST_TEXT {
        let length = submission.text.len();
        return unfit(format!(
            "text: expected at most {LONGEST_TEXT} bytes, found {length}"
        ));
    }
    Ok(())
}

/// Returns the prefix of the job names of one submission. Names follow the order of submission as
/// far as the calendars of the submitting machines agree; only the order of the queue depends on
/// it.
fn batch() -> Result<String, FleetError> {
    let micros = (clock::unix_time_s() * 1.0e6) as i64;
    let now = jiff::Timestamp::from_microsecond(micros)
        .map_err(|error| FleetError::File(error.to_string()))?;
    Ok(format!(
        "{}-{}",
        now.strftime("%Y%m%dT%H%M%S%3f"),
        random()?
    ))
}

fn job_of(submission: &Submission, job: String, index: usize, text_sha256: &str) -> Job {
    Job {
        job,
        name: submission.name.clone(),
        state: JobState::Queued,
        needs: submission.needs.clone(),
        text_sha256: text_sha256.to_owned(),
        seed: submission.seed.map(|seed| seed + index as u64),
        asked: Asked {
            by: submission.by.clone(),
            unix_s: clock::unix_time_s(),
        },
        campaign: submission.campaign.clone(),
        cell: submission.cell.clone(),
        turn: 1,
        holder: None,
        content_sha256: None,
        words: String::new(),
        refused: std::collections::BTreeMap::new(),
    }
}
