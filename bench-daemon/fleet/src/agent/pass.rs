//! Sends a caller's request to the server of the benches with the caller's credentials, never with
//! the token of the agent.

use std::time::Duration;

use axum::http::{HeaderMap, HeaderName, Method, Request, Response, header};

use super::{app::App, refusal::Refusal, server::CallError};

/// Headers that are passed on.
const PASSED: [HeaderName; 4] = [
    header::AUTHORIZATION,
    header::COOKIE,
    header::CONTENT_TYPE,
    HeaderName::from_static("x-eis-bench"),
];

/// A request of a caller.
pub(crate) struct Passed<'a> {
    /// Method.
    pub(crate) method: Method,
    /// Path and query, from `/api/v1` on.
    pub(crate) path: &'a str,
    /// Headers of the caller.
    pub(crate) headers: &'a HeaderMap,
    /// Body.
    pub(crate) body: Vec<u8>,
    /// Timeout.
    pub(crate) patience: Duration,
}

/// Sends a request of a caller, and returns the response of the server, whatever its status.
///
/// # Errors
/// The server does not answer.
pub(crate) async fn pass(app: &App, passed: Passed<'_>) -> Result<Response<Vec<u8>>, Refusal> {
    let uri = format!("{}{}", app.server.url(), passed.path);
    let mut request = Request::builder().method(passed.method).uri(uri);
    for name in PASSED {
        if let Some(value) = passed.headers.get(&name) {
            request = request.header(name, value);
        }
    }
    let request = request.body(passed.body);
    let request = request.map_err(|error| Refusal::machine(&error))?;
    let (server, patience) = (app.server.clone(), passed.patience);
    let sent = tokio::task::spawn_blocking(move || server.send(request, patience));
    let answer = sent.await.map_err(|error| Refusal::machine(&error))?;
    answer.map_err(|away| CallError::Away(away).into())
}
