//! Quantities of the server itself.

use std::sync::atomic::{AtomicU64, Ordering};

use super::{
    metric::{Metric, counter, gauge, metrics},
    sample::Sample,
    snapshot::Snapshot,
};
use crate::health::Disk;

fn count(counter: &AtomicU64) -> Vec<Sample> {
    Sample::plain(counter.load(Ordering::Relaxed) as f64)
}

fn answers(now: &Snapshot<'_>) -> Vec<Sample> {
    let of_class = |class: usize| {
        let answers = now.server.counts.answers.get(class);
        Sample {
            labels: vec![("class", format!("{class}xx"))],
            value: answers.map_or(0, |count| count.load(Ordering::Relaxed)) as f64,
        }
    };
    (1..=5).map(of_class).collect()
}

fn disk(now: &Snapshot<'_>, value: impl Fn(Disk) -> f64) -> Vec<Sample> {
    now.noted
        .disk
        .map_or_else(Vec::new, |disk| Sample::plain(value(disk)))
}

/// Returns notices by target, so that both series exist from the start.
fn notices(now: &Snapshot<'_>, sent: bool) -> Vec<Sample> {
    let of = |(target, counts): (&'static str, [u64; 2])| Sample {
        labels: vec![("target", target.to_owned())],
        value: counts[usize::from(sent)] as f64,
    };
    now.server.notices.tries().into_iter().map(of).collect()
}

/// Events are numbered from the time of the start on, ms.
fn events(now: &Snapshot<'_>) -> Vec<Sample> {
    let first = (now.server.counts.started_unix_s * 1.0e3) as u64;
    Sample::plain(now.server.hub.latest().saturating_sub(first) as f64)
}

/// Number of runs that wait in the queue.
fn waiting(now: &Snapshot<'_>) -> f64 {
    let waits = now.queue.iter().filter(|item| item.process.is_none());
    waits.count() as f64
}

fn version(_: &Snapshot<'_>) -> Vec<Sample> {
    vec![Sample {
        labels: vec![("version", env!("CARGO_PKG_VERSION").to_owned())],
        value: 1.0,
    }]
}

metrics! {
    /// All metrics of the server.
    gauge "build_info" ("") "The version that runs; always 1." = version;
    gauge "start_timestamp_seconds" ("s") "Time at which the server was started, since 1970."
        = |now| Sample::plain(now.server.counts.started_unix_s);
    counter "http_answers_total" ("{answer}") "Answers by class of status." = answers;
    gauge "http_connections" ("{connection}") "Connections at present."
        = |now| count(&now.server.counts.connections);
    gauge "event_listeners" ("{listener}") "Listeners to the event stream at present."
        = |now| count(&now.server.counts.listeners);
    counter "event_listeners_lagged_total" ("{time}")
        "Times that a listener was notified of missed events."
        = |now| count(&now.server.counts.lagged);
    counter "events_total" ("{event}") "Events since the start." = events;
    counter "supervisor_looks_total" ("{look}")
        "Looks of the supervisor at its benches, about five a second."
        = |now| count(&now.server.counts.looks);
    gauge "queue_waiting" ("{run}") "Runs that wait in the queue."
        = |now| Sample::plain(waiting(now));
    gauge "disk_free_bytes" ("By") "Bytes that may still be written on the disk of the data folder."
        = |now| disk(now, |disk| disk.free_bytes);
    gauge "disk_size_bytes" ("By") "Size of the disk of the data folder."
        = |now| disk(now, |disk| disk.size_bytes);
    gauge "disk_free_ratio" ("1") "Share of the disk of the data folder that is free."
        = |now| disk(now, |disk| disk.free_bytes / disk.size_bytes);
    gauge "catalog_scanning" ("") "The catalogue is being brought up to date."
        = |now| Sample::plain(f64::from(now.server.catalog.state().scanning));
    gauge "catalog_scanned_timestamp_seconds" ("s")
        "Time of the last scan of the catalogue that succeeded, since 1970; 0 before the first."
        = |now| Sample::plain(now.server.catalog.state().scanned_unix_s);
    counter "catalog_scans_failed_total" ("{scan}") "Scans of the catalogue that failed."
        = |now| Sample::plain(now.server.catalog.state().failed as f64);
    counter "notices_sent_total" ("{notice}") "Tries to send a notice that succeeded."
        = |now| notices(now, true);
    counter "notices_failed_total" ("{notice}") "Tries to send a notice that failed."
        = |now| notices(now, false);
    counter "telemetry_spans_total" ("{span}") "Spans of the server that have ended."
        = |now| count(&now.server.telemetry.spans);
    counter "telemetry_spans_sent_total" ("{span}")
        "Spans of the server that a collector has taken."
        = |now| count(&now.server.telemetry.spans_sent);
    counter "telemetry_failures_total" ("{request}") "Requests to a collector that failed."
        = |now| count(&now.server.telemetry.failures);
}
