//! The single list of the server's metrics. `/metrics` and OTLP are both generated from it, so
//! that they never differ.

mod archive;
mod bench;
mod metric;
mod sample;
mod server;
mod snapshot;

pub use metric::{Kind, Metric, PREFIX};
pub use sample::Sample;
pub use snapshot::Snapshot;

/// Returns all metrics.
pub fn all() -> impl Iterator<Item = &'static Metric> {
    server::METRICS
        .iter()
        .chain(bench::METRICS)
        .chain(archive::METRICS)
}
