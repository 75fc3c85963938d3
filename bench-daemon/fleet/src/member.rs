//! The work of one bench in the fleet: it registers, follows orders, continues its jobs, and
//! takes work when it is free.

mod obey;
mod post;
mod report;
mod shared;
mod take;

use std::sync::Arc;

use futures_util::StreamExt;
use instruments_link::clock;
use serde::Serialize;

use crate::{
    error::FleetError,
    intent::Desk,
    job::{Holder, Place},
    local::{BenchState, Condition, LocalBench, Reading},
    record::{BenchAnswer, BenchRecord, Question},
    standing::{Standing, through_the_fleet},
};
use obey::Obedience;
use post::Post;
pub(crate) use shared::Shared;

/// Interval between two polls of a bench, s. It delays the start of a job by at most this time,
/// which is short compared with the minutes of a run.
const LOOK_S: f64 = 0.25;
/// Time until a failed order is repeated, s, so that a server that refuses is not queried at every
/// poll.
const AGAIN_S: f64 = 1.0;
/// Interval of telemetry of an active bench, s.
const TELEMETRY_S: f64 = 10.0;

/// An event on a bench, for the stream of events.
#[derive(Debug, Serialize)]
struct Happened<'a> {
    unix_s: f64,
    #[serde(flatten)]
    place: &'a Place,
    what: &'a str,
    state: Option<BenchState>,
    job: Option<&'a str>,
    words: &'a str,
}

/// An active bench, for the stream of telemetry.
#[derive(Debug, Serialize)]
struct Sample<'a> {
    unix_s: f64,
    #[serde(flatten)]
    place: &'a Place,
    run: Option<&'a str>,
    #[serde(flatten)]
    reading: &'a Reading,
}

/// One bench in the fleet.
pub(crate) struct Member {
    shared: Arc<Shared>,
    bench: Arc<dyn LocalBench>,
    me: Holder,
    desk: Desk,
    obedience: Arc<Obedience>,
    post: Post,
    rhythm: Rhythm,
}

/// Rare periodic tasks.
#[derive(Debug, Default)]
struct Rhythm {
    /// Time of the last telemetry, s.
    telemetry_s: f64,
    /// Time of the last check of foreign claims, s.
    claims_s: f64,
    /// Number of the oldest jobs from which one is chosen. It increases after each job that another
    /// bench claimed first.
    window: usize,
    /// Time before which no standing order is followed, s, because the server of the bench did not
    /// answer at the last attempt.
    follow_s: f64,
    /// Time before which no job is taken, s, because the bench could take none at the last
    /// attempt.
    again_s: f64,
}

impl Member {
    /// Creates a bench that has not registered yet.
    ///
    /// # Errors
    /// The folder cannot be created.
    pub(crate) fn new(
        shared: &Arc<Shared>,
        bench: &Arc<dyn LocalBench>,
    ) -> Result<Self, FleetError> {
        let place = Place::new(&shared.site, &bench.name());
        let desk = Desk::of(&shared.folder, &place.bench)?;
        let me = Holder {
            place,
            nonce: shared.nonce.clone(),
        };
        Ok(Self {
            obedience: Arc::new(Obedience::new(bench, &desk)),
            post: Post::new(shared),
            shared: shared.clone(),
            bench: bench.clone(),
            me,
            desk,
            rhythm: Rhythm::default(),
        })
    }

    /// Answers queries and stops, concurrently with the work.
    pub(crate) fn obedience(&self) -> Arc<Obedience> {
        self.obedience.clone()
    }

    /// Works until the task is aborted.
    pub(crate) async fn work(mut self) {
        let mut reported = None;
        loop {
            let trouble = self.look().await.err();
            // The connections report an unreachable broker or server; errors of a disk or a record
            // are reported here, once.
            let is_known = |error: &FleetError| {
                matches!(error, FleetError::Unreachable(_) | FleetError::Bench(_))
            };
            let news = trouble.filter(|error| !is_known(error));
            if let Some(error) = news
                .as_ref()
                .filter(|error| reported.as_ref() != Some(*error))
            {
                tracing::error!("fleet: {}: nothing is taken: {error}", self.me.place);
            }
            reported = news;
            self.shared.link.clock.sleep_s(LOOK_S).await;
        }
    }

    async fn look(&mut self) -> Result<(), FleetError> {
        if !self.shared.link.is_connected() || !self.shared.orders.is_whole() {
            return Ok(());
        }
        let followed = self.follow_seen().await;
        let condition = match self.bench.condition() {
            Ok(condition) => condition,
            // The active run and the ends of jobs are unknown.
            Err(away) => {
                let sent = self.tell(&Condition::away(&away)).await.map(drop);
                return followed.and(sent);
            }
        };
        let heard = self.hear(&condition.run).await;
        let registered = self.tell(&condition).await;
        // An error of one job does not block the others, but no new job is taken.
        self.go_on().await?;
        followed.and(heard)?;
        if !registered? || !self.shared.jobs.is_whole() {
            return Ok(());
        }
        self.return_claims().await;
        if condition.free && self.standing().lets_work() {
            self.take().await?;
        }
        Ok(())
    }

    /// Follows the last known standing orders.
    async fn follow_seen(&mut self) -> Result<(), FleetError> {
        let now_s = self.shared.link.clock.now_s();
        if now_s < self.rhythm.follow_s {
            return Ok(());
        }
        let followed = self.obedience.follow(&self.standing()).await;
        if matches!(followed, Err(FleetError::Bench(_))) {
            self.rhythm.follow_s = now_s + AGAIN_S;
        }
        followed
    }

    /// Reads the standing orders once a run is active. A stop that arrives later was issued after
    /// the run had begun.
    async fn hear(&self, run: &Option<String>) -> Result<(), FleetError> {
        if self.obedience.has_heard(run) {
            return Ok(());
        }
        self.follow_now().await?;
        self.obedience.heard(run.clone());
        Ok(())
    }

    /// Reads the standing orders from the broker, and follows them.
    async fn follow_now(&self) -> Result<Standing, FleetError> {
        let standing = self.shared.link.standing(&self.me.place).await?.value;
        self.obedience.follow(&standing).await?;
        Ok(standing)
    }

    fn standing(&self) -> Standing {
        let seen = self.shared.orders.get(&self.me.place.key());
        seen.map(|seen| seen.value).unwrap_or_default()
    }

    /// Reports the state of the bench if a report is due. Returns whether the bench is
    /// registered.
    async fn tell(&mut self, condition: &Condition) -> Result<bool, FleetError> {
        let jobs = self.obedience.jobs()?;
        let record = record(&self.shared, &self.obedience, &self.standing(), &jobs);
        let record = record.with(condition);
        let before = self.post.posted_state();
        let is_signed_on = self.post.tell(&record).await?;
        if before != self.post.posted_state() {
            let words = condition.trip.clone().or_else(|| condition.held.clone());
            let what = match condition.trip {
                Some(_) => "trip",
                None => "state",
            };
            self.happened(what, None, &words.unwrap_or_default()).await;
        }
        self.sample(condition).await;
        Ok(is_signed_on)
    }

    async fn sample(&mut self, condition: &Condition) {
        let now_s = self.shared.link.clock.now_s();
        let Some(reading) = &condition.reading else {
            return;
        };
        if now_s - self.rhythm.telemetry_s < TELEMETRY_S {
            return;
        }
        self.rhythm.telemetry_s = now_s;
        let sample = Sample {
            unix_s: clock::unix_time_s(),
            place: &self.me.place,
            run: condition.run.as_deref(),
            reading,
        };
        self.shared
            .link
            .publish("telemetry", &self.me.place, &sample)
            .await;
    }

    async fn happened(&self, what: &str, job: Option<&str>, words: &str) {
        let event = Happened {
            unix_s: clock::unix_time_s(),
            place: &self.me.place,
            what,
            state: self.post.posted_state(),
            job,
            words,
        };
        self.shared
            .link
            .publish("event", &self.me.place, &event)
            .await;
    }
}

/// Returns the record that a bench reports, with its standing orders.
fn record(
    shared: &Shared,
    obedience: &Obedience,
    standing: &Standing,
    jobs: &[String],
) -> BenchRecord {
    let bench = obedience.bench();
    let said = standing.hold.as_ref().or(standing.stop.as_ref());
    BenchRecord {
        place: Place::new(&shared.site, &bench.name()),
        held: said.map(|said| format!("{} ({})", said.why, through_the_fleet(&said.by))),
        draining: standing.drain.is_some(),
        job: jobs.first().cloned(),
        nonce: shared.nonce.clone(),
        home: shared.home.clone(),
        capabilities: bench.capabilities(),
        state: BenchState::Held,
        run: None,
        left_s: None,
        verified: None,
        lease_s: shared.lease_s,
        left: false,
    }
}

/// Answers queries to a bench until the task is aborted.
pub(crate) async fn listen(shared: Arc<Shared>, obedience: Arc<Obedience>) {
    let place = Place::new(&shared.site, &obedience.bench().name());
    loop {
        if let Ok(mut questions) = shared.link.listen(&place).await {
            while let Some(message) = questions.next().await {
                let (shared, obedience) = (shared.clone(), obedience.clone());
                // A stop must not wait for the answer to another query.
                tokio::spawn(async move { answer(&shared, &obedience, &message).await });
            }
        }
        shared.link.clock.sleep_s(LOOK_S).await;
    }
}

async fn answer(shared: &Shared, obedience: &Arc<Obedience>, message: &async_nats::Message) {
    let Ok(question) = serde_json::from_slice::<Question>(&message.payload) else {
        return;
    };
    let report = match question {
        Question::Stop(said) => Some(obedience.stop(&said).await),
        Question::Look => None,
    };
    let place = Place::new(&shared.site, &obedience.bench().name());
    let standing = shared.link.standing(&place).await.map(|found| found.value);
    let followed = match &standing {
        Ok(standing) => obedience.follow(standing).await,
        Err(error) => Err(error.clone()),
    };
    if let Err(error) = followed {
        tracing::warn!("fleet: {place}: {error}");
    }
    let jobs = match obedience.jobs() {
        Ok(jobs) => Some(jobs),
        // A bench that does not know its jobs must not report an empty list.
        Err(error) => {
            tracing::warn!("fleet: {place}: {error}");
            None
        }
    };
    let known = jobs.as_deref().unwrap_or_default();
    let record = record(shared, obedience, &standing.unwrap_or_default(), known);
    let condition = obedience.bench().condition();
    let condition = condition.unwrap_or_else(|away| Condition::away(&away));
    let answer = BenchAnswer {
        record: record.with(&condition),
        jobs,
        report,
    };
    shared.link.answer(message, &answer).await;
}
