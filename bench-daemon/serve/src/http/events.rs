//! Sends all changes as server-sent events. Each listener reads the shared store of events at its
//! own pace. A listener that is too slow gets a notice that it has missed some, and continues
//! with the stored ones.

use std::{
    convert::Infallible,
    fmt::Write,
    sync::{Arc, atomic::Ordering},
};

use axum::{
    body::{Body, Bytes},
    extract::{Query, State},
    http::{HeaderMap, header},
    response::{IntoResponse, Response},
};
use futures_util::stream;
use serde::Deserialize;
use utoipa::IntoParams;

use super::{App, caller::Reader};
use crate::Server;

/// Maximum time without data on the stream, s.
const HEARTBEAT_S: f64 = 15.0;

/// Start position of a listener.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct From {
    /// The last event that was received, for clients that cannot set the header `Last-Event-ID`.
    last_event_id: Option<String>,
}

struct Listener {
    server: Arc<Server>,
    wake: tokio::sync::watch::Receiver<u64>,
    number: u64,
    greeting: Option<&'static str>,
    token_sha256: Option<String>,
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.server.counts.listeners.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Streams all changes: `live` (a bench), `spectrum`, `run`, `queue`, `stop`, `analysis`,
/// `investigation`, `notice`, `catalog` (it was scanned). The first event is `hello`; `lost` means
/// that events were missed, so that the client must request the present state. With the header
/// `Last-Event-ID` the stream continues after that event.
#[utoipa::path(
    get,
    path = "/api/v1/events",
    tag = "events",
    params(From, ("Last-Event-ID" = Option<String>, Header)),
    responses((status = 200, body = String, content_type = "text/event-stream")),
    security(("token" = ["read"]))
)]
pub async fn events(
    caller: Reader,
    State(app): State<App>,
    Query(from): Query<From>,
    headers: HeaderMap,
) -> Response {
    let server = app.server;
    let last = headers
        .get("last-event-id")
        .and_then(|value| value.to_str().ok().map(str::to_owned))
        .or(from.last_event_id);
    let known = last.as_deref().map(|id| server.hub.number(id));
    let (number, greeting) = match known {
        None => (server.hub.latest(), "hello"),
        Some(Some(number)) => (number, "hello"),
        // The identifier belongs to an earlier server, or is invalid.
        Some(None) => (server.hub.latest(), "lost"),
    };
    server.counts.listeners.fetch_add(1, Ordering::Relaxed);
    let listener = Listener {
        wake: server.hub.wake(),
        server,
        number,
        greeting: Some(greeting),
        token_sha256: caller.token_sha256,
    };
    let body = Body::from_stream(stream::unfold(listener, next));
    (
        [
            (header::CONTENT_TYPE, "text/event-stream"),
            (header::CACHE_CONTROL, "no-store"),
        ],
        body,
    )
        .into_response()
}

async fn next(mut listener: Listener) -> Option<(Result<Bytes, Infallible>, Listener)> {
    loop {
        // A wake between this read and the wait is not missed.
        listener.wake.mark_unchanged();
        // A token may have been revoked since the last event.
        if !listener.welcome() {
            return None;
        }
        let text = listener.text();
        if !text.is_empty() {
            return Some((Ok(Bytes::from(text)), listener));
        }
        if listener.server.hub.closed() {
            return None;
        }
        let clock = listener.server.clock.clone();
        tokio::select! {
            _ = listener.wake.changed() => {}
            () = clock.sleep_s(HEARTBEAT_S) => {
                return Some((Ok(Bytes::from_static(b": still here\n\n")), listener));
            }
        }
    }
}

impl Listener {
    /// New events, as text of the protocol.
    fn text(&mut self) -> String {
        let mut text = String::new();
        if let Some(greeting) = self.greeting.take() {
            let _ = write!(
                text,
                "id: {}\nevent: {greeting}\ndata: {{}}\n\n",
                self.server.hub.id(self.number)
            );
        }
        let news = self.server.hub.after(self.number);
        if news.lost {
            self.server.counts.lagged.fetch_add(1, Ordering::Relaxed);
            text.push_str("event: lost\ndata: {}\n\n");
        }
        for event in &news.events {
            let _ = write!(
                text,
                "id: {}\nevent: {}\ndata: {}\n\n",
                self.server.hub.id(event.number),
                event.kind,
                event.data
            );
            self.number = event.number;
        }
        text
    }

    /// A token that was revoked ends the stream, and so does the first token that is made, of a
    /// stream that was opened without one.
    fn welcome(&self) -> bool {
        match &self.token_sha256 {
            Some(sha256) => matches!(self.server.tokens.whose_sha256(sha256), Ok(Some(_))),
            None => self.server.open_to_all().unwrap_or(false),
        }
    }
}
