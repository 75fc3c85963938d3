//! The whole fleet from the view of a daemon. A daemon receives heartbeats of all benches, and jobs
//! that are over, only while a user watches the fleet. Otherwise heartbeat traffic would grow
//! quadratically, because there are as many daemons as benches.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use crate::{
    client::Looking,
    error::FleetError,
    job::Job,
    link::Link,
    view::{Seer, Tally},
    watched::Watched,
};

/// Time without a request after which the fleet is no longer followed, s. The page sends a
/// request every few seconds.
const IDLE_S: f64 = 60.0;
/// Maximum time that the first request waits for the records, s.
const PATIENCE_S: f64 = 5.0;
/// Interval between two counts, s: the scrape interval of Prometheus in the example.
const COUNT_S: f64 = 15.0;
/// Additional interval for each bench, s, so that each daemon receives two records per second
/// independent of the size of the fleet.
const COUNT_EACH_S: f64 = 0.5;
/// Time until a failed count is repeated, s.
const RETRY_S: f64 = 2.0;
/// Maximum time that a count waits for the records.
const READ: Duration = Duration::from_secs(10);

/// The shared view of the whole fleet through a daemon.
pub(crate) struct Sight {
    link: Arc<Link>,
    fleet: String,
    /// Jobs that are not over, and the states of the others.
    jobs: Arc<Watched<Job>>,
    open: Mutex<Option<Open>>,
    counted: Mutex<Option<Tally>>,
}

/// An open subscription for users.
struct Open {
    looking: Looking,
    asked_s: f64,
}

impl Sight {
    /// Creates a view without a subscription.
    pub(crate) fn of(link: &Arc<Link>, fleet: &str, jobs: &Arc<Watched<Job>>) -> Arc<Self> {
        Arc::new(Self {
            link: link.clone(),
            fleet: fleet.to_owned(),
            jobs: jobs.clone(),
            open: Mutex::default(),
            counted: Mutex::default(),
        })
    }

    /// The whole fleet.
    ///
    /// # Errors
    /// The broker is unreachable, or the records do not arrive in time.
    pub(crate) async fn seer(&self) -> Result<Arc<Seer>, FleetError> {
        let seer = self.asked();
        let until_s = self.link.clock.now_s() + PATIENCE_S;
        while !seer.is_whole() {
            if !self.link.is_connected() || self.link.clock.now_s() > until_s {
                let words = "its records have not come yet: ask again";
                return Err(FleetError::unreachable(&words));
            }
            self.link.clock.sleep_s(0.02).await;
        }
        Ok(seer)
    }

    fn asked(&self) -> Arc<Seer> {
        let mut open = self.open();
        let open = open.get_or_insert_with(|| Open {
            looking: Looking::begin(&self.link, &self.fleet, &Watched::after(&self.jobs)),
            asked_s: 0.0,
        });
        open.asked_s = self.link.clock.now_s();
        open.looking.seer.clone()
    }

    fn open(&self) -> MutexGuard<'_, Option<Open>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Closes subscriptions without recent requests, until the task is aborted.
    pub(crate) async fn close(self: Arc<Self>) {
        loop {
            self.link.clock.sleep_s(IDLE_S / 4.0).await;
            let now_s = self.link.clock.now_s();
            self.open().take_if(|open| now_s - open.asked_s > IDLE_S);
        }
    }

    /// Counts benches and jobs periodically, until the task is aborted.
    pub(crate) async fn count(self: Arc<Self>) {
        let seer = Seer::of(&self.link, &self.fleet, &self.jobs);
        let clock = &self.link.clock;
        loop {
            let counted = match self.jobs.is_whole() {
                true => clock.deadline(READ, seer.tally()).await.ok(),
                false => None,
            };
            let counted = counted.and_then(Result::ok);
            let pause_s = match &counted {
                Some(_) => COUNT_S.max(COUNT_EACH_S * seer.places().len() as f64),
                None => RETRY_S,
            };
            *self.counted() = counted;
            clock.sleep_s(pause_s).await;
        }
    }

    fn counted(&self) -> MutexGuard<'_, Option<Tally>> {
        self.counted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the last counted numbers; `None` while the broker is unreachable.
    pub(crate) fn tally(&self) -> Option<Tally> {
        let is_there = self.link.is_connected();
        self.counted().clone().filter(|_| is_there)
    }
}
