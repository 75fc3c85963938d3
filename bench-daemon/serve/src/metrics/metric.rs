//! Definition of a metric.

use super::{sample::Sample, snapshot::Snapshot};

/// Beginning of every name.
pub const PREFIX: &str = "eis_bench_";

/// Course of a quantity over time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// It goes up and down.
    Gauge,
    /// It only grows, from the start of the server on.
    Counter,
}

/// A quantity that is measured.
pub struct Metric {
    /// Its name after [`PREFIX`]. It ends in the unit, as Prometheus requires.
    pub name: &'static str,
    /// Its course.
    pub kind: Kind,
    /// Its unit by UCUM, as OpenTelemetry wants it; empty for a state.
    pub unit: &'static str,
    /// Its meaning, in one sentence.
    pub help: &'static str,
    /// Its values now, one for each set of labels.
    pub read: fn(&Snapshot<'_>) -> Vec<Sample>,
}

/// A quantity that goes up and down.
pub(super) const fn gauge(
    name: &'static str,
    unit: &'static str,
    help: &'static str,
    read: fn(&Snapshot<'_>) -> Vec<Sample>,
) -> Metric {
    Metric {
        name,
        kind: Kind::Gauge,
        unit,
        help,
        read,
    }
}

/// A quantity that only grows.
pub(super) const fn counter(
    name: &'static str,
    unit: &'static str,
    help: &'static str,
    read: fn(&Snapshot<'_>) -> Vec<Sample>,
) -> Metric {
    Metric {
        kind: Kind::Counter,
        ..gauge(name, unit, help, read)
    }
}

/// Defines metrics: kind, name, unit, meaning, values now.
macro_rules! metrics {
    ($(#[$doc:meta])* $($kind:ident $name:literal ($unit:literal) $help:literal = $read:expr;)+) => {
        $(#[$doc])*
        pub(super) const METRICS: &[Metric] = &[$($kind($name, $unit, $help, $read)),+];
    };
}
pub(super) use metrics;
