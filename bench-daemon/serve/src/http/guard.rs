//! Guards every request: rates, the host that it names, the size of its body. Every answer gets one
//! shape of refusal, headers that restrict browsers, and a line in the audit trail.

use std::net::IpAddr;

use axum::{
    body::{Body, to_bytes},
    extract::{Request, State},
    http::{Method, StatusCode, Uri, header},
    middleware::Next,
    response::{IntoResponse, Response},
};
use bench_http::{Code, Hosts, Refusal, restrict};

use super::{
    App,
    body::{self, BodyBounds},
    caller::{Named, Peer},
};
use crate::{audit::By, traced};

/// A stop, of one bench or of all.
pub fn is_stop(method: &Method, uri: &Uri) -> bool {
    method == Method::POST && uri.path().ends_with("/stop")
}

/// Around every request.
pub async fn guard(State(app): State<App>, mut request: Request, next: Next) -> Response {
    let (method, path) = (request.method().clone(), request.uri().path().to_owned());
    let peer = request
        .extensions()
        .get::<Peer>()
        .map_or(IpAddr::from([0, 0, 0, 0]), |peer| peer.0);
    let named = Named::default();
    request.extensions_mut().insert(named.clone());
    let span = traced::begin(&app.server, &mut request);
    let response = match admit(&app, peer, request).await {
        Ok(request) => next.run(request).await,
        Err(refusal) => refusal.into_response(),
    };
    let response = dressed(response).await;
    app.server.counts.answered(response.status().as_u16());
    if let Some(span) = span {
        traced::answered(span, traced::name(&method, &path), response.status());
    }
    let known = named.0.get().is_some();
    // Attempts of unknown callers must not fill the disk.
    let noted = known || app.strangers.take(peer, app.server.clock.now_s());
    // An entry of an agent is a line of its own.
    let is_entry = path == "/api/v1/audit" && response.status().is_success();
    if noted && !is_entry && !matches!(method, Method::GET | Method::HEAD | Method::OPTIONS) {
        let code = response
            .extensions()
            .get::<Code>()
            .map_or_else(String::new, |code| format!(" {}", code.0));
        let outcome = format!("{}{code}", response.status().as_u16());
        let who = named.0.get().map_or("-", String::as_str);
        if let Err(error) = app.server.audit.write(
            By {
                who,
                from: &peer.to_string(),
            },
            &format!("{method} {path}"),
            &outcome,
        ) {
            tracing::error!("the audit trail cannot be written: {error}");
        }
    }
    response
}

async fn admit(app: &App, peer: IpAddr, request: Request) -> Result<Request, Refusal> {
    let (now_s, limits) = (app.server.clock.now_s(), &app.server.settings.limits);
    // Stop requests bypass the rate limit.
    if !is_stop(request.method(), request.uri()) && !app.rate.take(peer, now_s) {
        return Err(Refusal::of(
            StatusCode::TOO_MANY_REQUESTS,
            "expected fewer requests, found more than this server bears from one peer",
        ));
    }
    if request
        .uri()
        .path_and_query()
        .is_some_and(|path| path.as_str().len() > 2048)
    {
        return Err(Refusal::of(
            StatusCode::BAD_REQUEST,
            "expected a path of at most 2048 bytes, found a longer one",
        ));
    }
    let hosts = Hosts {
        is_local: app.server.settings.listen.ip().is_loopback(),
        proxy: app.server.settings.proxy_host.as_deref(),
    };
    hosts.admit(request.headers(), request.uri())?;
    // A caller without a token must not send a body as large as a file.
    if body::is_file(request.method(), request.uri()) {
        return Ok(request);
    }
    let (parts, body) = request.into_parts();
    let bounds = BodyBounds {
        most: limits.body_bytes,
        patience_s: limits.patience_s,
    };
    let bytes = body::whole(&app.server.clock, body, bounds).await?;
    Ok(Request::from_parts(parts, Body::from(bytes)))
}

/// Headers for browsers, and the one shape of a refusal.
async fn dressed(response: Response) -> Response {
    let status = response.status();
    let json = response
        .headers()
        .get(header::CONTENT_TYPE)
        .is_some_and(|kind| kind.as_bytes().starts_with(b"application/json"));
    let mut response = if status.as_u16() >= 400 && !json {
        let allow = response.headers().get(header::ALLOW).cloned();
        let text = to_bytes(response.into_body(), 16 * 1024)
            .await
            .unwrap_or_default();
        let text = String::from_utf8_lossy(&text).into_owned();
        let text = if text.is_empty() {
            status.canonical_reason().unwrap_or_default().to_owned()
        } else {
            text
        };
        let mut response = Refusal::of(status, text).into_response();
        if let Some(allow) = allow {
            response.headers_mut().insert(header::ALLOW, allow);
        }
        response
    } else {
        response
    };
    restrict(response.headers_mut());
    response
}
