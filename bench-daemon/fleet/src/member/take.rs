//! Takes work from the queue: claim, check, start. Abandoned claims are put back.

use sha2::{Digest, Sha256};

use super::{Member, shared::aside};
use crate::{
    error::FleetError,
    intent::Intent,
    job::{Job, JobState},
    link::{Stored, Swap, hex},
    local::{LocalBench, NotTaken},
    watched::Seen,
};

/// Maximum number of jobs from which one is chosen: the number of benches of a large fleet.
const MOST_WINDOW: usize = 256;

impl Member {
    /// Takes a job if one fits.
    pub(super) async fn take(&mut self) -> Result<(), FleetError> {
        if self.shared.link.clock.now_s() < self.rhythm.again_s {
            return Ok(());
        }
        let Some(seen) = self.choose() else {
            return Ok(());
        };
        let claimed = seen.value.claimed(&self.me);
        let jobs = &self.shared.link.jobs;
        let Swap::Written(revision) = jobs.swap(&claimed.job, &claimed, seen.revision).await?
        else {
            // Another bench was faster: choose from more jobs next time.
            self.rhythm.window = (2 * self.rhythm.window).clamp(2, MOST_WINDOW);
            return Ok(());
        };
        self.rhythm.window = 1;
        let claimed = Stored {
            revision,
            value: claimed,
            broker_unix_s: seen.broker_unix_s,
        };
        self.prepare(claimed).await
    }

    /// Returns one of the oldest jobs that fit; `None` while this bench has a job.
    fn choose(&self) -> Option<Seen<Job>> {
        let can = self.bench.capabilities();
        let place = &self.me.place;
        let window = self.rhythm.window.max(1);
        let mut fit = self.shared.jobs.with(|jobs| {
            if jobs.values().any(|seen| seen.value.is_at(place)) {
                return Vec::new();
            }
            let queued = jobs
                .values()
                .filter(|seen| seen.value.state == JobState::Queued);
            let fit = queued.filter(|seen| seen.value.unfit(place, &can).is_none());
            fit.take(window).cloned().collect()
        });
        if !self.desk.all().ok()?.is_empty() || fit.is_empty() {
            return None;
        }
        // No other bench takes a job that is bound to this one, and its order was planned.
        let index = match fit[0].value.needs.bench {
            Some(_) => 0,
            None => chance(fit.len()),
        };
        Some(fit.swap_remove(index))
    }

    async fn prepare(&mut self, claimed: Stored<Job>) -> Result<(), FleetError> {
        let job = &claimed.value;
        let text = match self.text(job).await? {
            Ok(text) => text,
            Err(words) => return self.refuse(&claimed, &words).await,
        };
        let intent = self.intent(job, text);
        let order = intent.order();
        let check = move |bench: &dyn LocalBench| bench.check(&order);
        match aside(&self.bench, check).await? {
            Ok(()) => {}
            Err(NotTaken::Unfit(words)) => return self.refuse(&claimed, &words).await,
            Err(NotTaken::NotNow(words)) => {
                self.rest();
                let reason = format!("{} takes nothing now: {words}", self.me.place);
                self.put_back(&claimed, reason).await?;
                return Err(FleetError::File(words));
            }
        }
        // Check for orders that were given in the meantime, and for another process with this name.
        let standing = self.shared.link.standing(&self.me.place).await?;
        let is_free = self.bench.condition().is_ok_and(|now| now.free);
        let is_free = is_free && standing.value.lets_work();
        if !is_free || !self.post.prove().await? {
            let words = format!("{} is not free any more", self.me.place);
            return self.put_back(&claimed, words).await;
        }
        self.start(&claimed, &intent).await
    }

    /// Returns the text of the experiment, or a description of what is wrong with it.
    async fn text(&self, job: &Job) -> Result<Result<String, String>, FleetError> {
        let found = match self.shared.link.texts.get(&job.text_sha256).await {
            Ok(found) => found.map(|found: Stored<String>| found.value),
            Err(FleetError::Record { reason, .. }) => {
                return Ok(Err(format!("its text cannot be read: {reason}")));
            }
            Err(error) => return Err(error),
        };
        let Some(text) = found else {
            return Ok(Err("its text is not there".to_owned()));
        };
        let met = hex(&Sha256::digest(text.as_bytes()));
        Ok(match met == job.text_sha256 {
            true => Ok(text),
            false => Err(format!("its text is another one, of the SHA-256 {met}")),
        })
    }

    /// Takes no job for the lease time, because the bench could take none now.
    pub(super) fn rest(&mut self) {
        self.rhythm.again_s = self.shared.link.clock.now_s() + self.shared.lease_s;
    }

    fn intent(&self, job: &Job, text: String) -> Intent {
        Intent {
            job: job.job.clone(),
            turn: job.turn,
            run: job.run_name(),
            name: job.name.clone(),
            seed: job.seed,
            by: job.asked.by.clone(),
            text,
            begun: false,
        }
    }

    /// The check of this bench has refused a job: another bench may take it.
    async fn refuse(&self, claimed: &Stored<Job>, words: &str) -> Result<(), FleetError> {
        let place = self.me.place.to_string();
        let mut next = claimed
            .value
            .returned(format!("{place} does not take it: {words}"));
        next.refused.insert(place, words.to_owned());
        let jobs = &self.shared.link.jobs;
        jobs.swap(&next.job, &next, claimed.revision).await?;
        self.happened("refused", Some(&next.job), words).await;
        Ok(())
    }

    /// Puts abandoned claims back: those of this bench that it does not work on, and those of
    /// others that have stood unchanged for the lease time.
    pub(super) async fn return_claims(&mut self) {
        let now_s = self.shared.link.clock.now_s();
        let lease_s = self.shared.lease_s;
        if now_s - self.rhythm.claims_s < lease_s / 4.0 {
            return;
        }
        // Random delay, so that benches do not all act at once.
        self.rhythm.claims_s = now_s + lease_s / 8.0 * chance(100) as f64 / 100.0;
        let place = &self.me.place;
        let left = |seen: &Seen<Job>| {
            let is_claimed = seen.value.state == JobState::Claimed;
            is_claimed && (seen.value.is_at(place) || now_s - seen.since_s > lease_s)
        };
        let claims: Vec<Seen<Job>> = self.shared.jobs.with(|jobs| {
            let claims = jobs.values().filter(|seen| left(seen));
            claims.cloned().collect()
        });
        for seen in claims {
            let at = seen.value.holder.as_ref().map(|at| at.place.to_string());
            let words = format!("{} did not go on with it", at.unwrap_or_default());
            let found = Stored {
                revision: seen.revision,
                value: seen.value,
                broker_unix_s: seen.broker_unix_s,
            };
            if let Err(error) = self.put_back(&found, words).await {
                tracing::debug!("fleet: {error}");
            }
        }
    }
}

/// Returns a random number below another one.
fn chance(below: usize) -> usize {
    let mut bytes = [0_u8; 8];
    // Without random numbers, use the first one.
    let _ = getrandom::fill(&mut bytes);
    (u64::from_le_bytes(bytes) % below.max(1) as u64) as usize
}
