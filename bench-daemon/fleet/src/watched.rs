//! A copy of a bucket that follows its changes. A copy may be old: whoever acts on it writes with the
//! revision that it has seen.

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

/// Time between two attempts to follow, s.
const RETRY_S: f64 = 0.5;

/// A record as it was seen.
#[derive(Debug, Clone)]
pub(crate) struct Seen<T> {
    /// Its revision.
    pub(crate) revision: u64,
    /// The record.
    pub(crate) value: T,
    /// Since when this revision was seen, s by the clock of the link.
    pub(crate) since_s: f64,
    /// When the broker took it by its calendar, s since 1970. For showing only.
    pub(crate) broker_unix_s: f64,
}

type Records<T> = BTreeMap<String, Seen<T>>;

/// Records of a bucket as they were seen.
#[derive(Debug)]
pub(crate) struct Watched<T> {
    open: Mutex<Copy<T>>,
    /// Records that are worth keeping.
    keep: fn(&T) -> bool,
}

#[derive(Debug)]
struct Copy<T> {
    records: Records<T>,
    /// Every record was seen once.
    whole: bool,
}

impl<T: DeserializeOwned + Clone + Send + 'static> Watched<T> {
    /// Nothing is known yet; of what comes these are kept.
    pub(crate) fn keeping(keep: fn(&T) -> bool) -> Arc<Self> {
        let copy = Copy {
            records: Records::new(),
            whole: false,
        };
        Arc::new(Self {
            open: Mutex::new(copy),
            keep,
        })
    }

    fn open(&self) -> MutexGuard<'_, Copy<T>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether every record was seen.
    pub(crate) fn is_whole(&self) -> bool {
        self.open().whole
    }

    /// Looks at the records; what it does must be short.
    pub(crate) fn with<A>(&self, look: impl FnOnce(&Records<T>) -> A) -> A {
        look(&self.open().records)
    }

    /// One record.
    pub(crate) fn get(&self, key: &str) -> Option<Seen<T>> {
        self.open().records.get(key).cloned()
    }

    /// Follows a bucket for ever; after each new connection from the beginning.
    pub(crate) async fn follow(self: Arc<Self>, link: Arc<Link>, bucket: Bucket) {
        loop {
            if let Err(error) = self.follow_once(&link, &bucket).await {
                tracing::debug!("fleet: the copy is not followed: {error}");
            }
            link.clock.sleep_s(RETRY_S).await;
        }
    }

    async fn follow_once(&self, link: &Link, bucket: &Bucket) -> Result<(), FleetError> {
        let mut connections = link.connections();
        connections.mark_unchanged();
        let mut entries = bucket.watch().await?;
        // Until every record has come they are gathered beside, so that one that is gone goes.
        let mut beside = Some(Records::new());
        // They come in the order of their revisions. The broker's own count of what is left is not
        // exact where a record changes meanwhile.
        let latest = bucket.latest().await?;
        if latest == 0 {
            self.replace(beside.take().unwrap_or_default());
        }
        loop {
            let entry = tokio::select! {
                entry = entries.next() => entry,
                _ = connections.changed() => return Ok(()),
            };
            let Some(entry) = entry else { return Ok(()) };
            let entry = entry.map_err(|error| FleetError::unreachable(&error))?;
            let now_s = link.clock.now_s();
            match &mut beside {
                Some(records) => self.take(records, &entry, now_s),
                None => self.take(&mut self.open().records, &entry, now_s),
            }
            if entry.revision >= latest
                && let Some(records) = beside.take()
            {
                self.replace(records);
            }
        }
    }

    /// All records at once. What was seen with the same revision before was seen since then.
    fn replace(&self, mut records: Records<T>) {
        let mut open = self.open();
        for (key, seen) in &mut records {
            let before = open.records.get(key);
            if let Some(before) = before.filter(|before| before.revision == seen.revision) {
                seen.since_s = before.since_s;
            }
        }
        (open.records, open.whole) = (records, true);
    }

    fn take(&self, records: &mut Records<T>, entry: &kv::Entry, now_s: f64) {
        let put = entry.operation == kv::Operation::Put;
        match put.then(|| stored::<T>(entry)) {
            Some(Ok(found)) if (self.keep)(&found.value) => {
                let seen = Seen {
                    revision: found.revision,
                    value: found.value,
                    since_s: now_s,
                    broker_unix_s: found.broker_unix_s,
                };
                records.insert(entry.key.clone(), seen);
            }
            Some(Err(error)) => {
                tracing::warn!("fleet: {error}");
                // What stood there before is no longer so.
                records.remove(&entry.key);
            }
            _ => drop(records.remove(&entry.key)),
        }
    }
}
