//! A copy of a bucket that follows its changes. A copy may be stale: a writer uses the revision
//! that it has seen.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use async_nats::jetstream::kv;
use futures_util::StreamExt;
use serde::de::DeserializeOwned;

use crate::{
    error::FleetError,
    link::{Bucket, Link, stored},
};

/// Interval between two attempts to follow, s.
const RETRY_S: f64 = 0.5;

/// A record and the time when it was received.
#[derive(Debug, Clone)]
pub(crate) struct Seen<T> {
    /// Its revision.
    pub(crate) revision: u64,
    /// The record.
    pub(crate) value: T,
    /// Time when this revision was first received, s by the clock of the link.
    pub(crate) since_s: f64,
    /// When the broker stored it by its calendar, s since 1970. For display only.
    pub(crate) broker_unix_s: f64,
}

type Records<T> = BTreeMap<String, Seen<T>>;

/// Received records of a bucket.
#[derive(Debug)]
pub(crate) struct Watched<T> {
    open: Mutex<Copy<T>>,
    /// Returns the class of a record of which only the class is kept, or `None` for a record that
    /// is kept.
    class: fn(&T) -> Option<usize>,
    /// The age of a record at first sight follows from the broker's calendar.
    is_dated: bool,
}

#[derive(Debug)]
struct Copy<T> {
    kept: Kept<T>,
    /// Whether every record has been received once.
    whole: bool,
}

/// The known content of a bucket.
#[derive(Debug)]
pub(crate) struct Kept<T> {
    /// Records.
    pub(crate) records: Records<T>,
    /// Classes of the records of which only the class is kept.
    pub(crate) classes: BTreeMap<String, usize>,
}

impl<T> Default for Kept<T> {
    fn default() -> Self {
        Self {
            records: Records::new(),
            classes: BTreeMap::new(),
        }
    }
}

impl<T: DeserializeOwned + Clone + Send + 'static> Watched<T> {
    fn of(class: fn(&T) -> Option<usize>) -> Self {
        let (kept, whole) = (Kept::default(), false);
        Self {
            open: Mutex::new(Copy { kept, whole }),
            class,
            is_dated: false,
        }
    }

    /// Keeps every record.
    pub(crate) fn keeping_all() -> Arc<Self> {
        Arc::new(Self::of(|_| None))
    }

    /// Creates a copy that keeps every record. The age of a record at first sight follows from
    /// the broker's calendar: for display only.
    pub(crate) fn dated() -> Arc<Self> {
        Arc::new(Self {
            is_dated: true,
            ..Self::of(|_| None)
        })
    }

    /// Keeps only the class of a record that has one.
    pub(crate) fn sorting(class: fn(&T) -> Option<usize>) -> Arc<Self> {
        Arc::new(Self::of(class))
    }

    /// Keeps every record; records of another copy keep the time of their first sight.
    pub(crate) fn after(other: &Self) -> Arc<Self> {
        let watched = Self::of(|_| None);
        watched.open().kept.records = other.open().kept.records.clone();
        Arc::new(watched)
    }

    fn open(&self) -> MutexGuard<'_, Copy<T>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether every record was received.
    pub(crate) fn is_whole(&self) -> bool {
        self.open().whole
    }

    /// Calls a function with the records; it must be short.
    pub(crate) fn with<A>(&self, look: impl FnOnce(&Records<T>) -> A) -> A {
        self.with_all(|kept| look(&kept.records))
    }

    /// Calls a function with the whole content; it must be short.
    pub(crate) fn with_all<A>(&self, look: impl FnOnce(&Kept<T>) -> A) -> A {
        look(&self.open().kept)
    }

    /// Returns one record.
    pub(crate) fn get(&self, key: &str) -> Option<Seen<T>> {
        self.open().kept.records.get(key).cloned()
    }

    /// Follows a bucket until the task is aborted; starts from the beginning after each new
    /// connection.
    pub(crate) async fn follow(self: Arc<Self>, link: Arc<Link>, bucket: Bucket) {
        loop {
            if let Err(error) = self.follow_once(&link, &bucket, false).await {
                tracing::debug!("fleet: the copy is not followed: {error}");
            }
            link.clock.sleep_s(RETRY_S).await;
        }
    }

    /// Reads every record once.
    ///
    /// # Errors
    /// The broker does not answer.
    pub(crate) async fn read(&self, link: &Link, bucket: &Bucket) -> Result<(), FleetError> {
        self.follow_once(link, bucket, true).await
    }

    async fn follow_once(
        &self,
        link: &Link,
        bucket: &Bucket,
        ends: bool,
    ) -> Result<(), FleetError> {
        let mut connections = link.connections();
        connections.mark_unchanged();
        let mut entries = bucket.watch().await?;
        // Collect the records separately until all have arrived, so that deleted ones disappear.
        let mut beside = Some(Kept::default());
        // Records arrive in the order of their revisions. The broker's own count of remaining
        // records is inexact if a record changes meanwhile.
        let latest = bucket.latest().await?;
        if latest == 0 {
            self.replace(beside.take().unwrap_or_default());
        }
        while beside.is_some() || !ends {
            let entry = tokio::select! {
                entry = entries.next() => entry,
                _ = connections.changed() => None,
            };
            let Some(entry) = entry else {
                return match ends {
                    true => Err(FleetError::unreachable(&"the connection was cut")),
                    false => Ok(()),
                };
            };
            let entry = entry.map_err(|error| FleetError::unreachable(&error))?;
            let now_s = link.clock.now_s();
            match &mut beside {
                Some(kept) => self.take(kept, &entry, now_s),
                None => self.take(&mut self.open().kept, &entry, now_s),
            }
            if entry.revision >= latest
                && let Some(kept) = beside.take()
            {
                self.replace(kept);
            }
        }
        Ok(())
    }

    /// Replaces all records at once. A record whose revision was seen before keeps the time of
    /// its first sight.
    fn replace(&self, mut kept: Kept<T>) {
        let mut open = self.open();
        let is_first = self.is_dated && !open.whole;
        let dates = kept.records.values().map(|seen| seen.broker_unix_s);
        let newest_unix_s = dates.fold(f64::NEG_INFINITY, f64::max);
        for (key, seen) in &mut kept.records {
            let before = open.kept.records.get(key);
            if let Some(before) = before.filter(|before| before.revision == seen.revision) {
                seen.since_s = before.since_s;
            } else if is_first {
                seen.since_s -= newest_unix_s - seen.broker_unix_s;
            }
        }
        (open.kept, open.whole) = (kept, true);
    }

    fn take(&self, kept: &mut Kept<T>, entry: &kv::Entry, now_s: f64) {
        let put = entry.operation == kv::Operation::Put;
        let found = put.then(|| stored::<T>(entry)).transpose();
        let found = match found {
            Ok(found) => found,
            Err(error) => {
                tracing::warn!("fleet: {error}");
                // The earlier value is no longer valid.
                None
            }
        };
        kept.records.remove(&entry.key);
        kept.classes.remove(&entry.key);
        let Some(found) = found else { return };
        let key = entry.key.clone();
        if let Some(class) = (self.class)(&found.value) {
            kept.classes.insert(key, class);
            return;
        }
        let seen = Seen {
            revision: found.revision,
            value: found.value,
            since_s: now_s,
            broker_unix_s: found.broker_unix_s,
        };
        kept.records.insert(key, seen);
    }
}
