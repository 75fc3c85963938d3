//! Spans of the server: of requests that change something, of the wait in the queue, and of the
//! process of a run. Together with the spans of the run itself they are one trace.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use axum::{
    extract::{FromRequestParts, Request},
    http::{Method, StatusCode, request::Parts},
};
use opentelemetry::{
    KeyValue,
    trace::{Span as _, SpanBuilder, SpanKind, Status, Tracer},
};
use opentelemetry_sdk::trace::Span;

use super::{Server, jobs::Ended, queue::Item};
use bench_evaluate::support::telemetry::context;

/// The trace context of the work for a request, as text; empty if tracing is off.
#[derive(Debug, Clone, Default)]
pub struct Traced(pub Option<String>);

impl<S: Sync> FromRequestParts<S> for Traced {
    type Rejection = std::convert::Infallible;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Self::Rejection> {
        Ok(parts.extensions.get().cloned().unwrap_or_default())
    }
}

/// Begins the span of a request that changes something, and attaches it to the request. Requests
/// that only read get no span, because pages poll constantly.
pub fn begin(server: &Server, request: &mut Request) -> Option<Span> {
    if matches!(
        *request.method(),
        Method::GET | Method::HEAD | Method::OPTIONS
    ) {
        return None;
    }
    let header = request.headers().get(context::HEADER);
    let parent = header
        .and_then(|header| header.to_str().ok())
        .and_then(context::parent);
    let Some(tracer) = &server.tracer else {
        let text = parent.map(|parent| context::of(&parent));
        request.extensions_mut().insert(Traced(text));
        return None;
    };
    let span = tracer.build_with_context(of_request(request), &parent.unwrap_or_default());
    let text = context::text(span.span_context());
    request.extensions_mut().insert(Traced(Some(text)));
    Some(span)
}

fn of_request(request: &Request) -> SpanBuilder {
    let method = request.method().as_str().to_owned();
    SpanBuilder::from_name(method.clone())
        .with_kind(SpanKind::Server)
        .with_attributes([
            KeyValue::new("http.request.method", method),
            KeyValue::new("url.path", request.uri().path().to_owned()),
        ])
}

/// Returns the span name of a request: its method and the first part of the path that
/// distinguishes routes.
pub fn name(method: &Method, path: &str) -> String {
    let part = |path: &str| path.split('/').next().unwrap_or_default().to_owned();
    match path.strip_prefix("/api/v1/") {
        Some(path) => format!("{method} /api/v1/{}", part(path)),
        None => method.to_string(),
    }
}

/// Ends the span of a request.
pub fn answered(mut span: Span, name: String, status: StatusCode) {
    let code = status.as_u16();
    // An unknown path may have any name, and the number of span names must stay small.
    if status != StatusCode::NOT_FOUND {
        span.update_name(name);
    }
    span.set_attribute(KeyValue::new("http.response.status_code", i64::from(code)));
    if status.is_server_error() {
        span.set_attribute(KeyValue::new("error.type", code.to_string()));
        span.set_status(Status::error(""));
    }
    span.end();
}

/// The wait of a run in the queue, now that its process is there.
pub fn waited(server: &Server, item: &Item) {
    let Some(process) = &item.process else { return };
    if let Some(span) = of_run(server, item, "wait in queue", item.submitted_unix_s) {
        end(span, process.started_unix_s);
    }
}

/// The process of a run, now that its end was noticed.
pub fn ended(server: &Server, item: &Item, ended: &Ended) {
    let began_s = item
        .process
        .as_ref()
        .map_or(ended.unix_s, |process| process.started_unix_s);
    let Some(mut span) = of_run(server, item, "run process", began_s) else {
        return;
    };
    span.set_attribute(KeyValue::new("eis_bench.ended", ended.how.clone()));
    if let Some(code) = ended.code {
        span.set_attribute(KeyValue::new("process.exit.code", i64::from(code)));
    }
    if !ended.finished {
        span.set_status(Status::error(ended.how.clone()));
    }
    end(span, ended.unix_s);
}

fn of_run(server: &Server, item: &Item, name: &'static str, unix_s: f64) -> Option<Span> {
    let tracer = server.tracer.as_ref()?;
    let parent = item.traceparent.as_deref().and_then(context::parent);
    let builder = SpanBuilder::from_name(name)
        .with_start_time(time(unix_s))
        .with_attributes([
            KeyValue::new("eis_bench.run", item.run.clone()),
            KeyValue::new("eis_bench.experiment", item.experiment.clone()),
            KeyValue::new("eis_bench.bench", item.bench.clone()),
        ]);
    Some(tracer.build_with_context(builder, &parent.unwrap_or_default()))
}

fn end(mut span: Span, unix_s: f64) {
    span.end_with_timestamp(time(unix_s));
}

fn time(unix_s: f64) -> SystemTime {
    UNIX_EPOCH + Duration::try_from_secs_f64(unix_s).unwrap_or_default()
}
