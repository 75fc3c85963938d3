//! Checks the token of a request. As an argument of a handler, it lets the handler run only with
//! the scope that it names.

use std::{
    net::IpAddr,
    sync::{Arc, OnceLock},
};

use axum::{
    extract::FromRequestParts,
    http::{StatusCode, header, request::Parts},
};
use bench_http::Refusal;
use instruments::loopback::{is_loopback, names_loopback};

use super::App;
use crate::{
    queue::HeldBy,
    session::{self, PROOF_HEADER},
    token::{Scope, Token, TokenError},
};
use bench_plan::support::hash;

/// Name of a caller without a token: any local process if no token exists, or a local process
/// that stops a bench.
const LOCAL: &str = "local";

/// Code of the refusal of a session without the header of the page.
const FORGED: &str = "forged";

/// Header with the name of the person of a fleet for whom an agent of the fleet acts.
pub const PERSON_HEADER: &str = "x-eis-bench-person";
/// Longest name of a person that is kept, letters.
const LONGEST_PERSON: usize = 200;

/// A caller with the scope number `SCOPE` of [`Scope::ALL`]; a number beyond the last scope
/// accepts any scope.
#[derive(Debug, Clone)]
pub struct With<const SCOPE: usize> {
    /// Their name.
    pub name: String,
    /// Scopes of the caller.
    pub scopes: Vec<Scope>,
    /// SHA-256 of the token; `None` if no token is required.
    pub token_sha256: Option<String>,
    /// Side that the caller acts for. It is the fleet if the request names a person of a fleet.
    pub side: HeldBy,
}

/// A caller with any token, whatever its scopes.
pub type Known = With<{ Scope::ALL.len() }>;
/// A caller with permission to read.
pub type Reader = With<0>;
/// May operate.
pub type Operator = With<1>;
/// May let current flow.
pub type Energiser = With<2>;
/// May clear a latch.
pub type Clearer = With<3>;
/// May act for persons of a fleet.
pub type Agent = With<4>;

/// The peer of a connection.
#[derive(Debug, Clone, Copy)]
pub struct Peer(pub IpAddr);

/// The caller's name for the audit trail, set as soon as it is known.
#[derive(Debug, Clone, Default)]
pub struct Named(pub Arc<OnceLock<String>>);

impl<const SCOPE: usize> FromRequestParts<App> for With<SCOPE> {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Refusal> {
        let (Token { name, scopes, .. }, token_sha256) = who(parts, app)?;
        let person = person(parts);
        // Without the scope the token's own name stays in the audit trail.
        let acts_for = person.filter(|_| scopes.contains(&Scope::Fleet));
        let name = acts_for.map_or(name, |person| format!("fleet: {person}"));
        if let Some(named) = parts.extensions.get::<Named>() {
            let _ = named.0.set(name.clone());
        }
        let is_for_fleet = parts.headers.contains_key(PERSON_HEADER);
        if is_for_fleet {
            has_scope(&scopes, Scope::Fleet)?;
        }
        if let Some(scope) = Scope::ALL.get(SCOPE) {
            has_scope(&scopes, *scope)?;
        }
        Ok(Self {
            name,
            scopes,
            token_sha256,
            side: match is_for_fleet {
                true => HeldBy::Fleet,
                false => HeldBy::Here,
            },
        })
    }
}

/// Refuses a token without a scope.
fn has_scope(scopes: &[Scope], scope: Scope) -> Result<(), Refusal> {
    if scopes.contains(&scope) {
        return Ok(());
    }
    let has = scopes
        .iter()
        .map(|scope| scope.name())
        .collect::<Vec<_>>()
        .join(", ");
    let message = format!(
        "expected a token with the scope `{}`, found one with: {has}",
        scope.name()
    );
    Err(Refusal::of(StatusCode::FORBIDDEN, message))
}

/// Returns the person of a fleet that a request names.
fn person(parts: &Parts) -> Option<String> {
    let value = parts.headers.get(PERSON_HEADER)?;
    let text = String::from_utf8_lossy(value.as_bytes());
    let plain = text.chars().filter(|c| !c.is_control());
    Some(plain.take(LONGEST_PERSON).collect())
}

/// A caller with permission to stop: with any token, or without one from this machine. A local
/// caller that could stop before tokens existed can still stop afterwards, so a stop at the
/// bench's machine is always possible.
#[derive(Debug, Clone)]
pub struct Stopping {
    /// Their name.
    pub name: String,
    /// Side that the caller acts for.
    pub side: HeldBy,
}

impl FromRequestParts<App> for Stopping {
    type Rejection = Refusal;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Refusal> {
        match Known::from_request_parts(parts, app).await {
            Ok(known) => Ok(Self {
                name: known.name,
                side: known.side,
            }),
            // A browser that sends its cookie and not the page's header was made to do so by a page
            // of elsewhere.
            Err(refusal) if refusal.1.code == FORGED => Err(refusal),
            // Only an agent acts for a fleet.
            Err(refusal) if parts.headers.contains_key(PERSON_HEADER) => Err(refusal),
            Err(_) if is_of_this_machine(parts) => {
                if let Some(named) = parts.extensions.get::<Named>() {
                    let _ = named.0.set(LOCAL.to_owned());
                }
                Ok(Self {
                    name: LOCAL.to_owned(),
                    side: HeldBy::Here,
                })
            }
            Err(refusal) => Err(refusal),
        }
    }
}

/// Headers of a request that a proxy has passed on.
const PASSED_ON: [&str; 5] = [
    "forwarded",
    "via",
    "x-forwarded-for",
    "x-forwarded-host",
    "x-real-ip",
];

/// Returns whether the request comes from this machine, under one of its own names, and not
/// through a proxy.
fn is_of_this_machine(parts: &Parts) -> bool {
    let host = parts
        .headers
        .get(header::HOST)
        .and_then(|host| host.to_str().ok())
        .unwrap_or_default();
    let name = host
        .rsplit_once(':')
        .filter(|(_, port)| port.chars().all(|c| c.is_ascii_digit()))
        .map_or(host, |(name, _)| name);
    let peer = parts.extensions.get::<Peer>();
    peer.is_some_and(|peer| is_loopback(peer.0))
        && names_loopback(name)
        && PASSED_ON
            .iter()
            .all(|header| !parts.headers.contains_key(*header))
}

/// Returns the token of a request, presented with it or by its session, and its SHA-256. If no
/// token exists, every local caller may do everything and remote callers may do nothing: in that
/// case the last token was revoked, or its file is missing.
fn who(parts: &Parts, app: &App) -> Result<(Token, Option<String>), Refusal> {
    let unavailable = |error: TokenError| Refusal::machine(&error);
    if app.server.open_to_all().map_err(unavailable)? {
        let local = Token {
            name: LOCAL.to_owned(),
            scopes: Scope::ALL.to_vec(),
            sha256: String::new(),
            made_unix_s: 0,
            expires_unix_s: None,
        };
        return Ok((local, None));
    }
    let text = |name| {
        parts
            .headers
            .get(name)
            .and_then(|value| value.to_str().ok())
    };
    if let Some(header) = text(header::AUTHORIZATION) {
        let secret = header
            .split_once(' ')
            .filter(|(kind, _)| kind.eq_ignore_ascii_case("bearer"))
            .map(|(_, secret)| secret.trim())
            .ok_or_else(nothing_shown)?;
        return shown(parts, app, secret);
    }
    let number = text(header::COOKIE)
        .and_then(session::number)
        .ok_or_else(nothing_shown)?;
    let now_s = app.server.clock.now_s();
    let sha256 = app
        .server
        .sessions
        .token_sha256(number, now_s)
        .ok_or_else(session_ended)?;
    if !parts.method.is_safe() && !parts.headers.contains_key(PROOF_HEADER) {
        let message = format!("expected a header `{PROOF_HEADER}` with a session, found none");
        return Err(Refusal::new(StatusCode::FORBIDDEN, FORGED, message));
    }
    let token = app
        .server
        .tokens
        .whose_sha256(&sha256)
        .map_err(unavailable)?;
    token
        .map(|token| (token, Some(sha256)))
        .ok_or_else(session_ended)
}

fn nothing_shown() -> Refusal {
    Refusal::of(
        StatusCode::UNAUTHORIZED,
        "expected a header `Authorization: Bearer TOKEN` or a session, found none",
    )
}

fn session_ended() -> Refusal {
    Refusal::of(
        StatusCode::UNAUTHORIZED,
        "expected a session of this server, found one that has ended: sign in again",
    )
}

/// Returns the presented token, and its SHA-256.
///
/// # Errors
/// An unknown token, or too many of them from this peer.
pub(super) fn shown(
    parts: &Parts,
    app: &App,
    secret: &str,
) -> Result<(Token, Option<String>), Refusal> {
    let whose = app
        .server
        .tokens
        .whose(secret)
        .map_err(|error| Refusal::machine(&error))?;
    if let Some(token) = whose {
        return Ok((token, Some(hash::sha256(secret))));
    }
    let peer = parts.extensions.get::<Peer>().map(|peer| peer.0);
    // A valid token is accepted regardless of the limit: failed attempts of a neighbour must not
    // lock out its holder.
    if peer.is_some_and(|peer| !app.guesses.take(peer, app.server.clock.now_s())) {
        return Err(Refusal::of(
            StatusCode::TOO_MANY_REQUESTS,
            "expected fewer tokens that this server does not know",
        ));
    }
    Err(Refusal::of(
        StatusCode::UNAUTHORIZED,
        "expected a token of this server, found another one",
    ))
}
