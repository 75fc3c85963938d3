//! Stands in for the exporter in a program that is built without the feature `otlp`: nothing is
//! sent.

use std::sync::Arc;

use tracing_subscriber::layer::Identity;

use super::{
    counts::TelemetryCounts,
    endpoint::{self, Endpoints},
};
use bench_plan::support::terminal::remark;

/// There is no tracer.
#[derive(Debug, Clone)]
pub enum Tracer {}

/// Sends nothing.
#[derive(Debug, Default)]
pub struct Telemetry {
    counts: Arc<TelemetryCounts>,
}

impl Telemetry {
    /// Warns if the environment asks for telemetry, which this program cannot send.
    pub fn from_environment(_instance: &str) -> Self {
        let asked = Endpoints::from_environment();
        if !endpoint::is_disabled() && asked.is_ok_and(|asked| !asked.is_empty()) {
            remark!("note: telemetry is off: {}", super::WITHOUT_OTLP);
        }
        Self::default()
    }

    /// Returns `None`: tracing is off.
    pub fn tracer(&self) -> Option<Tracer> {
        None
    }

    /// Returns `None`: no spans are sent.
    pub fn layer(&self) -> Option<Identity> {
        None
    }

    /// Returns the counts, which stay 0.
    pub fn counts(&self) -> &Arc<TelemetryCounts> {
        &self.counts
    }

    /// Does nothing.
    pub fn end(&self) {}
}

/// Does nothing.
pub fn set_parent(_span: &tracing::Span) {}

/// Does nothing.
pub fn record_failure(_span: &tracing::Span, _code: u8, _reason: String) {}
