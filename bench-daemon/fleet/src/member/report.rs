//! Continues the jobs of a bench, also after a restart, and reports their ends. The intents on
//! this disk list the jobs; the broker's record decides whether a run may begin.

use super::{Member, shared::aside};
use crate::{
    error::FleetError,
    intent::Intent,
    job::{Job, JobState},
    link::{Stored, Swap, Write},
    local::{End, Fate, NotDone},
};

impl Member {
    /// Checks every job that the bench has.
    pub(super) async fn go_on(&mut self) -> Result<(), FleetError> {
        for intent in self.desk.all()? {
            let run = intent.run.clone();
            match aside(&self.bench, move |bench| bench.fate(&run)).await?? {
                Fate::Going if self.is_put_back(&intent).await? => self.withdraw(&intent).await?,
                Fate::Going => self.keep_begun(&intent).await?,
                Fate::Ended(end) => {
                    self.keep_begun(&intent).await?;
                    self.report(&intent, &end).await?;
                }
                Fate::Unknown if intent.begun => {
                    let words = "it was taken out of the queue of its bench".to_owned();
                    let end = End {
                        finished: false,
                        words,
                        content_sha256: None,
                    };
                    self.report(&intent, &end).await?;
                }
                Fate::Unknown => self.begin_or_drop(&intent).await?,
            }
        }
        Ok(())
    }

    /// Records that a run has begun, if that was not known yet: the reply to its begin was lost, or
    /// the process that began it has died.
    async fn keep_begun(&self, intent: &Intent) -> Result<(), FleetError> {
        if intent.begun {
            return Ok(());
        }
        self.mark_begun(intent)?;
        self.note_begin(intent, "begun").await
    }

    fn mark_begun(&self, intent: &Intent) -> Result<(), FleetError> {
        self.desk.keep(&Intent {
            begun: true,
            ..intent.clone()
        })
    }

    /// Handles a prepared run that has not begun: it begins only if the broker's record assigns
    /// it to this bench.
    async fn begin_or_drop(&mut self, intent: &Intent) -> Result<(), FleetError> {
        let found = self.shared.link.job(&intent.job).await?;
        let ours = found.filter(|found| self.is_ours(&found.value, intent));
        match ours {
            Some(found) if found.value.state == JobState::Started => self.begin(intent).await,
            // The process that claimed it died before it could start it.
            Some(found) if found.value.state == JobState::Claimed => {
                let words = format!("{} died before it began", self.me.place);
                self.give_back(intent, &found, words).await
            }
            _ => {
                self.desk.drop(&intent.job);
                Ok(())
            }
        }
    }

    /// Begins a run that the broker lists as started. Queries the present record, because the known
    /// one may be old.
    pub(super) async fn begin(&mut self, intent: &Intent) -> Result<(), FleetError> {
        let standing = self.follow_now().await?;
        if standing.hold.is_some() || standing.stop.is_some() {
            let words = format!("{} was held before it began", self.me.place);
            return self.not_begun(intent, words).await;
        }
        let order = intent.order();
        match aside(&self.bench, move |bench| bench.begin(&order)).await? {
            Ok(()) => {
                let marked = self.mark_begun(intent);
                self.note_begin(intent, "begun").await?;
                marked?;
                self.happened("started", Some(&intent.job), &intent.run)
                    .await;
                Ok(())
            }
            // Query its fate before beginning it again.
            Err(NotDone::Away(away)) => Err(away.into()),
            Err(NotDone::Refused(words)) => {
                self.note_begin(intent, &words).await?;
                self.rest();
                let words = format!("it did not begin at {}: {words}", self.me.place);
                self.not_begun(intent, words).await
            }
        }
    }

    async fn note_begin(&self, intent: &Intent, outcome: &str) -> Result<(), FleetError> {
        let by = intent.by.clone();
        let what = format!("fleet begin {} as {}", intent.job, intent.run);
        let (entry, outcome) = (format!("{by}: {what}: {outcome}"), outcome.to_owned());
        let noted = aside(&self.bench, move |bench| bench.audit(&by, &what, &outcome)).await?;
        if let Err(away) = noted {
            // The run is not repeated only because its record is missing.
            tracing::error!("the audit trail lacks an entry ({away}): {entry}");
        }
        Ok(())
    }

    /// Puts a started job whose run has not begun back into the queue. Only this bench knows that
    /// nothing has begun.
    async fn not_begun(&self, intent: &Intent, words: String) -> Result<(), FleetError> {
        let found = self.shared.link.job(&intent.job).await?;
        match found.filter(|found| self.is_ours(&found.value, intent)) {
            Some(found) => self.give_back(intent, &found, words).await,
            None => {
                self.desk.drop(&intent.job);
                Ok(())
            }
        }
    }

    /// Puts a job that has not begun back into the queue.
    async fn give_back(
        &self,
        intent: &Intent,
        found: &Stored<Job>,
        words: String,
    ) -> Result<(), FleetError> {
        self.put_back(found, words).await?;
        self.desk.drop(&intent.job);
        Ok(())
    }

    /// Returns whether a person has put a job back while it waits at this bench.
    async fn is_put_back(&self, intent: &Intent) -> Result<bool, FleetError> {
        let seen = self.shared.jobs.get(&intent.job);
        if seen.is_none_or(|seen| seen.value.turn == intent.turn) {
            return Ok(false);
        }
        let found = self.shared.link.job(&intent.job).await?;
        Ok(found.is_some_and(|found| found.value.turn != intent.turn))
    }

    /// Removes a run from the queue of the bench if a person has put its job back. An active run
    /// continues.
    async fn withdraw(&self, intent: &Intent) -> Result<(), FleetError> {
        let (run, by) = (intent.run.clone(), intent.by.clone());
        if aside(&self.bench, move |bench| bench.withdraw(&run, &by)).await?? {
            self.note_begin(intent, "withdrawn: its job was put back")
                .await?;
            self.desk.drop(&intent.job);
        }
        Ok(())
    }

    fn is_ours(&self, job: &Job, intent: &Intent) -> bool {
        let holder = job.holder.as_ref();
        job.turn == intent.turn && holder.is_some_and(|holder| holder.place == self.me.place)
    }

    /// Records the end of a run; the intent stays until the record is written.
    async fn report(&self, intent: &Intent, end: &End) -> Result<(), FleetError> {
        let found = self.shared.link.job(&intent.job).await?;
        let Some(found) = found else {
            self.desk.drop(&intent.job);
            return Ok(());
        };
        if !self.is_ours(&found.value, intent) {
            return self.report_conflict(intent, &found, end).await;
        }
        let (state, job) = (found.value.state, &intent.job);
        if state == JobState::Started {
            let next = found.value.over(end);
            let swap = self.shared.link.jobs.swap(job, &next, found.revision);
            if swap.await? == Swap::Lost {
                return Ok(());
            }
            let what = if end.finished { "done" } else { "failed" };
            self.happened(what, Some(job), &end.words).await;
        }
        self.desk.drop(job);
        Ok(())
    }

    /// Reports a conflict: a person has put the job back, but this bench has run it.
    async fn report_conflict(
        &self,
        intent: &Intent,
        found: &Stored<Job>,
        end: &End,
    ) -> Result<(), FleetError> {
        let words = format!(
            "{} ran it too, as {} ({}): it was put back while that bench was not heard",
            self.me.place, intent.run, end.words
        );
        tracing::error!("fleet: {}: {words}", intent.job);
        let next = Job {
            words: words.clone(),
            ..found.value.clone()
        };
        let jobs = &self.shared.link.jobs;
        if jobs.swap(&intent.job, &next, found.revision).await? == Swap::Lost {
            return Ok(());
        }
        self.happened("conflict", Some(&intent.job), &words).await;
        self.desk.drop(&intent.job);
        Ok(())
    }

    /// Puts a claim back into the queue. If another writer was faster, its record stands.
    pub(super) async fn put_back(
        &self,
        found: &Stored<Job>,
        words: String,
    ) -> Result<(), FleetError> {
        let (job, next) = (&found.value.job, found.value.returned(words));
        let jobs = &self.shared.link.jobs;
        jobs.swap(job, &next, found.revision).await.map(drop)
    }

    /// Starts a claimed job, once the intent is on disk. Waits until the broker's reply is known:
    /// a run must not begin while the outcome is in doubt.
    pub(super) async fn start(
        &mut self,
        claimed: &Stored<Job>,
        intent: &Intent,
    ) -> Result<(), FleetError> {
        if let Err(error) = self.desk.keep(intent) {
            self.rest();
            let words = format!("{} takes nothing now: {error}", self.me.place);
            self.give_back(intent, claimed, words).await?;
            return Err(error);
        }
        let write = Write {
            bucket: &self.shared.link.jobs,
            key: &intent.job,
            value: &claimed.value.started(),
            revision: claimed.revision,
        };
        let (me, turn) = (self.me.clone(), intent.turn);
        let mine = |job: &Job| {
            let started = job.state == JobState::Started && job.turn == turn;
            started && job.holder.as_ref() == Some(&me)
        };
        match self.shared.link.swap_surely(write, mine).await {
            Swap::Written(_) => self.begin(intent).await,
            Swap::Lost => {
                self.desk.drop(&intent.job);
                Ok(())
            }
        }
    }
}
