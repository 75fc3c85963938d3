//! The benches of this server in a fleet. The fleet submits experiments as text. They pass the
//! same checks and the same queue as local submissions, and a run does not depend on its origin.
//! The fleet can hold and stop a bench. It cannot clear a latch, raise a limit or change a file.

mod capabilities;

use std::{
    path::Path,
    sync::{Arc, Weak},
};

use analysis::run_folder::SUMS;
use bench_fleet::{
    BenchState as State, Capabilities, Condition, End, Fate, Fleet, LocalBench, Order, Reading,
    fleet::Joining, local::NotTaken, standing::through_the_fleet,
};
use futures_util::{FutureExt, future::BoxFuture};
use instruments::clock;

use super::{
    Server,
    audit::By,
    jobs::{self, Ended},
    live::{BenchState, Live},
    notebook::About,
    queue::{HeldBy, Kind, Wanted},
    stop::{self, Stopper},
    submission::{self, ExperimentRequest, Refused, Submission},
    watch::Watch,
};
use crate::{bench::outputs::OutputsKind, config, safety::failure::Failure, support::hash};
use capabilities::capabilities;

/// The fleet's part of the data folder.
const FOLDER: &str = "fleet";
/// Longest reason that is kept, letters.
const LONGEST_WHY: usize = 200;

/// Joins the fleet that the settings name, and does not wait for it. Must be called inside a runtime.
///
/// # Errors
/// A file with credentials that is not as expected.
pub fn join(server: &Arc<Server>) -> Result<(), Failure> {
    let Some(section) = &server.settings.fleet else {
        return Ok(());
    };
    let bench = |bench: &config::Bench| -> Arc<dyn LocalBench> {
        Arc::new(ServedBench {
            server: Arc::downgrade(server),
            capabilities: capabilities(bench),
            bench: bench.clone(),
        })
    };
    let fleet = Fleet::join(Joining {
        settings: section.open()?,
        folder: server.settings.data.join(FOLDER),
        benches: server.settings.benches.iter().map(bench).collect(),
    });
    let _ = server.fleet.set(fleet);
    Ok(())
}

/// Signs off. Runs continue, and jobs stay with their benches.
pub async fn leave(server: &Server) {
    /// A server that ends waits for the broker no longer.
    const PATIENCE: std::time::Duration = std::time::Duration::from_secs(2);
    if let Some(fleet) = server.fleet.get() {
        let _ = server.clock.deadline(PATIENCE, fleet.end()).await;
    }
}

/// A bench of this server.
struct ServedBench {
    server: Weak<Server>,
    bench: config::Bench,
    capabilities: Capabilities,
}

impl ServedBench {
    /// Returns the server while it exists.
    fn server(&self) -> Result<Arc<Server>, String> {
        let gone = || "the server is ending".to_owned();
        self.server.upgrade().ok_or_else(gone)
    }

    fn submission(
        &self,
        server: &Server,
        order: &Order,
        text: &str,
    ) -> Result<Submission, NotTaken> {
        let request = ExperimentRequest {
            name: &order.name,
            text: Some(text),
            bench: Some(&self.bench.name),
        };
        Submission::new(&server.settings, request).map_err(not_taken)
    }

    fn wanted(&self, server: &Server, order: &Order) -> Result<Wanted, String> {
        let (_, text) = submission::of_run(&server.settings.data, &order.run)
            .ok_or("what was checked is not there any more")?;
        // It was checked when it was taken; the plan is asked again for its duration only.
        let planned = self.submission(server, order, &text);
        Ok(Wanted {
            traceparent: None,
            kind: Kind::Run,
            experiment: order.name.clone(),
            bench: self.bench.name.clone(),
            seed: order.seed,
            expected_s: planned.map_or(0.0, |planned| planned.expected_s),
            by: through_the_fleet(&short(&order.by)),
            unix_s: clock::unix_time_s(),
        })
    }
}

fn not_taken(refused: Refused) -> NotTaken {
    match refused {
        Refused::Kept(words) => NotTaken::NotNow(words),
        refused => NotTaken::Unfit(refused.to_string()),
    }
}

fn is_queued(server: &Server, run: &str) -> bool {
    server.queue().items().iter().any(|item| item.run == run)
}

fn is_known(server: &Server, run: &str) -> bool {
    is_queued(server, run) || jobs::read(&server.settings.data, run).is_some()
}

impl LocalBench for ServedBench {
    fn name(&self) -> String {
        self.bench.name.clone()
    }

    fn capabilities(&self) -> Capabilities {
        self.capabilities.clone()
    }

    fn condition(&self) -> Condition {
        let Some(server) = self.server.upgrade() else {
            return Condition::default();
        };
        let live = server.live().get(&self.bench.name).cloned();
        let queue = server.queue();
        let mut items = queue.items().iter();
        let waits = items.any(|item| item.bench == self.bench.name);
        let held = queue.held(&self.bench.name).map(str::to_owned);
        drop(queue);
        live.map(|live| condition(live, waits, held))
            .unwrap_or_default()
    }

    fn prepare(&self, order: &Order, text: &str) -> Result<(), NotTaken> {
        let server = self.server().map_err(NotTaken::NotNow)?;
        let folder = server.settings.data.join("submitted").join(&order.run);
        let submission = self.submission(&server, order, text)?;
        submission.freeze(&folder).map_err(not_taken)
    }

    fn begin(&self, order: &Order) -> Result<(), String> {
        let server = self.server()?;
        if is_known(&server, &order.run) {
            return Ok(());
        }
        let wanted = self.wanted(&server, order)?;
        let submitted = server.queue().submit(&wanted, |_| order.run.clone());
        submitted.map_err(|error| error.to_string())?;
        server.tell_queue();
        Ok(())
    }

    fn discard(&self, order: &Order) {
        let Some(server) = self.server.upgrade() else {
            return;
        };
        if !is_known(&server, &order.run) {
            let folder = server.settings.data.join("submitted").join(&order.run);
            let _ = std::fs::remove_dir_all(folder);
        }
    }

    fn withdraw(&self, run: &str) -> bool {
        let Some(server) = self.server.upgrade() else {
            return false;
        };
        let mut queue = server.queue();
        let waits = queue.items().iter().find(|item| item.run == run);
        let Some(id) = waits.map(|item| item.id) else {
            return false;
        };
        let withdrawn = queue.cancel(id).is_ok();
        drop(queue);
        server.tell_queue();
        withdrawn
    }

    fn fate(&self, run: &str) -> Fate {
        let Some(server) = self.server.upgrade() else {
            return Fate::Going;
        };
        if is_queued(&server, run) {
            return Fate::Going;
        }
        match jobs::read(&server.settings.data, run) {
            None => Fate::Unknown,
            Some(job) => Fate::Ended(end(job.ended, &server.settings.runs().join(run))),
        }
    }

    fn hold(&self, by: &str, why: &str) -> Result<(), String> {
        let server = self.server()?;
        let why = format!("{} ({})", short(why), through_the_fleet(&short(by)));
        let held = server.queue().hold(HeldBy::Fleet, &self.bench.name, &why);
        server.tell_queue();
        held.map_err(|error| error.to_string())
    }

    fn release(&self, by: &str, why: &str) -> Result<(), String> {
        let (server, bench) = (self.server()?, &self.bench.name);
        let held = |side| server.queue().held_by(side, bench).map(str::to_owned);
        if let Some(held) = held(HeldBy::Fleet) {
            let note = format!("released: {}; it was held: {held}", short(why));
            let by = through_the_fleet(&short(by));
            let kept = server.notebook.note(About::Bench(bench), &by, &note);
            kept.map_err(|error| error.to_string())?;
            let released = server.queue().release(HeldBy::Fleet, bench);
            server.tell_queue();
            released.map_err(|error| error.to_string())?;
        }
        match held(HeldBy::Here) {
            None => Ok(()),
            Some(held) => Err(format!(
                "it stays held by its own server: {held}: release it there"
            )),
        }
    }

    fn stop<'a>(&'a self, by: &'a str) -> BoxFuture<'a, serde_json::Value> {
        async move {
            let Some(server) = self.server.upgrade() else {
                return serde_json::Value::Null;
            };
            let report = stop::stop(&server, &self.bench, Stopper::fleet(&short(by))).await;
            serde_json::to_value(report).unwrap_or_default()
        }
        .boxed()
    }

    fn audit(&self, who: &str, what: &str, outcome: &str) {
        let Some(server) = self.server.upgrade() else {
            return;
        };
        let by = By { who, from: FOLDER };
        if let Err(error) = server.audit.write(by, what, outcome) {
            tracing::error!("the audit trail cannot be written: {error}");
        }
    }
}

/// A reason without what could fool a terminal, and not too long.
fn short(why: &str) -> String {
    let plain = why.chars().filter(|c| !c.is_control());
    plain.take(LONGEST_WHY).collect()
}

fn end(ended: Option<Ended>, folder: &Path) -> End {
    let content_sha256 = hash::sha256_of(&folder.join(SUMS)).ok();
    if let Some(ended) = ended {
        return End {
            finished: ended.finished,
            words: ended.how,
            content_sha256,
        };
    }
    // Its end could not be recorded; the journal contains it.
    let mut watch = Watch::new(folder);
    watch.look();
    let words = watch.ended().unwrap_or("nobody knows how it ended");
    End {
        finished: watch.ended() == Some("finished"),
        words: words.to_owned(),
        content_sha256,
    }
}

fn condition(live: Live, waits: bool, held: Option<String>) -> Condition {
    let state = match live.state {
        BenchState::Latched => State::Latched,
        BenchState::Asking => State::Asking,
        BenchState::Running | BenchState::Paused | BenchState::Stopping => State::Running,
        BenchState::Idle if held.is_none() && live.held.is_none() => State::Idle,
        BenchState::Idle | BenchState::Unknown => State::Held,
    };
    let words = live.outputs.words.clone();
    let unknown = || words.clone();
    let is_unknown = live.state == BenchState::Unknown;
    let going = live.run.filter(|run| run.going);
    let fresh = live.reading.filter(|reading| reading.fresh);
    Condition {
        free: state == State::Idle && !waits,
        held: held.or(live.held).or_else(|| is_unknown.then(unknown)),
        run: going.as_ref().and_then(|run| run.run.clone()),
        left_s: going.as_ref().and_then(|run| run.left_s),
        verified: match live.outputs.state {
            _ if live.verified => Some(true),
            _ if is_unknown => Some(false),
            OutputsKind::On | OutputsKind::Unreachable => Some(false),
            // A state that was not read, or not recently, is unknown.
            _ => None,
        },
        reading: fresh.map(|reading| Reading {
            voltage_v: reading.voltage_v,
            current_a: reading.current_a,
            temperature_c: reading.temperature_c,
        }),
        trip: live.trip.map(|trip| trip.cause),
        state,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bench_is_free_only_where_nothing_keeps_a_run_from_beginning() {
        let idle = || Live {
            state: BenchState::Idle,
            ..Live::default()
        };
        assert!(condition(idle(), false, None).free);
        assert!(!condition(idle(), true, None).free);
        assert!(!condition(idle(), false, Some("held".to_owned())).free);
        assert!(!condition(Live::default(), false, None).free);
        let latched = Live {
            state: BenchState::Latched,
            ..idle()
        };
        assert_eq!(condition(latched, false, None).state, State::Latched);
    }
}
