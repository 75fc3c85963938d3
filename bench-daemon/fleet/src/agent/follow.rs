//! Follows the benches and the queue of the server: a copy that is never older than a few seconds,
//! so that the state of a bench is available without waiting.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use instruments_link::clock::Clock;
use serde::Deserialize;

use super::server::{BenchServer, Call};
use crate::local::{Away, Capabilities};

/// Interval of the polls, s.
const POLL_S: f64 = 0.5;
/// The server shows a change of its queue in the state of a bench after 0.2 s. Pause between two polls,
/// s, and their number.
const SETTLE_S: f64 = 0.2;
const SETTLE_LOOKS: usize = 5;
/// Age at which a copy counts as old, s: a server that hangs is not shown as idle.
const OLD_S: f64 = 5.0;

/// A bench in the response of the server; other fields are not used.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct ServedState {
    /// Its name.
    pub(crate) bench: String,
    /// State of the bench.
    pub(crate) state: String,
    /// Why no run begins on it.
    pub(crate) held: Option<String>,
    /// The run in work, or the last one.
    pub(crate) run: Option<ServedRun>,
    /// The last reading of that run.
    pub(crate) reading: Option<ServedReading>,
    /// Why it is latched.
    pub(crate) trip: Option<ServedTrip>,
    /// State of the outputs.
    pub(crate) outputs: ServedOutputs,
    /// Nothing runs, and every output is known to be off.
    pub(crate) verified: bool,
    /// Its properties.
    pub(crate) capabilities: Capabilities,
}

/// A run in the response of the server.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct ServedRun {
    pub(crate) run: Option<String>,
    pub(crate) going: bool,
    pub(crate) left_s: Option<f64>,
}

/// A reading in the response of the server.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct ServedReading {
    pub(crate) voltage_v: Option<f64>,
    pub(crate) current_a: Option<f64>,
    #[serde(rename = "temperature_c")]
    pub(crate) temperature_degc: Option<f64>,
    pub(crate) fresh: bool,
}

/// A trip in the response of the server.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct ServedTrip {
    pub(crate) cause: String,
}

/// Outputs in the response of the server.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct ServedOutputs {
    pub(crate) state: String,
    pub(crate) words: String,
}

/// The queue in the response of the server.
#[derive(Debug, Clone, Default, Deserialize)]
pub(crate) struct ServedQueue {
    /// Runs in work and waiting.
    pub(crate) items: Vec<ServedItem>,
    /// Benches on which no run begins, and why.
    pub(crate) held: BTreeMap<String, String>,
}

/// A place in the queue.
#[derive(Debug, Clone, Deserialize)]
pub(crate) struct ServedItem {
    pub(crate) id: u64,
    pub(crate) run: String,
    pub(crate) bench: String,
}

/// The last responses of the server.
#[derive(Debug, Clone)]
struct Shown {
    at_s: f64,
    benches: BTreeMap<String, ServedState>,
    queue: ServedQueue,
}

/// A copy of the state of the server.
pub(crate) struct Follower {
    server: Arc<BenchServer>,
    clock: Clock,
    shown: Mutex<Result<Shown, Away>>,
}

impl Follower {
    /// Creates a copy that is still empty.
    pub(crate) fn of(server: &Arc<BenchServer>, clock: &Clock) -> Arc<Self> {
        Arc::new(Self {
            server: server.clone(),
            clock: clock.clone(),
            shown: Mutex::new(Err(Away(
                "the server of the bench has not answered yet".to_owned(),
            ))),
        })
    }

    /// Follows the server until the task is aborted.
    pub(crate) async fn follow(self: Arc<Self>) {
        loop {
            let this = self.clone();
            // After a panic of a refresh, the copy becomes old.
            let _ = tokio::task::spawn_blocking(move || this.refresh()).await;
            self.clock.sleep_s(POLL_S).await;
        }
    }

    /// Refreshes the copy now.
    pub(crate) fn refresh(&self) {
        let fresh = self.ask();
        let mut shown = self.shown();
        match (&*shown, &fresh) {
            // Another refresh began later and has already finished.
            (Ok(shown), Ok(fresh)) if shown.at_s > fresh.at_s => return,
            (Ok(_), Err(away)) => tracing::warn!("{away}; it is tried again"),
            (Err(_), Ok(_)) => tracing::info!("the server {} answers", self.server.url()),
            _ => {}
        }
        *shown = fresh;
    }

    /// Refreshes the copy until a bench is no longer held. Must be called on a thread of a runtime
    /// that may block.
    pub(crate) fn refresh_released(&self, bench: &str) {
        for _ in 0..SETTLE_LOOKS {
            self.refresh();
            if self.now(bench).is_ok_and(|now| now.state.held.is_none()) {
                return;
            }
            tokio::runtime::Handle::current().block_on(self.clock.sleep_s(SETTLE_S));
        }
    }

    fn ask(&self) -> Result<Shown, Away> {
        let at_s = self.clock.now_s();
        // Query the benches first: a run that ends in between then counts as active and is not
        // lost.
        let benches: Vec<ServedState> = self.get("/benches")?;
        let queue = self.get("/queue")?;
        let named = benches.into_iter().map(|one| (one.bench.clone(), one));
        Ok(Shown {
            at_s,
            benches: named.collect(),
            queue,
        })
    }

    fn get<T: serde::de::DeserializeOwned>(&self, path: &str) -> Result<T, Away> {
        let answer = self.server.call(Call::get(path));
        answer.map_err(super::server::CallError::into_away)
    }

    fn shown(&self) -> MutexGuard<'_, Result<Shown, Away>> {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns a bench and the queue as they are now.
    ///
    /// # Errors
    /// The server does not answer, or no longer has the bench.
    pub(crate) fn now(&self, bench: &str) -> Result<Now, Away> {
        let shown = self.shown();
        let shown = shown.as_ref().map_err(Clone::clone)?;
        let age_s = self.clock.now_s() - shown.at_s;
        if age_s > OLD_S {
            return Err(Away(format!(
                "the server of the bench has not answered for {age_s:.0} s"
            )));
        }
        let state = shown.benches.get(bench).cloned();
        let state = state.ok_or_else(|| Away("the server has no bench of this name".to_owned()))?;
        let waits = shown.queue.items.iter().any(|item| item.bench == bench);
        let held = shown.queue.held.get(bench).cloned();
        Ok(Now { state, waits, held })
    }

    /// Returns the last known properties of a bench.
    pub(crate) fn capabilities(&self, bench: &str) -> Option<Capabilities> {
        let shown = self.shown();
        let benches = &shown.as_ref().ok()?.benches;
        Some(benches.get(bench)?.capabilities.clone())
    }

    /// Returns whether a run was in the queue at the last poll.
    pub(crate) fn was_queued(&self, run: &str) -> bool {
        let shown = self.shown();
        let queue = shown.as_ref().map(|shown| &shown.queue.items);
        queue.is_ok_and(|items| items.iter().any(|item| item.run == run))
    }
}

/// A bench with its part of the queue.
#[derive(Debug, Clone)]
pub(crate) struct Now {
    /// The bench.
    pub(crate) state: ServedState,
    /// A run is in work or waits on it.
    pub(crate) waits: bool,
    /// Why the queue holds it.
    pub(crate) held: Option<String>,
}
