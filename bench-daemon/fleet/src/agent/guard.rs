//! Checks every request: its rate, its host, and the page that sent it. Every answer gets headers
//! that restrict browsers. The rules are those of the server.

use std::net::IpAddr;

use axum::{
    extract::{Request, State},
    http::{Method, StatusCode},
    middleware::Next,
    response::{IntoResponse, Response},
};
use bench_http::{Hosts, restrict};

use super::{app::App, caller::Peer, refusal::Refusal};

/// Middleware of every request.
pub(crate) async fn guard(State(app): State<App>, request: Request, next: Next) -> Response {
    let mut response = match admit(&app, &request) {
        Ok(()) => next.run(request).await,
        Err(refusal) => refusal.into_response(),
    };
    restrict(response.headers_mut());
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
    let hosts = Hosts {
        is_local: app.is_local,
        proxy: None,
    };
    hosts.admit(request.headers(), request.uri())
}
