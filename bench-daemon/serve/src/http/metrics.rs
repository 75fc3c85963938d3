//! Metrics for Prometheus, in its text format.

use std::fmt::{Display, Formatter, Result, Write};

use axum::{
    extract::State,
    http::header,
    response::{IntoResponse, Response},
};

use super::{App, caller::Reader};
use crate::{
    Server,
    metrics::{self, Kind, PREFIX, Sample, Snapshot},
};

/// Returns the metrics of the server and its benches, in the text format of Prometheus.
#[utoipa::path(
    get,
    path = "/metrics",
    tag = "events",
    responses((status = 200, body = String, content_type = "text/plain")),
    security(("token" = ["read"]))
)]
pub async fn metrics(_caller: Reader, State(app): State<App>) -> Response {
    (
        [(header::CONTENT_TYPE, "text/plain; version=0.0.4")],
        text(&app.server),
    )
        .into_response()
}

fn text(server: &Server) -> String {
    let now = Snapshot::of(server);
    let mut text = String::new();
    for metric in metrics::all() {
        let (name, help) = (metric.name, metric.help);
        let kind = match metric.kind {
            Kind::Gauge => "gauge",
            Kind::Counter => "counter",
        };
        let _ = writeln!(
            text,
            "# HELP {PREFIX}{name} {help}\n# TYPE {PREFIX}{name} {kind}"
        );
        for sample in (metric.read)(&now) {
            let _ = writeln!(text, "{PREFIX}{name}{} {}", Labels(&sample), sample.value);
        }
    }
    text
}

/// Labels in braces; empty without labels.
struct Labels<'a>(&'a Sample);

impl Display for Labels<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        for (number, (name, value)) in self.0.labels.iter().enumerate() {
            let before = if number == 0 { '{' } else { ',' };
            write!(f, "{before}{name}={value:?}")?;
        }
        if self.0.labels.is_empty() {
            return Ok(());
        }
        f.write_char('}')
    }
}
