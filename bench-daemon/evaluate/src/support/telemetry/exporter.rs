//! Sends spans and metrics over OTLP (HTTP with protobuf), from threads of its own with bounded
//! queues. What does not fit or is not taken is counted, and the end takes two seconds at most.

use std::{
    process,
    sync::{Arc, atomic::Ordering, mpsc},
    thread,
    time::Duration,
};

use opentelemetry::{
    KeyValue,
    metrics::{Meter, MeterProvider},
    trace::TracerProvider,
};
use opentelemetry_otlp::{
    MetricExporter, Protocol, RetryPolicy, SpanExporter, WithExportConfig, WithHttpConfig,
};
use opentelemetry_sdk::{
    Resource,
    metrics::SdkMeterProvider,
    resource::{EnvResourceDetector, TelemetryResourceDetector},
    trace::{BatchSpanProcessor, SdkTracer, SdkTracerProvider},
};

use tracing::level_filters::LevelFilter;
use tracing_opentelemetry::OpenTelemetrySpanExt;
use tracing_subscriber::{Layer, Registry, filter::filter_fn};

use super::{
    DETAIL_VARIABLE, EXCHANGES,
    client::Poster,
    context,
    counted::Counted,
    counts::TelemetryCounts,
    endpoint::{self, Endpoints},
};
use bench_plan::support::{logging::TELEMETRY, terminal::remark};

/// Begins spans and sends them.
pub type Tracer = SdkTracer;

/// Crates whose spans are sent.
const OURS: [&str; 3] = ["bench_core", "bench_daemon", "instruments"];

/// Name of the service, unless `OTEL_SERVICE_NAME` gives another.
const SERVICE: &str = "eis-bench";
const SERVICE_VARIABLE: &str = "OTEL_SERVICE_NAME";
/// Maximum time at the end to send the remaining telemetry.
const END: Duration = Duration::from_secs(2);

/// Traces and metrics to a collector.
#[derive(Debug, Default)]
pub struct Telemetry {
    endpoints: Endpoints,
    resource: Option<Resource>,
    tracers: Option<SdkTracerProvider>,
    meters: Option<SdkMeterProvider>,
    counts: Arc<TelemetryCounts>,
}

impl Telemetry {
    /// Starts the telemetry that the environment requests. A setting that cannot be used is
    /// reported and stays off, because telemetry must not make a measurement fail.
    pub fn from_environment(instance: &str) -> Self {
        if endpoint::is_disabled() {
            return Self::default();
        }
        let started = Endpoints::from_environment().and_then(|found| Self::start(found, instance));
        started.unwrap_or_else(|error| {
            // Lines that begin with the program's name say how a run ended.
            remark!("note: telemetry is off: {error}");
            Self::default()
        })
    }

    /// Starts traces; `instance` distinguishes this process from others on this machine.
    ///
    /// # Errors
    /// A setting of the environment that cannot be used, in words.
    pub fn start(endpoints: Endpoints, instance: &str) -> Result<Self, String> {
        if endpoints.is_empty() || endpoint::is_disabled() {
            return Ok(Self::default());
        }
        let mut telemetry = Self {
            endpoints,
            resource: Some(resource(instance)),
            ..Self::default()
        };
        telemetry.tracers = telemetry.tracers()?;
        Ok(telemetry)
    }

    /// Returns the tracer, or `None` if tracing is off.
    pub fn tracer(&self) -> Option<Tracer> {
        let tracers = self.tracers.as_ref()?;
        Some(tracers.tracer(SERVICE))
    }

    /// Returns the layer that sends spans of this program, with the warnings that fall into them.
    pub fn layer(&self) -> Option<impl Layer<Registry> + use<>> {
        self.tracer().map(layer_of)
    }

    /// Sends metrics from now on: `define` makes the instruments.
    ///
    /// # Errors
    /// As [`Telemetry::start`].
    pub fn measure(&mut self, define: impl FnOnce(&Meter)) -> Result<(), String> {
        let (Some(address), Some(resource)) = (&self.endpoints.metrics, &self.resource) else {
            return Ok(());
        };
        let exporter = self
            .over_http(MetricExporter::builder().with_http(), address)
            .build()
            .map_err(|error| error.to_string())?;
        let meters = SdkMeterProvider::builder()
            .with_periodic_exporter(exporter)
            .with_resource(resource.clone())
            .build();
        define(&meters.meter(SERVICE));
        self.meters = Some(meters);
        Ok(())
    }

    /// Returns counts of sent telemetry.
    pub fn counts(&self) -> &Arc<TelemetryCounts> {
        &self.counts
    }

    /// Sends the remaining telemetry, for two seconds at most.
    pub fn end(&self) {
        if self.tracers.is_none() && self.meters.is_none() {
            return;
        }
        let (tracers, meters) = (self.tracers.clone(), self.meters.clone());
        let (done, over) = mpsc::channel();
        let work = move || {
            let _ = tracers.map(|tracers| tracers.shutdown());
            let _ = meters.map(|meters| meters.shutdown());
            let _ = done.send(());
        };
        if thread::Builder::new()
            .name("telemetry".to_owned())
            .spawn(work)
            .is_ok()
        {
            let _ = over.recv_timeout(END);
        }
        self.tell_lost();
    }

    fn tell_lost(&self) {
        let spans = self.counts.spans.load(Ordering::Relaxed);
        let sent = self.counts.spans_sent.load(Ordering::Relaxed);
        if sent < spans {
            tracing::warn!(
                target: TELEMETRY,
                "telemetry: {} of {spans} spans were not taken", spans - sent
            );
        }
    }

    /// An exporter that posts to an address. One try each: while it is repeated, what comes next would
    /// be lost in its place.
    fn over_http<B: WithHttpConfig + WithExportConfig>(&self, exporter: B, address: &str) -> B {
        exporter
            .with_http_client(Poster::new(&self.counts))
            .with_retry_policy(RetryPolicy::disabled())
            .with_endpoint(address)
            .with_protocol(Protocol::HttpBinary)
    }

    fn tracers(&self) -> Result<Option<SdkTracerProvider>, String> {
        let (Some(address), Some(resource)) = (&self.endpoints.traces, &self.resource) else {
            return Ok(None);
        };
        let exporter = self
            .over_http(SpanExporter::builder().with_http(), address)
            .build()
            .map_err(|error| error.to_string())?;
        let exporter = Counted {
            next: exporter,
            counts: self.counts.clone(),
        };
        let processor = Counted {
            next: BatchSpanProcessor::builder(exporter).build(),
            counts: self.counts.clone(),
        };
        let tracers = SdkTracerProvider::builder()
            .with_span_processor(processor)
            .with_resource(resource.clone());
        Ok(Some(tracers.build()))
    }
}

fn layer_of(tracer: Tracer) -> impl Layer<Registry> {
    let level = match std::env::var(DETAIL_VARIABLE).as_deref() {
        Ok(EXCHANGES) => LevelFilter::TRACE,
        _ => LevelFilter::INFO,
    };
    let is_ours = |target: &str| OURS.iter().any(|krate| target.starts_with(krate));
    let is_sent = move |meta: &tracing::Metadata<'_>| {
        let most = if meta.is_span() {
            level
        } else {
            LevelFilter::WARN
        };
        is_ours(meta.target()) && *meta.level() <= most
    };
    tracing_opentelemetry::layer()
        .with_tracer(tracer)
        .with_location(false)
        .with_target(false)
        .with_threads(false)
        .with_tracked_inactivity(false)
        .with_context_activation(false)
        .with_filter(filter_fn(is_sent).with_max_level_hint(level))
}

/// Makes a span part of the trace of the process that started this one, if any.
pub fn set_parent(span: &tracing::Span) {
    if let Some(parent) = context::of_environment() {
        // Without tracing there is no span that could have a parent.
        let _ = span.set_parent(parent);
    }
}

/// Records in a span that its work failed, with an exit code and the reason.
pub fn record_failure(span: &tracing::Span, code: u8, reason: String) {
    span.set_attribute("error.type", i64::from(code).to_string());
    span.set_status(opentelemetry::trace::Status::error(reason));
}

/// Returns the resource attributes of all telemetry; the environment can add to them and change
/// them.
fn resource(instance: &str) -> Resource {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host = host.trim().to_owned();
    let own = [
        KeyValue::new("service.name", SERVICE),
        KeyValue::new("service.version", env!("CARGO_PKG_VERSION")),
        KeyValue::new("service.instance.id", format!("{host}:{instance}")),
        KeyValue::new("host.name", host),
        KeyValue::new("process.pid", i64::from(process::id())),
    ];
    let resource = Resource::builder_empty()
        .with_attributes(own)
        .with_detectors(&[
            Box::new(TelemetryResourceDetector),
            Box::new(EnvResourceDetector::new()),
        ]);
    match std::env::var(SERVICE_VARIABLE) {
        Ok(name) if !name.is_empty() => resource.with_service_name(name).build(),
        _ => resource.build(),
    }
}
