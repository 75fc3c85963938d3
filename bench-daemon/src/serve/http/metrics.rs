//! Figures for Prometheus, in its text format.

use std::{fmt::Write, sync::atomic::Ordering};

use axum::{
    extract::State,
    http::header,
    response::{IntoResponse, Response},
};

use super::{App, caller::Reader};
use crate::serve::{
    Server,
    archive::ArchiveNow,
    live::{BenchState, Live},
};

/// Figures of the server and its benches, in the text format of Prometheus.
#[utoipa::path(
    get,
    path = "/metrics",
    tag = "events",
    responses((status = 200, body = String, content_type = "text/plain")),
    security(("token" = ["read"]))
)]
pub async fn metrics(_caller: Reader, State(app): State<App>) -> Response {
    (
        [(header::CONTENT_TYPE, "text/plain; version=0.0.4")],
        text(&app.server),
    )
        .into_response()
}

fn text(server: &Server) -> String {
    let mut text = String::new();
    let mut family = |name: &str, kind: &str, help: &str, rows: Vec<(String, f64)>| {
        let _ = writeln!(
            text,
            "# HELP eis_bench_{name} {help}\n# TYPE eis_bench_{name} {kind}"
        );
        for (labels, value) in rows {
            let _ = writeln!(text, "eis_bench_{name}{labels} {value}");
        }
    };
    let count = |counter: &std::sync::atomic::AtomicU64| {
        vec![(String::new(), counter.load(Ordering::Relaxed) as f64)]
    };
    let answers = (1..=5).map(|class| {
        let answers = server
            .counts
            .answers
            .get(class)
            .map_or(0, |count| count.load(Ordering::Relaxed));
        (format!("{{class=\"{class}xx\"}}"), answers as f64)
    });
    family(
        "http_answers_total",
        "counter",
        "Answers by class of status.",
        answers.collect(),
    );
    family(
        "http_connections",
        "gauge",
        "Connections at present.",
        count(&server.counts.connections),
    );
    family(
        "event_listeners",
        "gauge",
        "Listeners to the event stream at present.",
        count(&server.counts.listeners),
    );
    family(
        "event_listeners_lagged_total",
        "counter",
        "Times that a listener was told that it had missed events.",
        count(&server.counts.lagged),
    );
    family(
        "events_total",
        "counter",
        "Events since the start.",
        vec![(String::new(), server.hub.latest() as f64)],
    );
    family(
        "supervisor_looks_total",
        "counter",
        "Looks of the supervisor.",
        count(&server.counts.looks),
    );
    let waiting = server
        .queue()
        .items()
        .iter()
        .filter(|item| item.process.is_none())
        .count();
    family(
        "queue_waiting",
        "gauge",
        "Places in the queue that wait.",
        vec![(String::new(), waiting as f64)],
    );
    let live = server.live().clone();
    let rows = |value: &dyn Fn(&Live) -> Option<f64>| {
        live.values()
            .filter_map(|live| {
                value(live).map(|value| (format!("{{bench=\"{}\"}}", live.bench), value))
            })
            .collect::<Vec<_>>()
    };
    let flag = |on: bool| Some(if on { 1.0 } else { 0.0 });
    let running = |live: &Live| flag(live.run.as_ref().is_some_and(|run| run.going));
    family("running", "gauge", "A run is in work.", rows(&running));
    family(
        "latched",
        "gauge",
        "The bench is latched after a trip.",
        rows(&|live| flag(live.trip.is_some())),
    );
    family(
        "stopping",
        "gauge",
        "The bench is being stopped.",
        rows(&|live| flag(live.state == BenchState::Stopping)),
    );
    family(
        "held",
        "gauge",
        "Nothing is begun on the bench.",
        rows(&|live| flag(live.held.is_some())),
    );
    // Whoever keeps these as a series must not be given what was read long ago, or of a control, as
    // what the cell is at now.
    let of_cell = |live: &Live| {
        live.reading
            .clone()
            .filter(|reading| reading.fresh && reading.fixture == "cell")
    };
    family(
        "cell_voltage_volts",
        "gauge",
        "Last reading of the run in work.",
        rows(&|live| of_cell(live)?.voltage_v),
    );
    family(
        "cell_current_amperes",
        "gauge",
        "Last reading of the run in work; positive for charge.",
        rows(&|live| of_cell(live)?.current_a),
    );
    family(
        "cell_temperature_celsius",
        "gauge",
        "Last reading of the run in work.",
        rows(&|live| of_cell(live)?.temperature_c),
    );
    family(
        "cell_soc_ratio",
        "gauge",
        "State of charge, while a run is in work.",
        rows(&|live| of_cell(live).and(live.soc).map(|soc| soc.share)),
    );
    family(
        "run_points_done",
        "gauge",
        "Points of the run that are finished.",
        rows(&|live| Some(live.run.as_ref()?.points_done as f64)),
    );
    family(
        "run_done_ratio",
        "gauge",
        "Share of the run that is done.",
        rows(&|live| Some(live.run.as_ref()?.done)),
    );
    if server.settings.archive.is_some() {
        of_archive(&server.archive.now().clone(), &mut family);
    }
    text
}

/// Figures of the archive.
fn of_archive(now: &ArchiveNow, family: &mut impl FnMut(&str, &str, &str, Vec<(String, f64)>)) {
    let states = [
        ("archived", now.archived),
        ("pending", now.pending),
        ("failed", now.failed),
        ("refused", now.refused),
        ("waiting", now.waiting),
    ];
    let states = states.map(|(state, runs)| (format!("{{state=\"{state}\"}}"), runs as f64));
    family(
        "archive_runs",
        "gauge",
        "Runs by their state in the archive.",
        states.to_vec(),
    );
    let sizes = [
        ("archived", now.bytes),
        ("sent", now.sent_bytes),
        ("moved", now.moved_bytes),
    ];
    let sizes = sizes.map(|(kind, bytes)| (format!("{{kind=\"{kind}\"}}"), bytes as f64));
    family(
        "archive_bytes",
        "gauge",
        "Size of the archived runs, what was sent of it, and what is in the store only.",
        sizes.to_vec(),
    );
    let last = now.last_verified_unix_s.into_iter();
    family(
        "archive_last_verified_seconds",
        "gauge",
        "When the latest run was verified, s since 1970.",
        last.map(|last| (String::new(), last)).collect(),
    );
    family(
        "archive_trouble",
        "gauge",
        "The last push has ended before its work was done.",
        vec![(String::new(), f64::from(u8::from(now.trouble.is_some())))],
    );
}
