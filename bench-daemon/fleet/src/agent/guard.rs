//! Checks every request: its rate, its host, and the page that sent it. Every answer gets headers
//! that restrict browsers. The rules are those of the server.

use std::net::IpAddr;

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header},
    middleware::Next,
    response::{IntoResponse, Response},
};

use super::{app::App, caller::Peer, refusal::Refusal};
use crate::loopback::names_loopback;

/// Forbids content from other origins, inline scripts and frames.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
    connect-src 'self'; img-src 'self' data:; form-action 'none'; base-uri 'none'; \
    frame-ancestors 'none'";

/// Middleware of every request.
pub(crate) async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let mut response = match admit(&app, &request) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refusal.into_response(),
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

fn admit(app: &App, request: &Request) -> Result<(), Refusal> {
    let peer = request.extensions().get::<Peer>();
    let peer = peer.map_or(IpAddr::from([0, 0, 0, 0]), |peer| peer.0);
    let is_stop = request.method() == Method::POST && request.uri().path().ends_with("/stop");
    // Stop requests bypass the rate limit.
    if !is_stop && !app.rate.take(peer, app.clock.now_s()) {
        let message = "expected fewer requests, found more than this agent bears from one peer";
        return Err(Refusal::of(StatusCode::TOO_MANY_REQUESTS, message));
    }
    same_host(request.headers(), request.uri(), app.is_local)
}

/// Refuses requests from foreign pages in a browser, both under another host name (DNS rebinding)
/// and from another origin.
fn same_host(headers: &HeaderMap, uri: &Uri, is_local: bool) -> Result<(), Refusal> {
    let text = |name| headers.get(name).and_then(|value| value.to_str().ok());
    let host = text(header::HOST)
        .or_else(|| uri.authority().map(|authority| authority.as_str()))
        .unwrap_or_default();
    let name = host
        .rsplit_once(':')
        .filter(|(_, port)| port.chars().all(|c| c.is_ascii_digit()))
        .map_or(host, |(name, _)| name);
    if is_local && !names_loopback(name) {
        let message = format!("expected the host localhost, 127.0.0.1 or [::1], found {host:?}");
        return Err(Refusal::new(StatusCode::FORBIDDEN, "other_host", message));
    }
    let Some(origin) = text(header::ORIGIN) else {
        return Ok(());
    };
    match origin.split_once("://") {
        Some((_, origin)) if origin == host => Ok(()),
        _ => {
            let message = format!("expected a page of this agent, found one of {origin:?}");
            Err(Refusal::new(StatusCode::FORBIDDEN, "other_origin", message))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_this_host_and_its_own_pages_are_heard() {
        let check = |host: &str, origin: Option<&str>, is_local| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, host.parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            same_host(&headers, &Uri::from_static("/"), is_local).is_ok()
        };
        for host in [
            "localhost",
            "127.0.0.1:7430",
            "127.0.0.9",
            "[::1]:7430",
            "[::1]",
        ] {
            assert!(check(host, None, true), "{host}");
            assert!(check(host, Some(&format!("http://{host}")), true), "{host}");
        }
        for host in ["evil.example", "127.0.0.1.evil.example", "10.0.0.1", ""] {
            assert!(!check(host, None, true), "{host}");
        }
        assert!(check(
            "bench.lab:7430",
            Some("https://bench.lab:7430"),
            false
        ));
        for origin in [
            "null",
            "https://evil.example",
            "http://localhost:1",
            "https://bench.lab",
        ] {
            assert!(!check("bench.lab:7430", Some(origin), false), "{origin}");
        }
    }
}
