//! TelemetryCounts of sent telemetry.

use std::sync::atomic::AtomicU64;

/// TelemetryCounts of sent telemetry since the start.
#[derive(Debug, Default)]
pub struct TelemetryCounts {
    /// Spans that ended here.
    pub spans: AtomicU64,
    /// Spans that a collector took.
    pub spans_sent: AtomicU64,
    /// Requests to a collector that failed.
    pub failures: AtomicU64,
    /// Bytes that were posted and taken.
    pub bytes: AtomicU64,
}
