//! Routes of a browser's session.

use axum::{
    Json,
    extract::{FromRequest, Request, State},
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use bench_http::{Problem, Refusal};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    App,
    caller::{Named, shown},
};
use crate::{
    session::{self, LONGEST_S, PROOF_HEADER},
    token::{Scope, TokenError},
};

/// A token for signing in.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SignIn {
    /// The token.
    token: String,
}

/// A new session.
#[derive(Debug, Serialize, ToSchema)]
pub struct SignedIn {
    /// Name of the token.
    name: String,
    /// Scopes of the token.
    scopes: Vec<Scope>,
    /// Time after which the session ends, s.
    ends_after_s: f64,
}

/// Ends the session that a request presents, whatever its outcome: a session number is never
/// reused.
fn end_old(app: &App, headers: &HeaderMap) {
    let cookies = headers
        .get(header::COOKIE)
        .and_then(|value| value.to_str().ok());
    if let Some(number) = cookies.and_then(session::number) {
        app.server.sessions.end(number);
    }
}

fn encrypted(app: &App) -> bool {
    app.server.settings.tls.is_some() || app.server.settings.proxy_host.is_some()
}

/// Starts a session of a browser. Its number is returned as a cookie that scripts cannot read and
/// that other sites cannot send.
#[utoipa::path(
    post,
    path = "/api/v1/session",
    tag = "access",
    request_body = SignIn,
    responses(
        (status = 200, body = SignedIn),
        (status = 401, body = Problem, description = "The token is invalid."),
        (status = 503, body = Problem, description = "The server's machine cannot serve the \
            request.")
    )
)]
pub async fn begin(State(app): State<App>, request: Request) -> Result<Response, Refusal> {
    let (parts, body) = request.into_parts();
    let again = Request::from_parts(parts.clone(), body);
    let Json(sign_in): Json<SignIn> = Json::from_request(again, &app)
        .await
        .map_err(|error| Refusal::of(error.status(), error.body_text()))?;
    let (token, _) = shown(&parts, &app, sign_in.token.trim())?;
    end_old(&app, &parts.headers);
    if let Some(named) = parts.extensions.get::<Named>() {
        let _ = named.0.set(token.name.clone());
    }
    let number = app
        .server
        .sessions
        .begin(sign_in.token.trim(), app.server.clock.now_s())
        .map_err(|error: TokenError| Refusal::machine(&error))?;
    let cookie = session::cookie(Some(&number), encrypted(&app));
    let signed_in = SignedIn {
        name: token.name,
        scopes: token.scopes,
        ends_after_s: LONGEST_S,
    };
    Ok(([(header::SET_COOKIE, cookie)], Json(signed_in)).into_response())
}

/// Ends the session of a browser.
#[utoipa::path(
    delete,
    path = "/api/v1/session",
    tag = "access",
    responses((status = 204))
)]
pub async fn end(State(app): State<App>, headers: HeaderMap) -> Result<Response, Refusal> {
    if !headers.contains_key(PROOF_HEADER) {
        let message = format!("expected a header `{PROOF_HEADER}`, found none");
        return Err(Refusal::new(StatusCode::FORBIDDEN, "forged", message));
    }
    end_old(&app, &headers);
    let cookie = session::cookie(None, encrypted(&app));
    let head = [(header::SET_COOKIE, cookie)];
    Ok((StatusCode::NO_CONTENT, head).into_response())
}
