//! Guards every request: rates, the host that it names, the size of its body. Every answer gets one
//! shape of refusal, headers that restrict browsers, and a line in the audit trail.

mod rate;

use std::net::IpAddr;

use axum::{
    body::{Body, to_bytes},
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header},
    middleware::Next,
    response::{IntoResponse, Response},
};

use super::{
    App,
    body::{self, BodyBounds},
    caller::{Named, Peer},
    problem::{Code, Refusal},
};
use crate::{audit::By, traced};
use bench_plan::support::loopback::names_loopback;
pub use rate::{GUESSES, Rate};

/// Forbids content from other origins, inline scripts and frames.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
img-src 'self' data:; form-action 'none'; \
                      base-uri 'none'; frame-ancestors 'none'";

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
    same_host(
        request.headers(),
        request.uri(),
        app.server.settings.listen.ip().is_loopback(),
        app.server.settings.proxy_host.as_deref(),
    )?;
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

/// Pages of elsewhere must not speak with this server through a browser: neither under a name of
/// their own (DNS rebinding) nor from their own origin.
fn same_host(
    headers: &HeaderMap,
    uri: &Uri,
    loopback: bool,
    proxy: Option<&str>,
) -> Result<(), Refusal> {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    let host = text(header::HOST)
        .or_else(|| uri.authority().map(|authority| authority.as_str()))
        .unwrap_or_default();
    let name = host
        .rsplit_once(':')
        .filter(|(_, port)| port.chars().all(|c| c.is_ascii_digit()))
        .map_or(host, |(name, _)| name);
    if loopback && !names_loopback(name) && proxy != Some(host) {
        let message = format!("expected the host localhost, 127.0.0.1 or [::1], found {host:?}");
        return Err(Refusal::new(StatusCode::FORBIDDEN, "other_host", message));
    }
    match text(header::ORIGIN) {
        Some(origin)
            if origin
                .split_once("://")
                .is_none_or(|(_, origin)| origin != host) =>
        {
            Err(Refusal::new(
                StatusCode::FORBIDDEN,
                "other_origin",
                format!("expected a page of this server, found one of {origin:?}"),
            ))
        }
        _ => Ok(()),
    }
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
    let headers = response.headers_mut();
    let fixed = [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::CACHE_CONTROL, "no-store"),
    ];
    for (name, value) in fixed {
        headers
            .entry(name)
            .or_insert(HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_refills_and_each_peer_has_its_own() {
        let rate = Rate::new(2.0, 3.0);
        let (a, b) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        assert_eq!(
            [0.0, 0.0, 0.0, 0.0, 0.4, 0.6].map(|now_s| rate.take(a, now_s)),
            [true, true, true, false, false, true]
        );
        assert!(rate.take(b, 0.6) && !rate.take(a, 0.6));
    }

    #[test]
    fn only_this_host_and_its_own_pages_are_heard() {
        let check = |host: &str, origin: Option<&str>, loopback| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            same_host(
                &headers,
                &Uri::from_static("/"),
                loopback,
                Some("proxy.example"),
            )
            .is_ok()
        };
        for host in [
            "localhost",
            "localhost:7420",
            "127.0.0.1:7420",
            "127.0.0.9",
            "[::1]:7420",
            "[::1]",
        ] {
            assert!(check(host, None, true), "{host}");
            assert!(check(host, Some(&format!("http://{host}")), true), "{host}");
        }
        assert!(check("proxy.example", Some("https://proxy.example"), true));
        assert!(!check("proxy.example", Some("https://evil.example"), true));
        for host in [
            "evil.example",
            "proxy.example:1",
            "evil.example:7420",
            "127.0.0.1.evil.example",
            "10.0.0.1",
            "",
            "localhost.evil.example",
        ] {
            assert!(!check(host, None, true), "{host}");
        }
        assert!(
            check("bench.lab:7420", None, false)
                && check("bench.lab:7420", Some("https://bench.lab:7420"), false)
        );
        for origin in [
            "null",
            "https://evil.example",
            "http://localhost:1",
            "https://bench.lab",
        ] {
            assert!(!check("bench.lab:7420", Some(origin), false), "{origin}");
        }
    }
}
