//! Posts exported telemetry with the HTTP client of the webhooks. Only the exporter threads call
//! it, so it blocks nothing else.

use std::{
    future::{self, Future},
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use instruments::clock::{Clock, TimeMode};
use opentelemetry_http::{Bytes, HttpClient, HttpError, Request, Response};

use super::counts::TelemetryCounts;
use bench_plan::support::logging::TELEMETRY;

/// A collector may take so long for one request: at a stop not much more than that is in flight.
const PATIENCE: Duration = Duration::from_secs(5);
/// Maximum number of bytes of a reply that are read; replies of a collector are short.
const MOST_ANSWER_BYTES: u64 = 64 << 10;
/// Minimum interval between two reports of a collector that accepts nothing, s.
const TELL_S: f64 = 600.0;

/// A client on `ureq`.
#[derive(Debug)]
pub(super) struct Poster {
    agent: ureq::Agent,
    clock: Clock,
    counts: Arc<TelemetryCounts>,
    /// Milliseconds of the clock at which the last warning was given, and 1; 0 before the first.
    warned: AtomicU64,
}

impl Poster {
    pub(super) fn new(counts: &Arc<TelemetryCounts>) -> Self {
        let config = ureq::Agent::config_builder()
            .timeout_global(Some(PATIENCE))
            .max_redirects(0)
            .http_status_as_error(false)
            .build();
        Self {
            agent: config.into(),
            clock: Clock::start(TimeMode::Real),
            counts: counts.clone(),
            warned: AtomicU64::new(0),
        }
    }

    fn post(&self, request: Request<Bytes>) -> Result<Response<Bytes>, HttpError> {
        let size = request.body().len() as u64;
        let answer = self.agent.run(request.map(|body| body.to_vec()))?;
        let (parts, body) = answer.into_parts();
        let mut body = body.into_with_config().limit(MOST_ANSWER_BYTES).reader();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut body, &mut bytes)?;
        if parts.status.is_success() {
            self.counts.bytes.fetch_add(size, Ordering::Relaxed);
        }
        Ok(Response::from_parts(parts, bytes.into()))
    }

    /// TelemetryCounts a failure, and reports it unless that was done recently.
    fn failed(&self, what: &dyn std::fmt::Display) {
        self.counts.failures.fetch_add(1, Ordering::Relaxed);
        let now_ms = (self.clock.now_s() * 1.0e3) as u64 + 1;
        let last = self.warned.load(Ordering::Relaxed);
        if last == 0 || (now_ms - last) as f64 >= TELL_S * 1.0e3 {
            self.warned.store(now_ms, Ordering::Relaxed);
            tracing::warn!(
                target: TELEMETRY,
                "telemetry is not taken, and nothing waits for it: {what}"
            );
        }
    }
}

impl HttpClient for Poster {
    fn send_bytes<'a, 'b>(
        &'a self,
        request: Request<Bytes>,
    ) -> Pin<Box<dyn Future<Output = Result<Response<Bytes>, HttpError>> + Send + 'b>>
    where
        'a: 'b,
        Self: 'b,
    {
        let address = request.uri().clone();
        let outcome = self.post(request);
        match &outcome {
            Ok(answer) if answer.status().is_success() => {}
            Ok(answer) => self.failed(&format!("{address}: {}", answer.status())),
            Err(error) => self.failed(&format!("{address}: {error}")),
        }
        Box::pin(future::ready(outcome))
    }
}
