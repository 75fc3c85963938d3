//! Traces and metrics to a collector. Nothing waits for a collector, and nothing is sent unless the
//! feature `otlp` is built in and an address is set.

#[cfg(feature = "otlp")]
mod client;
#[cfg(feature = "otlp")]
pub mod context;
#[cfg(feature = "otlp")]
mod counted;
pub mod counts;
pub mod endpoint;
#[cfg(feature = "otlp")]
mod exporter;
#[cfg(not(feature = "otlp"))]
#[path = "telemetry/off.rs"]
mod exporter;

pub use exporter::{Telemetry, Tracer, record_failure, set_parent};

/// Environment variable that sets the level of detail of traces.
pub const DETAIL_VARIABLE: &str = "EIS_BENCH_TRACES";
/// Its value for a span per message to an instrument.
pub const EXCHANGES: &str = "exchanges";
/// Environment variable that hands the context of a trace to a process.
pub const CONTEXT_VARIABLE: &str = "TRACEPARENT";
/// Why a program without the feature `otlp` sends nothing.
pub const WITHOUT_OTLP: &str =
    "this program is built without OTLP; `cargo build --features otlp` adds it";
