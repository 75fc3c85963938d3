//! Telemetry of the server: what its file or the environment asks for, and the metrics of `/metrics`
//! sent to a collector.

use std::sync::{Arc, Weak};

use opentelemetry::{
    KeyValue,
    metrics::{AsyncInstrument, Meter},
};

use super::{
    Server,
    metrics::{self, Kind, Metric, PREFIX, Snapshot},
    settings::Settings,
};
use bench_evaluate::support::telemetry::{Telemetry, endpoint::Endpoints};

/// Starts the configured telemetry. A missing collector never stops the server.
pub fn start(settings: &Settings) -> Telemetry {
    let instance = settings.listen.port().to_string();
    let Some(base) = &settings.telemetry.otlp else {
        return Telemetry::from_environment(&instance);
    };
    let started = Endpoints::of_base(base).and_then(|found| Telemetry::start(found, &instance));
    started.unwrap_or_else(|error| {
        tracing::warn!("telemetry is off: {error}");
        Telemetry::default()
    })
}

/// Sends the metrics of a server from now on.
pub fn measure(mut telemetry: Telemetry, server: &Arc<Server>) -> Telemetry {
    let server = Arc::downgrade(server);
    let defined = telemetry.measure(|meter| {
        metrics::all().for_each(|metric| define(meter, metric, server.clone()));
    });
    if let Err(error) = defined {
        tracing::warn!("no metrics are sent: {error}");
    }
    telemetry
}

fn define(meter: &Meter, metric: &'static Metric, server: Weak<Server>) {
    let name = format!("{PREFIX}{}", metric.name);
    let observe = move |to: &dyn AsyncInstrument<f64>| {
        let Some(server) = server.upgrade() else {
            return;
        };
        for sample in (metric.read)(&Snapshot::of(&server)) {
            let labels = sample.labels.into_iter();
            let labels: Vec<KeyValue> = labels
                .map(|(name, value)| KeyValue::new(name, value))
                .collect();
            to.observe(sample.value, &labels);
        }
    };
    match metric.kind {
        Kind::Gauge => drop(
            meter
                .f64_observable_gauge(name)
                .with_unit(metric.unit)
                .with_description(metric.help)
                .with_callback(observe)
                .build(),
        ),
        Kind::Counter => drop(
            meter
                .f64_observable_counter(name)
                .with_unit(metric.unit)
                .with_description(metric.help)
                .with_callback(observe)
                .build(),
        ),
    }
}
