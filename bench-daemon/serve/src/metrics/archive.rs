//! Metrics of the archive, as `eis-archive` wrote its state last; empty if there is none.

use analysis::run_folder::archive_status::ArchiveStatus;

use super::{
    metric::{Metric, gauge, metrics},
    sample::Sample,
    snapshot::Snapshot,
};

fn of(now: &Snapshot<'_>, read: impl Fn(&ArchiveStatus) -> Vec<Sample>) -> Vec<Sample> {
    now.noted.archive.as_ref().map_or_else(Vec::new, read)
}

/// Values under one label.
fn labelled<const N: usize>(label: &'static str, values: [(&str, f64); N]) -> Vec<Sample> {
    let sample = |(name, value): (&str, f64)| Sample {
        labels: vec![(label, name.to_owned())],
        value,
    };
    values.into_iter().map(sample).collect()
}

fn runs(now: &ArchiveStatus) -> Vec<Sample> {
    let states = [
        ("archived", now.archived as f64),
        ("pending", now.pending as f64),
        ("failed", now.failed as f64),
        ("refused", now.refused as f64),
        ("waiting", now.waiting as f64),
    ];
    labelled("state", states)
}

fn bytes(now: &ArchiveStatus) -> Vec<Sample> {
    let sizes = [
        ("archived", now.bytes as f64),
        ("sent", now.sent_bytes as f64),
        ("moved", now.moved_bytes as f64),
    ];
    labelled("kind", sizes)
}

metrics! {
    /// All metrics of the archive.
    gauge "archive_runs" ("{run}") "Runs by their state in the archive." = |now| of(now, runs);
    gauge "archive_bytes" ("By")
        "Size of the archived runs, what was sent of it, and what is in the store only."
        = |now| of(now, bytes);
    gauge "archive_last_verified_timestamp_seconds" ("s")
        "When the latest run was verified, since 1970."
        = |now| of(now, |now| now.last_verified_unix_s.map_or_else(Vec::new, Sample::plain));
    gauge "archive_written_timestamp_seconds" ("s")
        "When `eis-archive` wrote its state last, since 1970."
        = |now| of(now, |now| Sample::plain(now.written_unix_s));
    gauge "archive_trouble" ("") "The last push has ended before its work was done."
        = |now| of(now, |now| Sample::plain(f64::from(now.trouble.is_some())));
}
