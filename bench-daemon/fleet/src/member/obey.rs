//! Follows each standing order once, whether it arrives at once or after a disconnection.

use std::sync::{Arc, Mutex as Short, MutexGuard, PoisonError};

use tokio::sync::Mutex;

use super::shared::aside;
use crate::{
    error::FleetError,
    intent::{Desk, Followed, Intent},
    local::{Fate, LocalBench, NotDone},
    standing::{Said, Standing},
};

/// A bench that follows orders.
pub(crate) struct Obedience {
    bench: Arc<dyn LocalBench>,
    desk: Desk,
    /// Orders that were followed; `None` before the file was read.
    followed: Mutex<Option<Followed>>,
    /// Number of the stop in progress.
    stopping: Short<Option<String>>,
    /// The run that was active at the last contact with the fleet.
    heard: Short<Option<String>>,
}

impl Obedience {
    /// Creates the follower of a bench.
    pub(super) fn new(bench: &Arc<dyn LocalBench>, desk: &Desk) -> Self {
        Self {
            bench: bench.clone(),
            desk: desk.clone(),
            followed: Mutex::default(),
            stopping: Short::default(),
            heard: Short::default(),
        }
    }

    /// The bench.
    pub(crate) fn bench(&self) -> &Arc<dyn LocalBench> {
        &self.bench
    }

    /// Returns the jobs that the bench has, from its intents, which are known immediately after a
    /// restart.
    ///
    /// # Errors
    /// A folder or a file cannot be read: the jobs are then unknown.
    pub(super) fn jobs(&self) -> Result<Vec<String>, FleetError> {
        let intents = self.desk.all()?;
        Ok(intents.into_iter().map(|intent| intent.job).collect())
    }

    /// Stops the bench now, whatever run is active.
    pub(super) async fn stop(&self, said: &Said) -> serde_json::Value {
        *self.stopping() = Some(said.id.clone());
        let report = match self.bench.stop(&said.by).await {
            Ok(report) => report,
            // The order stays open: if the broker stores it, it is followed once the server
            // answers.
            Err(away) => {
                self.stopping().take_if(|id| *id == said.id);
                tracing::error!("fleet: {}: NOT STOPPED: {away}", self.bench.name());
                return serde_json::json!({ "verified": false, "message": away.to_string() });
            }
        };
        let outcome = match (&report["verified"], &report["simulated"]) {
            (serde_json::Value::Bool(true), _) => "stopped and verified off",
            (_, serde_json::Value::Bool(true)) => "stopped; the bench is simulated",
            _ => "NOT VERIFIED OFF",
        };
        if let Err(error) = self.note(said, "stop", outcome.to_owned()).await {
            tracing::error!("fleet: {error}");
        }
        let mut followed = self.followed.lock().await;
        if let Err(error) = self.keep(&mut followed, |kept| kept.stop = Some(said.id.clone())) {
            tracing::error!("fleet: {error}");
        }
        report
    }

    fn stopping(&self) -> MutexGuard<'_, Option<String>> {
        self.stopping.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether this is the run that was active at the last contact with the fleet.
    pub(super) fn has_heard(&self, run: &Option<String>) -> bool {
        *self.heard_run() == *run
    }

    /// Records the active run: there was contact with the fleet since it began.
    pub(super) fn heard(&self, run: Option<String>) {
        *self.heard_run() = run;
    }

    fn heard_run(&self) -> MutexGuard<'_, Option<String>> {
        self.heard.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Follows standing orders that were not followed yet. The stop comes first, and a failure to
    /// record it does not delay it.
    ///
    /// # Errors
    /// A file cannot be read or written: the order is followed again at the next poll.
    pub(super) async fn follow(self: &Arc<Self>, standing: &Standing) -> Result<(), FleetError> {
        let mut followed = self.followed.lock().await;
        let known = match &*followed {
            Some(known) => known.clone(),
            None => self.desk.followed()?,
        };
        let is_new = |said: &Option<Said>, known: &Option<String>| {
            let said = said.clone();
            said.filter(|said| known.as_ref() != Some(&said.id))
        };
        let stopped = match is_new(&standing.stop, &known.stop) {
            Some(said) => self.follow_stop(&said, &mut followed).await,
            None => Ok(()),
        };
        let released = match is_new(&standing.release, &known.release) {
            Some(said) => self.follow_release(&said, standing, &mut followed).await,
            None => Ok(()),
        };
        let held = match is_new(&standing.hold, &known.hold) {
            Some(said) => self.follow_hold(&said, &mut followed).await,
            None => Ok(()),
        };
        let drained = match is_new(&standing.drain, &known.drain) {
            Some(said) => {
                // The code that takes work checks the standing orders; here the drain is only
                // recorded.
                let noted = self.note(&said, "drain", "done".to_owned()).await;
                noted.and_then(|()| self.keep(&mut followed, |kept| kept.drain = Some(said.id)))
            }
            None => Ok(()),
        };
        stopped.and(released).and(held).and(drained)
    }

    async fn follow_release(
        &self,
        said: &Said,
        standing: &Standing,
        followed: &mut Option<Followed>,
    ) -> Result<(), FleetError> {
        // A release revokes all earlier orders: the other standing orders were given after it.
        let outcome = match standing.stop.is_some() || standing.hold.is_some() {
            true => "held again since".to_owned(),
            false => {
                let act = |bench: &dyn LocalBench, said: &Said| bench.release(&said.by, &said.why);
                self.act(said, act).await?
            }
        };
        self.note(said, "release", outcome).await?;
        self.keep(followed, |kept| kept.release = Some(said.id.clone()))
    }

    async fn follow_hold(
        &self,
        said: &Said,
        followed: &mut Option<Followed>,
    ) -> Result<(), FleetError> {
        let held = self.act(said, |bench, said| bench.hold(&said.by, &said.why));
        self.note(said, "hold", held.await?).await?;
        self.keep(followed, |kept| kept.hold = Some(said.id.clone()))
    }

    /// Follows a stop that arrived late, after a cut. Runs of the fleet began before it, because
    /// no job is taken without a connection, and so did the run that was active when the fleet
    /// was last heard: these runs end. A run that a person has begun at this server in the
    /// meantime continues. No further run begins.
    async fn follow_stop(
        self: &Arc<Self>,
        said: &Said,
        followed: &mut Option<Followed>,
    ) -> Result<(), FleetError> {
        if self.stopping().as_ref() == Some(&said.id) {
            return Ok(());
        }
        let held = self.act(said, |bench, said| bench.hold(&said.by, &said.why));
        let outcome = format!("heard through the broker: {}", held.await?);
        self.note(said, "stop", outcome).await?;
        if !self.is_to_end().await {
            return self.keep(followed, |kept| kept.stop = Some(said.id.clone()));
        }
        *self.stopping() = Some(said.id.clone());
        let (this, said) = (self.clone(), said.clone());
        // This takes as long as the run needs to end; heartbeats continue meanwhile. A restart
        // repeats it.
        tokio::spawn(async move { this.stop(&said).await });
        Ok(())
    }

    /// Returns whether an active run began before a stop that arrives now.
    async fn is_to_end(&self) -> bool {
        let intents = self.desk.all();
        let heard = self.heard_run().clone();
        let look = aside(&self.bench, move |bench| {
            // A job whose fate is unknown counts as active, and so does an unknown job.
            let is_going =
                |intent: &Intent| matches!(bench.fate(&intent.run), Ok(Fate::Going) | Err(_));
            let is_heard = match bench.condition() {
                Ok(now) => now.run.is_some() && now.run == heard,
                Err(_) => true,
            };
            intents.map_or(true, |all| all.iter().any(is_going)) || is_heard
        });
        look.await.unwrap_or(true)
    }

    /// Carries out an order, and returns its outcome in words.
    ///
    /// # Errors
    /// The server does not answer: the order is carried out later.
    async fn act(
        &self,
        said: &Said,
        act: impl FnOnce(&dyn LocalBench, &Said) -> Result<(), NotDone> + Send + 'static,
    ) -> Result<String, FleetError> {
        let said = said.clone();
        match aside(&self.bench, move |bench| act(bench, &said)).await? {
            Ok(()) => Ok("done".to_owned()),
            Err(NotDone::Refused(words)) => Ok(words),
            Err(NotDone::Away(away)) => Err(away.into()),
        }
    }

    async fn note(
        &self,
        said: &Said,
        what: &'static str,
        outcome: String,
    ) -> Result<(), FleetError> {
        let said = said.clone();
        let noted = aside(&self.bench, move |bench| {
            let what = format!("fleet {what} {}: {}", bench.name(), said.why);
            bench.audit(&said.by, &what, &outcome)
        });
        Ok(noted.await??)
    }

    fn keep(
        &self,
        followed: &mut Option<Followed>,
        change: impl FnOnce(&mut Followed),
    ) -> Result<(), FleetError> {
        let mut next = match followed.take() {
            Some(known) => known,
            None => self.desk.followed()?,
        };
        change(&mut next);
        self.desk.keep_followed(&next)?;
        *followed = Some(next);
        Ok(())
    }
}
