//! The one list of what is measured of a server. `/metrics` and OTLP are made of it, so that they
//! never differ.

mod archive;
mod bench;
mod fleet;
mod metric;
mod sample;
mod server;
mod snapshot;

pub use metric::{Kind, Metric, PREFIX};
pub use sample::Sample;
pub use snapshot::Snapshot;

/// Everything that is measured.
pub fn all() -> impl Iterator<Item = &'static Metric> {
    server::METRICS
        .iter()
        .chain(bench::METRICS)
        .chain(archive::METRICS)
        .chain(fleet::METRICS)
}
