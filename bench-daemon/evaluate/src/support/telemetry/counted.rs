//! TelemetryCounts spans when they end and when a collector has accepted them. The difference was lost, in
//! the full queue or in transit.

use std::{
    future::Future,
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use opentelemetry::Context;
use opentelemetry_sdk::{
    Resource,
    error::OTelSdkResult,
    trace::{Span, SpanData, SpanExporter, SpanProcessor},
};

use super::counts::TelemetryCounts;

/// A processor or an exporter whose spans are counted.
#[derive(Debug)]
pub(super) struct Counted<T> {
    pub(super) next: T,
    pub(super) counts: Arc<TelemetryCounts>,
}

impl<T: SpanExporter> SpanExporter for Counted<T> {
    fn export(&self, batch: Vec<SpanData>) -> impl Future<Output = OTelSdkResult> + Send {
        let number = batch.len() as u64;
        async move {
            let outcome = self.next.export(batch).await;
            if outcome.is_ok() {
                self.counts.spans_sent.fetch_add(number, Ordering::Relaxed);
            }
            outcome
        }
    }

    fn shutdown_with_timeout(&self, timeout: Duration) -> OTelSdkResult {
        self.next.shutdown_with_timeout(timeout)
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.next.set_resource(resource);
    }
}

impl<T: SpanProcessor> SpanProcessor for Counted<T> {
    fn on_start(&self, span: &mut Span, context: &Context) {
        self.next.on_start(span, context);
    }

    fn on_end(&self, span: SpanData) {
        self.counts.spans.fetch_add(1, Ordering::Relaxed);
        self.next.on_end(span);
    }

    fn force_flush(&self) -> OTelSdkResult {
        self.next.force_flush()
    }

    fn shutdown_with_timeout(&self, timeout: Duration) -> OTelSdkResult {
        self.next.shutdown_with_timeout(timeout)
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.next.set_resource(resource);
    }
}
