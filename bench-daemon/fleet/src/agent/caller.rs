//! The user of a request. The agent has no users of its own: it passes the credentials of the
//! request to the server of the benches, and uses the name and the scopes that the server returns.

use std::net::IpAddr;

use axum::{
    extract::FromRequestParts,
    http::{HeaderMap, Method, StatusCode, header, request::Parts},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    app::App,
    pass::{Passed, pass},
    refusal::Refusal,
    server::SHORT_PATIENCE,
};

/// Header that a request with a cookie must carry if it changes something. A page of another
/// origin cannot send it.
const PROOF_HEADER: &str = "x-eis-bench";
/// Name of a caller of a server without tokens.
const LOCAL: &str = "local";
/// Headers of a request that a proxy has passed on.
const PASSED_ON: [&str; 5] = [
    "forwarded",
    "via",
    "x-forwarded-for",
    "x-forwarded-host",
    "x-real-ip",
];
/// Scopes that requests to the agent ask for.
const SCOPES: [&str; 2] = ["read", "energise"];

/// The peer of a connection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Peer(pub(crate) IpAddr);

/// A user of the server.
#[derive(Debug, Clone, Serialize, Deserialize, ToSchema)]
pub(crate) struct Whoami {
    /// Their name.
    pub(crate) name: String,
    /// Scopes of their token.
    pub(crate) scopes: Vec<String>,
    /// Benches of the server.
    pub(crate) benches: Vec<String>,
}

/// A caller with the scope number `SCOPE` of [`SCOPES`]; a number beyond the last scope accepts any
/// scope.
#[derive(Debug, Clone)]
pub(crate) struct With<const SCOPE: usize> {
    /// Their name.
    pub(crate) name: String,
    /// The user from the server.
    pub(crate) known: Whoami,
}

/// A caller with any token, whatever its scopes.
pub(crate) type Known = With<{ SCOPES.len() }>;
/// A caller with permission to read.
pub(crate) type Reader = With<0>;
/// May let current flow.
pub(crate) type Energiser = With<1>;

impl<const SCOPE: usize> FromRequestParts<App> for With<SCOPE> {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Refusal> {
        let caller = who(parts, app).await?;
        if let Some(scope) = SCOPES.get(SCOPE)
            && !caller.scopes.iter().any(|one| one == scope)
        {
            let has = caller.scopes.join(", ");
            let message =
                format!("expected a token with the scope `{scope}`, found one with: {has}");
            return Err(Refusal::of(StatusCode::FORBIDDEN, message));
        }
        Ok(Self {
            name: caller.name.clone(),
            known: caller,
        })
    }
}

/// Returns the user of a request, as authenticated by the server.
async fn who(parts: &Parts, app: &App) -> Result<Whoami, Refusal> {
    let headers = &parts.headers;
    let is_by_session = !headers.contains_key(header::AUTHORIZATION);
    let has_cookie = headers.contains_key(header::COOKIE);
    if is_by_session && has_cookie && !parts.method.is_safe() && !headers.contains_key(PROOF_HEADER)
    {
        let message = format!("expected a header `{PROOF_HEADER}` with a session, found none");
        return Err(Refusal::new(StatusCode::FORBIDDEN, "forged", message));
    }
    let caller = ask(headers, app).await?;
    let is_passed_on = PASSED_ON.iter().any(|name| headers.contains_key(*name));
    // A server without tokens trusts all requests from its own machine, and requests of this agent
    // come from there.
    if caller.name == LOCAL && (!app.is_local || is_passed_on) {
        let message = "expected a server with tokens behind an agent that is reached from other \
            machines, found none: `eis-bench token add` makes one";
        return Err(Refusal::of(StatusCode::UNAUTHORIZED, message));
    }
    Ok(caller)
}

async fn ask(headers: &HeaderMap, app: &App) -> Result<Whoami, Refusal> {
    let passed = Passed {
        method: Method::GET,
        path: "/api/v1/whoami",
        headers,
        body: Vec::new(),
        patience: SHORT_PATIENCE,
    };
    let answer = pass(app, passed).await?;
    if answer.status().is_success() {
        return serde_json::from_slice(answer.body()).map_err(|error| Refusal::machine(&error));
    }
    let problem: serde_json::Value = serde_json::from_slice(answer.body()).unwrap_or_default();
    let message = problem["message"].as_str();
    let message = message.unwrap_or("the server of the benches refuses the caller");
    Err(Refusal::of(answer.status(), message))
}
