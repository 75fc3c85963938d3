//! A bench of the server in the fleet. Jobs of the fleet pass the same checks and the same queue as
//! any other submission. The fleet can hold and stop a bench. It cannot clear a latch, raise a limit
//! or change a file.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};

use axum::http::{Method, StatusCode};
use futures_util::{FutureExt, future::BoxFuture};
use serde::Deserialize;
use serde_json::{Value, json};

use super::{
    follow::{Follower, Now, ServedQueue, ServedState},
    server::{BenchServer, Call, CallError, ServerRefusal},
};
use crate::local::{
    Away, BenchState, Capabilities, Condition, End, Fate, LocalBench, NotDone, NotTaken, Order,
    Reading,
};

/// Timeout of a stop: the server ends the run and reads every output back.
const STOP: Duration = Duration::from_secs(120);

/// A bench of the server.
pub(crate) struct ServedBench {
    name: String,
    server: Arc<BenchServer>,
    follower: Arc<Follower>,
    /// Last known properties, also while the server does not answer.
    capabilities: Mutex<Capabilities>,
}

/// Effect of a draft, from the server.
#[derive(Debug, Deserialize)]
struct Draft {
    mistakes: Vec<Mistake>,
}

/// An invalid field of a draft.
#[derive(Debug, Deserialize)]
struct Mistake {
    field: String,
    message: String,
    line: Option<usize>,
}

impl Mistake {
    fn words(&self) -> String {
        let line = self.line.map(|line| format!("line {line}: "));
        let field = match self.field.as_str() {
            "" => String::new(),
            field => format!("{field}: "),
        };
        format!("{}{field}{}", line.unwrap_or_default(), self.message)
    }
}

/// A run as the server reports it.
#[derive(Debug, Deserialize)]
struct RunDetail {
    job: Option<RunJob>,
    now: RunState,
    content_sha256: Option<String>,
}

/// The record of a run.
#[derive(Debug, Deserialize)]
struct RunJob {
    ended: Option<RunEnd>,
}

/// The end of a run.
#[derive(Debug, Deserialize)]
struct RunEnd {
    finished: bool,
    how: String,
}

/// A run according to its journal.
#[derive(Debug, Deserialize)]
struct RunState {
    ended: Option<String>,
}

impl RunDetail {
    fn end(self) -> Option<End> {
        let content_sha256 = self.content_sha256;
        let (finished, words) = match self.job?.ended {
            Some(end) => (end.finished, end.how),
            // Its end could not be recorded; the journal contains it.
            None => match self.now.ended {
                Some(how) => (how == "finished", how),
                None => (false, "its end is not known".to_owned()),
            },
        };
        Some(End {
            finished,
            words,
            content_sha256,
        })
    }
}

impl ServedBench {
    /// A bench of this name.
    pub(crate) fn new(name: &str, server: &Arc<BenchServer>, follower: &Arc<Follower>) -> Self {
        Self {
            name: name.to_owned(),
            server: server.clone(),
            follower: follower.clone(),
            capabilities: Mutex::default(),
        }
    }

    fn path(&self, act: &str) -> String {
        format!("/benches/{}/{act}", self.name)
    }

    fn queue(&self) -> Result<ServedQueue, Away> {
        let queue = self.server.call(Call::get("/queue"));
        queue.map_err(CallError::into_away)
    }

    /// Decides what a refused submission means: the run may have been submitted before.
    fn not_submitted(&self, order: &Order, refusal: ServerRefusal) -> Result<(), NotDone> {
        match refusal.status {
            // Such a refusal gives no information about the run.
            StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN | StatusCode::TOO_MANY_REQUESTS => {
                Err(NotDone::Away(CallError::Refused(refusal).into_away()))
            }
            _ => match self.fate(&order.run).map_err(NotDone::Away)? {
                Fate::Unknown => Err(NotDone::Refused(refusal.message)),
                Fate::Going | Fate::Ended(_) => Ok(()),
            },
        }
    }
}

fn not_done(error: CallError) -> NotDone {
    match error {
        CallError::Refused(refusal) if refusal.status == StatusCode::CONFLICT => {
            NotDone::Refused(refusal.message)
        }
        error => NotDone::Away(error.into_away()),
    }
}

impl LocalBench for ServedBench {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn capabilities(&self) -> Capabilities {
        let lock = self.capabilities.lock();
        let mut known = lock.unwrap_or_else(PoisonError::into_inner);
        if let Some(seen) = self.follower.capabilities(&self.name) {
            *known = seen;
        }
        known.clone()
    }

    fn condition(&self) -> Result<Condition, Away> {
        self.follower.now(&self.name).map(condition)
    }

    fn check(&self, order: &Order) -> Result<(), NotTaken> {
        let body = json!({ "text": order.text, "bench": self.name });
        let draft = self
            .server
            .call::<Draft>(Call::post("/drafts", &order.by, body));
        let outcome = match draft {
            Ok(draft) => match draft.mistakes.first() {
                None => Ok(()),
                Some(mistake) => Err(NotTaken::Unfit(mistake.words())),
            },
            Err(CallError::Refused(refusal))
                if [
                    StatusCode::PAYLOAD_TOO_LARGE,
                    StatusCode::UNPROCESSABLE_ENTITY,
                ]
                .contains(&refusal.status) =>
            {
                Err(NotTaken::Unfit(refusal.message))
            }
            Err(error) => Err(NotTaken::NotNow(error.into_away().to_string())),
        };
        // The state of the bench is queried next, and must not be older than the check.
        self.follower.refresh();
        outcome
    }

    fn begin(&self, order: &Order) -> Result<(), NotDone> {
        let mut body = json!({ "text": order.text, "bench": self.name, "run": order.run });
        if let Some(seed) = order.seed {
            body["seed"] = seed.into();
        }
        let submitted = self
            .server
            .call::<Value>(Call::post("/queue", &order.by, body));
        let outcome = match submitted {
            Ok(_) => Ok(()),
            Err(CallError::Away(away)) => Err(NotDone::Away(away)),
            Err(CallError::Refused(refusal)) => self.not_submitted(order, refusal),
        };
        self.follower.refresh();
        outcome
    }

    fn withdraw(&self, run: &str, by: &str) -> Result<bool, Away> {
        let queue = self.queue()?;
        let Some(item) = queue.items.iter().find(|item| item.run == run) else {
            return Ok(false);
        };
        let path = format!("/queue/{}", item.id);
        let call = Call {
            method: Method::DELETE,
            person: Some(by),
            ..Call::get(&path)
        };
        match self.server.call::<Value>(call) {
            Ok(_) => Ok(true),
            Err(CallError::Refused(refusal))
                if [StatusCode::CONFLICT, StatusCode::NOT_FOUND].contains(&refusal.status) =>
            {
                Ok(false)
            }
            Err(error) => Err(error.into_away()),
        }
    }

    fn fate(&self, run: &str) -> Result<Fate, Away> {
        // The queue first: a run that has left it has a record.
        let is_queued = |queue: ServedQueue| queue.items.iter().any(|item| item.run == run);
        if self.follower.was_queued(run) || is_queued(self.queue()?) {
            return Ok(Fate::Going);
        }
        let path = format!("/runs/{run}");
        match self.server.call::<RunDetail>(Call::get(&path)) {
            Ok(detail) => Ok(detail.end().map_or(Fate::Unknown, Fate::Ended)),
            Err(CallError::Refused(refusal)) if refusal.status == StatusCode::NOT_FOUND => {
                Ok(Fate::Unknown)
            }
            Err(error) => Err(error.into_away()),
        }
    }

    fn hold(&self, by: &str, why: &str) -> Result<(), NotDone> {
        let path = self.path("hold");
        let call = Call::post(&path, by, json!({ "why": why }));
        self.server.call::<ServedQueue>(call).map_err(not_done)?;
        self.follower.refresh();
        Ok(())
    }

    fn release(&self, by: &str, why: &str) -> Result<(), NotDone> {
        let path = self.path("release");
        let call = Call::post(&path, by, json!({ "why": why }));
        let queue = self.server.call::<ServedQueue>(call).map_err(not_done)?;
        let Some(held) = queue.held.get(&self.name) else {
            self.follower.refresh_released(&self.name);
            return Ok(());
        };
        self.follower.refresh();
        Err(NotDone::Refused(format!(
            "it stays held by its own server: {held}: release it there"
        )))
    }

    fn stop<'a>(&'a self, by: &'a str) -> BoxFuture<'a, Result<Value, Away>> {
        stop(&self.server, &self.name, by).boxed()
    }

    fn audit(&self, by: &str, what: &str, outcome: &str) -> Result<(), Away> {
        let body = json!({ "what": what, "outcome": outcome });
        let entered = self.server.call::<Value>(Call::post("/audit", by, body));
        entered.map(drop).map_err(CallError::into_away)
    }
}

/// Stops a bench, and returns the report of its server. Runs on a separate thread, so that it waits
/// for no other call.
///
/// # Errors
/// The server does not answer.
pub(crate) async fn stop(server: &Arc<BenchServer>, bench: &str, by: &str) -> Result<Value, Away> {
    let (server, by) = (server.clone(), by.to_owned());
    let path = format!("/benches/{bench}/stop");
    let (send, receive) = tokio::sync::oneshot::channel();
    let work = move || {
        let call = Call {
            patience: STOP,
            ..Call::post(&path, &by, json!({}))
        };
        // The stop continues even if the caller is gone.
        let _ = send.send(server.call::<Value>(call));
    };
    let begun = std::thread::Builder::new()
        .name("stop".to_owned())
        .spawn(work);
    begun.map_err(|error| Away(error.to_string()))?;
    let answer = receive.await.map_err(|error| Away(error.to_string()))?;
    answer.map_err(CallError::into_away)
}

fn condition(now: Now) -> Condition {
    let Now { state, waits, held } = now;
    let is_unknown = state.state == "unknown";
    let kind = kind(&state, held.as_ref());
    let going = state.run.filter(|run| run.going);
    let fresh = state.reading.filter(|reading| reading.fresh);
    let words = || is_unknown.then(|| state.outputs.words.clone());
    Condition {
        free: kind == BenchState::Idle && !waits,
        held: held.or(state.held).or_else(words),
        run: going.as_ref().and_then(|run| run.run.clone()),
        left_s: going.as_ref().and_then(|run| run.left_s),
        verified: match state.outputs.state.as_str() {
            _ if state.verified => Some(true),
            _ if is_unknown => Some(false),
            "on" | "unreachable" => Some(false),
            // A state that was not read recently counts as unknown.
            _ => None,
        },
        reading: fresh.map(|reading| Reading {
            voltage_v: reading.voltage_v,
            current_a: reading.current_a,
            temperature_degc: reading.temperature_degc,
        }),
        trip: state.trip.map(|trip| trip.cause),
        state: kind,
    }
}

/// Converts the state of a bench to that of the fleet. An unknown state, from a later version of
/// the server, counts as held.
fn kind(state: &ServedState, held: Option<&String>) -> BenchState {
    match state.state.as_str() {
        "latched" => BenchState::Latched,
        "asking" => BenchState::Asking,
        "running" | "paused" | "stopping" => BenchState::Running,
        "idle" if held.is_none() && state.held.is_none() => BenchState::Idle,
        _ => BenchState::Held,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn now(state: &str) -> Now {
        let state = json!({
            "bench": "b1", "state": state, "held": null, "run": null, "reading": null,
            "trip": null, "outputs": { "state": "off", "words": "off" }, "verified": true,
            "capabilities": {
                "current_a": 20.0, "temperature_c": null, "fixtures": ["cell"], "simulated": true
            },
        });
        Now {
            state: serde_json::from_value(state).unwrap(),
            waits: false,
            held: None,
        }
    }

    #[test]
    fn a_bench_is_free_only_where_nothing_keeps_a_run_from_beginning() {
        assert!(condition(now("idle")).free);
        let waits = Now {
            waits: true,
            ..now("idle")
        };
        assert!(!condition(waits).free);
        let held = Now {
            held: Some("held".to_owned()),
            ..now("idle")
        };
        assert!(!condition(held).free);
        for state in ["unknown", "of a later version", "running"] {
            assert!(!condition(now(state)).free, "{state}");
        }
        assert_eq!(condition(now("latched")).state, BenchState::Latched);
        assert_eq!(condition(now("paused")).state, BenchState::Running);
    }

    #[test]
    fn the_end_of_a_run_is_that_of_its_record_and_else_that_of_its_journal() {
        let end = |text: &str| serde_json::from_str::<RunDetail>(text).unwrap().end();
        let recorded = end(
            r#"{"job": {"ended": {"finished": true, "how": "finished"}}, "now": {"ended": null},
                "content_sha256": "ab"}"#,
        );
        let words = "finished".to_owned();
        let expected = End {
            finished: true,
            words,
            content_sha256: Some("ab".to_owned()),
        };
        assert_eq!(recorded, Some(expected));
        let journal = r#"{"job": {"ended": null}, "now": {"ended": "ended early: aborted"}}"#;
        let journal = end(journal).unwrap();
        assert_eq!(
            (journal.finished, &*journal.words),
            (false, "ended early: aborted")
        );
        assert_eq!(end(r#"{"job": null, "now": {"ended": "finished"}}"#), None);
    }
}
