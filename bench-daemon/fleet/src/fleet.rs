//! The benches of a daemon in a fleet. They share one connection.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use instruments_link::clock::{Clock, TimeMode};
use tokio::task::JoinSet;

use crate::{
    client::Client,
    error::FleetError,
    intent,
    job::{Job, Place},
    link::{Link, Swap, random},
    local::LocalBench,
    member::{Member, Shared, listen},
    record::BenchRecord,
    settings::FleetSettings,
    sight::Sight,
    view::{Seer, Tally},
    watched::Watched,
};

/// Interval between two attempts to reach the broker, s.
const RETRY_S: f64 = 2.0;

/// A daemon that joins a fleet.
pub struct Joining {
    /// Its settings.
    pub settings: FleetSettings,
    /// Its persistent folder.
    pub folder: PathBuf,
    /// Its benches.
    pub benches: Vec<Arc<dyn LocalBench>>,
}

/// A daemon in a fleet. Dropping it ends its work at once; runs continue.
pub struct Fleet {
    settings: FleetSettings,
    joined: Mutex<Option<Joined>>,
    tasks: Mutex<JoinSet<()>>,
}

#[derive(Clone)]
struct Joined {
    shared: Arc<Shared>,
    sight: Arc<Sight>,
    places: Vec<Place>,
}

impl Fleet {
    /// Starts to join without waiting for the broker, because the benches work without it. Must be
    /// called inside a runtime.
    pub fn join(joining: Joining) -> Arc<Self> {
        let fleet = Arc::new(Self {
            settings: joining.settings.clone(),
            joined: Mutex::default(),
            tasks: Mutex::default(),
        });
        // The task must not keep the value alive whose drop ends it.
        let weak = Arc::downgrade(&fleet);
        let work = async move {
            let joined = reach(&joining).await;
            let Some(fleet) = weak.upgrade() else { return };
            fleet.work(&joining, joined);
        };
        fleet.tasks().spawn(work);
        fleet
    }

    /// Its settings.
    pub fn settings(&self) -> &FleetSettings {
        &self.settings
    }

    /// Returns whether the broker was reachable at the last contact.
    pub fn is_connected(&self) -> bool {
        let joined = self.joined();
        joined.is_some_and(|joined| joined.shared.link.is_connected())
    }

    /// Returns a client for requests of users through this daemon.
    ///
    /// # Errors
    /// The broker has not been reachable since the start.
    pub fn client(&self) -> Result<Client, FleetError> {
        let joined = self.joined().ok_or_else(|| self.not_reached())?;
        Ok(Client::through(joined.shared.link.clone()))
    }

    /// Returns the state of the whole fleet. It is followed from the first request until there
    /// has been no request for a minute; the first reply waits for the records.
    ///
    /// # Errors
    /// The broker is unreachable, or its records do not arrive within seconds.
    pub async fn seer(&self) -> Result<Arc<Seer>, FleetError> {
        let joined = self.joined().ok_or_else(|| self.not_reached())?;
        joined.sight.seer().await
    }

    /// Returns the last counted numbers of the fleet; `None` while the broker is unreachable.
    pub fn tally(&self) -> Option<Tally> {
        self.joined()?.sight.tally()
    }

    /// Signs off, so that other processes need not wait for the lease, and ends.
    pub async fn end(&self) {
        self.tasks().abort_all();
        let Some(joined) = self.joined() else { return };
        for place in &joined.places {
            if let Err(error) = sign_off(&joined.shared, place).await {
                tracing::debug!("fleet: {place}: {error}");
            }
        }
    }

    fn not_reached(&self) -> FleetError {
        FleetError::Unreachable(format!("{} was not reached yet", self.settings.server))
    }

    fn joined(&self) -> Option<Joined> {
        let joined = self.joined.lock().unwrap_or_else(PoisonError::into_inner);
        joined.clone()
    }

    fn tasks(&self) -> std::sync::MutexGuard<'_, JoinSet<()>> {
        self.tasks.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn work(&self, joining: &Joining, shared: Arc<Shared>) {
        let link = &shared.link;
        let sight = Sight::of(link, &self.settings.fleet, &shared.jobs);
        let mut tasks = self.tasks();
        tasks.spawn(shared.jobs.clone().follow(link.clone(), link.jobs.clone()));
        tasks.spawn(
            shared
                .orders
                .clone()
                .follow(link.clone(), link.orders.clone()),
        );
        tasks.spawn(sight.clone().count());
        tasks.spawn(sight.clone().close());
        for bench in &joining.benches {
            match Member::new(&shared, bench) {
                Ok(member) => {
                    tasks.spawn(listen(shared.clone(), member.obedience()));
                    tasks.spawn(member.work());
                }
                Err(error) => tracing::error!("fleet: {}: {error}", bench.name()),
            }
        }
        let benches = joining.benches.iter();
        let places = benches.map(|bench| Place::new(&shared.site, &bench.name()));
        let joined = Joined {
            places: places.collect(),
            shared,
            sight,
        };
        *self.joined.lock().unwrap_or_else(PoisonError::into_inner) = Some(joined);
    }
}

/// Connects, and retries until the broker is reachable.
async fn reach(joining: &Joining) -> Arc<Shared> {
    let clock = Clock::start(TimeMode::Real);
    let mut reported = String::new();
    loop {
        match shared(joining).await {
            Ok(shared) => return shared,
            Err(error) if error.to_string() != reported => {
                reported = error.to_string();
                tracing::warn!(
                    "fleet {}: {reported}; it is tried again",
                    joining.settings.fleet
                );
            }
            Err(_) => {}
        }
        clock.sleep_s(RETRY_S).await;
    }
}

async fn shared(joining: &Joining) -> Result<Arc<Shared>, FleetError> {
    let link = Link::open(&joining.settings).await?;
    // For an ended job, only its state is needed here.
    let over = |job: &Job| job.state.is_over().then(|| job.state.index());
    Ok(Arc::new(Shared {
        link,
        jobs: Watched::sorting(over),
        orders: Watched::keeping_all(),
        lease_s: joining.settings.lease_s,
        site: joining.settings.site.clone(),
        nonce: random()?,
        home: home(&joining.folder)?,
        folder: joining.folder.clone(),
    }))
}

/// Returns the persistent number of a data folder.
fn home(folder: &std::path::Path) -> Result<String, FleetError> {
    let path = folder.join("home.json");
    if path.exists() {
        return intent::read(&path);
    }
    std::fs::create_dir_all(folder)
        .map_err(|error| FleetError::File(format!("{}: {error}", folder.display())))?;
    let home = random()?;
    intent::write(&path, &home)?;
    Ok(home)
}

async fn sign_off(shared: &Shared, place: &Place) -> Result<(), FleetError> {
    let benches = &shared.link.benches;
    let found = benches.get::<BenchRecord>(&place.key()).await?;
    let Some(found) = found.filter(|found| found.value.nonce == shared.nonce) else {
        return Ok(());
    };
    let record = BenchRecord {
        left: true,
        ..found.value
    };
    match benches.swap(&place.key(), &record, found.revision).await? {
        Swap::Written(_) | Swap::Lost => Ok(()),
    }
}
