//! Follows standing orders, each once, whether it was heard at once or after a cut.

use std::sync::{Arc, Mutex as Short, MutexGuard, PoisonError};

use tokio::sync::Mutex;

use super::shared::aside;
use crate::{
    error::FleetError,
    intent::{Desk, Followed},
    local::LocalBench,
    standing::{Said, Standing, through_the_fleet},
};

/// A bench that is told something.
pub(crate) struct Obedience {
    bench: Arc<dyn LocalBench>,
    desk: Desk,
    /// Orders that were followed; none before the file was read.
    followed: Mutex<Option<Followed>>,
    /// Number of the stop that is under way: it was heard at once.
    stopping: Short<Option<String>>,
}

impl Obedience {
    /// Of a bench.
    pub(super) fn new(bench: &Arc<dyn LocalBench>, desk: &Desk) -> Self {
        Self {
            bench: bench.clone(),
            desk: desk.clone(),
            followed: Mutex::default(),
            stopping: Short::default(),
        }
    }

    /// The bench.
    pub(crate) fn bench(&self) -> &Arc<dyn LocalBench> {
        &self.bench
    }

    /// Jobs that the bench has, by its intents: known from the first moment after a restart on.
    ///
    /// # Errors
    /// A folder or a file that cannot be read: then nobody knows.
    pub(super) fn jobs(&self) -> Result<Vec<String>, FleetError> {
        let intents = self.desk.all()?;
        Ok(intents.into_iter().map(|intent| intent.job).collect())
    }

    /// Stops the bench now, whatever runs on it.
    pub(super) async fn stop(&self, said: &Said) -> serde_json::Value {
        *self.stopping() = Some(said.id.clone());
        let report = self.bench.stop(&through_the_fleet(&said.by)).await;
        let outcome = match (&report["verified"], &report["simulated"]) {
            (serde_json::Value::Bool(true), _) => "stopped and verified off",
            (_, serde_json::Value::Bool(true)) => "stopped; the bench is simulated",
            _ => "NOT VERIFIED OFF",
        };
        self.note(said, "stop", outcome.to_owned()).await;
        let mut followed = self.followed.lock().await;
        if let Err(error) = self.keep(&mut followed, |kept| kept.stop = Some(said.id.clone())) {
            tracing::error!("fleet: {error}");
        }
        report
    }

    fn stopping(&self) -> MutexGuard<'_, Option<String>> {
        self.stopping.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Follows what stands and was not yet followed.
    ///
    /// # Errors
    /// A file that cannot be read or written: the order is followed again at the next look.
    pub(super) async fn follow(&self, standing: &Standing) -> Result<(), FleetError> {
        let mut followed = self.followed.lock().await;
        let known = match &*followed {
            Some(known) => known.clone(),
            None => self.desk.followed()?,
        };
        let is_new = |said: &Option<Said>, known: &Option<String>| {
            let said = said.clone();
            said.filter(|said| known.as_ref() != Some(&said.id))
        };
        if let Some(said) = is_new(&standing.release, &known.release) {
            let released = self.act(&said, |bench, said| bench.release(&said.by, &said.why));
            let outcome = said_of(released.await?);
            self.note(&said, "release", outcome).await;
            self.keep(&mut followed, |kept| kept.release = Some(said.id))?;
        }
        if let Some(said) = is_new(&standing.hold, &known.hold) {
            let held = self.act(&said, |bench, said| bench.hold(&said.by, &said.why));
            let outcome = said_of(held.await?);
            self.note(&said, "hold", outcome).await;
            self.keep(&mut followed, |kept| kept.hold = Some(said.id))?;
        }
        // Whoever takes work asks what stands; here the drain is only written down.
        if let Some(said) = is_new(&standing.drain, &known.drain) {
            self.note(&said, "drain", said_of(Ok(()))).await;
            self.keep(&mut followed, |kept| kept.drain = Some(said.id))?;
        }
        let stopping = self.stopping().clone();
        if let Some(said) = is_new(&standing.stop, &known.stop)
            && stopping.as_ref() != Some(&said.id)
        {
            self.late_stop(&said).await?;
            self.keep(&mut followed, |kept| kept.stop = Some(said.id))?;
        }
        Ok(())
    }

    /// A stop that was heard late, after a cut. Runs of the fleet were begun before it, for nothing
    /// is taken unheard: they end. What a person began here meanwhile goes on. Nothing begins.
    async fn late_stop(&self, said: &Said) -> Result<(), FleetError> {
        let held = self.act(said, |bench, said| bench.hold(&said.by, &said.why));
        let outcome = said_of(held.await?);
        self.note(said, "stop", format!("heard through the broker: {outcome}"))
            .await;
        // Where nobody knows, there may be one.
        if !self.jobs().is_ok_and(|jobs| jobs.is_empty()) {
            let (bench, by) = (self.bench.clone(), through_the_fleet(&said.by));
            // It takes as long as the run needs; heartbeats go on meanwhile.
            tokio::spawn(async move { bench.stop(&by).await });
        }
        Ok(())
    }

    async fn act<T: Send + 'static>(
        &self,
        said: &Said,
        act: impl FnOnce(&dyn LocalBench, &Said) -> T + Send + 'static,
    ) -> Result<T, FleetError> {
        let said = said.clone();
        aside(&self.bench, move |bench| act(bench, &said)).await
    }

    async fn note(&self, said: &Said, what: &'static str, outcome: String) {
        let (by, why) = (through_the_fleet(&said.by), said.why.clone());
        let noted = aside(&self.bench, move |bench| {
            bench.audit(
                &by,
                &format!("fleet {what} {}: {why}", bench.name()),
                &outcome,
            );
        });
        if let Err(error) = noted.await {
            tracing::error!("fleet: {error}");
        }
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

fn said_of(done: Result<(), String>) -> String {
    done.err().unwrap_or_else(|| "done".to_owned())
}
