//! The heartbeat of a bench. Only one process at a time is registered under the name of a bench.

use std::sync::Arc;

use super::shared::Shared;
use crate::{
    error::FleetError,
    link::{Stored, Swap},
    local::BenchState,
    record::BenchRecord,
};

/// Number of heartbeats within the lease: two may be lost.
const BEATS: f64 = 3.0;
/// Minimum interval between two reports of a bench that changes constantly, s.
const CHANGE_S: f64 = 0.5;

/// The record of a bench in the list of the fleet.
pub(super) struct Post {
    shared: Arc<Shared>,
    /// Revision of its own record, once registered.
    revision: Option<u64>,
    reported: Option<BenchRecord>,
    posted_s: f64,
    rival: Option<Rival>,
    /// Whether another process has taken the name: the data folder is then not exclusive to this
    /// process.
    is_displaced: bool,
}

/// Another process with the same name.
struct Rival {
    revision: u64,
    since_s: f64,
}

impl Post {
    /// Creates a heartbeat that is not registered yet.
    pub(super) fn new(shared: &Arc<Shared>) -> Self {
        Self {
            shared: shared.clone(),
            revision: None,
            reported: None,
            posted_s: f64::NEG_INFINITY,
            rival: None,
            is_displaced: false,
        }
    }

    /// Returns the state that was reported last.
    pub(super) fn posted_state(&self) -> Option<BenchState> {
        self.reported.as_ref().map(|record| record.state)
    }

    /// Reports the state of the bench if a report is due. Returns whether the bench is
    /// registered.
    ///
    /// # Errors
    /// The broker does not answer.
    pub(super) async fn tell(&mut self, record: &BenchRecord) -> Result<bool, FleetError> {
        let now_s = self.shared.link.clock.now_s();
        let age_s = now_s - self.posted_s;
        let is_due = age_s >= self.shared.lease_s / BEATS
            || (age_s >= CHANGE_S
                && self
                    .reported
                    .as_ref()
                    .is_none_or(|last| changed(last, record)));
        match self.revision {
            Some(_) if !is_due => Ok(true),
            Some(revision) => self.write(record, revision).await,
            None => self.sign_on(record).await,
        }
    }

    /// Writes a heartbeat, which shows that this process still owns the bench.
    ///
    /// # Errors
    /// As [`Self::tell`].
    pub(super) async fn prove(&mut self) -> Result<bool, FleetError> {
        match (self.reported.clone(), self.revision) {
            (Some(record), Some(revision)) => self.write(&record, revision).await,
            _ => Ok(false),
        }
    }

    async fn write(&mut self, record: &BenchRecord, revision: u64) -> Result<bool, FleetError> {
        let benches = &self.shared.link.benches;
        let key = record.place.key();
        if let Swap::Written(revision) = benches.swap(&key, record, revision).await? {
            self.signed_on(record, revision);
            return Ok(true);
        }
        let found = benches.get::<BenchRecord>(&key).await?;
        let is_forgotten = found.is_none();
        if let Some(found) = found.filter(|found| found.value.nonce == self.shared.nonce) {
            // The answer to an earlier heartbeat was lost.
            self.revision = Some(found.revision);
            return Ok(true);
        }
        self.revision = None;
        if is_forgotten {
            tracing::warn!(
                "fleet: {}: it was forgotten: it signs on again",
                record.place
            );
            return Ok(false);
        }
        tracing::error!(
            "fleet: {}: another process has signed on under this name: nothing more is taken",
            record.place
        );
        self.is_displaced = true;
        Ok(false)
    }

    fn signed_on(&mut self, record: &BenchRecord, revision: u64) {
        if self.revision.is_none() {
            tracing::info!("fleet: {} is signed on", record.place);
        }
        self.revision = Some(revision);
        self.reported = Some(record.clone());
        self.posted_s = self.shared.link.clock.now_s();
        self.rival = None;
    }

    async fn sign_on(&mut self, record: &BenchRecord) -> Result<bool, FleetError> {
        let key = record.place.key();
        let found = self.shared.link.benches.get::<BenchRecord>(&key).await?;
        match found {
            Some(found) if !self.may_follow(&found) => Ok(false),
            found => {
                let revision = found.map_or(0, |found| found.revision);
                self.write(record, revision).await
            }
        }
    }

    /// Returns whether the registered process has ended: it has signed off, it had this data
    /// folder, or its heartbeat has not changed for the lease time.
    fn may_follow(&mut self, found: &Stored<BenchRecord>) -> bool {
        let (shared, other) = (&self.shared, &found.value);
        let had_this_folder = other.home == shared.home && !self.is_displaced;
        if other.left || other.nonce == shared.nonce || had_this_folder {
            return true;
        }
        let now_s = shared.link.clock.now_s();
        let rival = self.rival.as_ref();
        let since_s = rival.filter(|rival| rival.revision == found.revision);
        let Some(since_s) = since_s.map(|rival| rival.since_s) else {
            if self.rival.is_some() {
                tracing::error!(
                    "fleet: {}: expected a name that no other daemon has, found one that is signed \
                    on: nothing is taken; give this site or bench another name",
                    other.place
                );
            }
            self.rival = Some(Rival {
                revision: found.revision,
                since_s: now_s,
            });
            return false;
        };
        now_s - since_s > shared.lease_s.max(other.lease_s)
    }
}

/// Returns whether a change must be reported at once; passing time alone does not count.
fn changed(reported: &BenchRecord, now: &BenchRecord) -> bool {
    let timeless = |record: &BenchRecord| BenchRecord {
        left_s: None,
        ..record.clone()
    };
    timeless(reported) != timeless(now)
}
