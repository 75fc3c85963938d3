//! Metrics of the fleet, in the text format of Prometheus. If the NATS server is unreachable, only
//! that is reported: earlier counts would be stale.

use std::fmt::Write;

use axum::{
    extract::State,
    http::header,
    response::{IntoResponse, Response},
};

use super::{app::App, caller::Reader};
use crate::{
    fleet::Fleet,
    job::JobState,
    view::{JobCounts, Tally},
};

/// Beginning of every name.
const PREFIX: &str = "eis_bench_fleet_";

/// A metric: its name after [`PREFIX`], and its meaning.
struct Metric {
    name: &'static str,
    help: &'static str,
}

const CONNECTED: Metric = Metric {
    name: "connected",
    help: "The NATS server of the fleet is there.",
};
const JOBS: Metric = Metric {
    name: "jobs",
    help: "Jobs of the whole fleet by their state; a lost one is not counted as started.",
};
const STRANDED: Metric = Metric {
    name: "stranded_jobs",
    help: "Jobs that wait and that no bench of the fleet can take.",
};
const BENCHES: Metric = Metric {
    name: "benches",
    help: "Benches of the whole fleet by their state.",
};

/// Metrics of the fleet, in the text format of Prometheus.
#[utoipa::path(
    get,
    path = "/metrics",
    tag = "events",
    responses((status = 200, body = String, content_type = "text/plain")),
    security(("token" = ["read"]))
)]
pub(crate) async fn metrics(_caller: Reader, State(app): State<App>) -> Response {
    let text = text(
        app.joined.get().map(|joined| &*joined.fleet),
        &app.settings.fleet,
    );
    let kind = [(header::CONTENT_TYPE, "text/plain; version=0.0.4")];
    (kind, text).into_response()
}

/// Returns all metrics. Before the agent has joined, there are no values.
fn text(fleet: Option<&Fleet>, name: &str) -> String {
    let tally = fleet.and_then(Fleet::tally);
    let counts = |values: &dyn Fn(&Tally) -> Vec<Value>| {
        let tally = tally.as_ref();
        tally.map_or_else(Vec::new, values)
    };
    let connected = fleet.map(|fleet| Value::plain(f64::from(fleet.is_connected())));
    let all = [
        (CONNECTED, connected.into_iter().collect()),
        (JOBS, counts(&|tally| jobs(&tally.jobs))),
        (
            STRANDED,
            counts(&|tally| vec![Value::plain(tally.stranded as f64)]),
        ),
        (BENCHES, counts(&benches)),
    ];
    let mut text = String::new();
    for (metric, values) in all {
        let Metric { name: kind, help } = metric;
        let _ = writeln!(
            text,
            "# HELP {PREFIX}{kind} {help}\n# TYPE {PREFIX}{kind} gauge"
        );
        for Value { state, value } in values {
            let state = state.map_or_else(String::new, |state| format!(",state={state:?}"));
            let _ = writeln!(text, "{PREFIX}{kind}{{fleet={name:?}{state}}} {value}");
        }
    }
    text
}

/// A value of a metric.
struct Value {
    state: Option<&'static str>,
    value: f64,
}

impl Value {
    fn plain(value: f64) -> Self {
        Self { state: None, value }
    }

    fn of_state(state: &'static str, count: usize) -> Self {
        Self {
            state: Some(state),
            value: count as f64,
        }
    }
}

fn jobs(counts: &JobCounts) -> Vec<Value> {
    let by_state = JobState::ALL.map(|state| Value::of_state(state.name(), counts.of(state)));
    let lost = Value::of_state("lost", counts.lost);
    by_state.into_iter().chain([lost]).collect()
}

fn benches(tally: &Tally) -> Vec<Value> {
    let benches = tally.benches.iter();
    benches
        .map(|(state, count)| Value::of_state(state, *count))
        .collect()
}
