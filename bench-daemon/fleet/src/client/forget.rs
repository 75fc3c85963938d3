//! Removes finished and obsolete records.

use std::collections::BTreeSet;

use serde::de::{DeserializeOwned, IgnoredAny};

use super::{Client, LOOK, unknown_bench};
use crate::{
    error::FleetError,
    job::{Job, Place, is_plain},
    link::{Bucket, Swap},
    record::{BenchAnswer, BenchRecord, Question},
    watched::{Seen, Watched},
};

/// Minimum ages of removed records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ages {
    /// Minimum time since the end of a job, s.
    pub jobs_s: f64,
    /// Minimum time since the submission of a text without jobs, s. A text is stored before its
    /// jobs.
    pub texts_s: f64,
}

/// Numbers of removed records.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Forgotten {
    /// Jobs.
    pub jobs: usize,
    /// Texts of experiments.
    pub texts: usize,
}

impl Client {
    /// Removes the records of ended jobs, and texts without jobs.
    ///
    /// # Errors
    /// The broker does not answer.
    pub async fn forget(&self, ages: Ages) -> Result<Forgotten, FleetError> {
        // List the texts first: a text that a job references meanwhile is written again and has
        // another revision.
        let texts = self.whole::<IgnoredAny>(&self.link.texts).await?;
        let jobs = self.whole::<Job>(&self.link.jobs).await?;
        let benches = self.whole::<BenchRecord>(&self.link.benches).await?;
        // Heartbeats show the broker's calendar time; ages use no other clock.
        let newest = [newest(&texts), newest(&jobs), newest(&benches)];
        let now_s = newest.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let is_old =
            |job: &Seen<Job>| job.value.state.is_over() && now_s - job.broker_unix_s >= ages.jobs_s;
        let kept = jobs.with(|jobs| {
            let kept = jobs.values().filter(|seen| !is_old(seen));
            kept.map(|seen| seen.value.text_sha256.clone())
                .collect::<BTreeSet<_>>()
        });
        let is_unused = |key: &str, text: &Seen<IgnoredAny>| {
            !kept.contains(key) && now_s - text.broker_unix_s >= ages.texts_s
        };
        Ok(Forgotten {
            jobs: self
                .forget_all(&self.link.jobs, &jobs, |_, seen| is_old(seen))
                .await?,
            texts: self.forget_all(&self.link.texts, &texts, is_unused).await?,
        })
    }

    async fn forget_all<T>(
        &self,
        bucket: &Bucket,
        records: &Watched<T>,
        is_old: impl Fn(&str, &Seen<T>) -> bool,
    ) -> Result<usize, FleetError>
    where
        T: DeserializeOwned + Clone + Send + 'static,
    {
        let old: Vec<_> = records.with(|records| {
            let old = records.iter().filter(|(key, seen)| is_old(key, seen));
            old.map(|(key, seen)| (key.clone(), seen.revision))
                .collect()
        });
        let mut count = 0;
        for (key, revision) in &old {
            let swap = bucket.forget(key, *revision).await?;
            count += usize::from(swap != Swap::Lost);
        }
        Ok(count)
    }

    /// Removes a bench that is gone from the fleet. Its standing orders are kept: if it returns, it
    /// follows a stop that it has not received.
    ///
    /// # Errors
    /// There is no such bench, it still answers, or the broker does not answer.
    pub async fn forget_bench(&self, place: &Place) -> Result<(), FleetError> {
        let is_named = is_plain(&place.site) && is_plain(&place.bench);
        let found = match is_named {
            true => self.link.benches.get::<BenchRecord>(&place.key()).await?,
            false => None,
        };
        let found = found.ok_or_else(|| unknown_bench(place))?;
        let answer: Option<BenchAnswer> = self.link.ask(place, &Question::Look, LOOK).await;
        let swap = match answer {
            Some(_) => Swap::Lost,
            None => {
                self.link
                    .benches
                    .forget(&place.key(), found.revision)
                    .await?
            }
        };
        match swap {
            Swap::Written(_) => Ok(()),
            Swap::Lost => Err(FleetError::Conflict(format!(
                "{place}: expected a bench that is gone, found one that is heard: end its server, or \
                take the bench out of its file, first"
            ))),
        }
    }
}

/// Returns the time at which the broker stored the latest of these records, s since 1970 by its
/// calendar.
fn newest<T: DeserializeOwned + Clone + Send + 'static>(records: &Watched<T>) -> f64 {
    records.with(|records| {
        let dates = records.values().map(|seen| seen.broker_unix_s);
        dates.fold(f64::NEG_INFINITY, f64::max)
    })
}
