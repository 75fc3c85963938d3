//! Requests that the server of the benches answers: sign-in, and the experiments that the page
//! offers and checks.

use axum::{
    body::{Body, Bytes},
    extract::State,
    http::{HeaderMap, HeaderName, Method, StatusCode, Uri, header},
    response::{IntoResponse, Response},
};
use serde::Deserialize;

use super::{
    app::App,
    caller::Reader,
    pass::{Passed, pass},
    refusal::Refusal,
    server::PATIENCE,
};

/// Headers of an answer of the server that are passed back.
const PASSED_BACK: [HeaderName; 3] = [
    header::CONTENT_TYPE,
    header::SET_COOKIE,
    header::WWW_AUTHENTICATE,
];

/// Passes on a sign-in or a sign-out.
pub(crate) async fn session(
    State(app): State<App>,
    method: Method,
    uri: Uri,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Refusal> {
    let passed = Passed {
        method,
        // The router removes the prefix for nested routes.
        path: &format!("/api/v1{}", uri.path()),
        headers: &headers,
        body: body.to_vec(),
        patience: PATIENCE,
    };
    forward(&app, passed).await
}

/// Passes on a request for experiments, or a draft. The agent asks who the caller is, because a
/// server without tokens answers every request of its own machine.
pub(crate) async fn experiments(
    _caller: Reader,
    State(app): State<App>,
    method: Method,
    uri: Uri,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Refusal> {
    let passed = Passed {
        method,
        // The router removes the prefix for nested routes.
        path: &format!("/api/v1{}", uri.path()),
        headers: &headers,
        body: body.to_vec(),
        patience: PATIENCE,
    };
    forward(&app, passed).await
}

async fn forward(app: &App, passed: Passed<'_>) -> Result<Response, Refusal> {
    let (parts, body) = pass(app, passed).await?.into_parts();
    let mut response = (parts.status, Body::from(body)).into_response();
    response.headers_mut().clear();
    for name in PASSED_BACK {
        for value in parts.headers.get_all(&name) {
            response.headers_mut().append(name.clone(), value.clone());
        }
    }
    Ok(response)
}

/// Returns the text of an experiment of the server, as the caller may read it.
///
/// # Errors
/// There is no such experiment, or the server does not answer.
pub(crate) async fn experiment_text(
    app: &App,
    headers: &HeaderMap,
    name: &str,
) -> Result<String, Refusal> {
    #[derive(Deserialize)]
    struct File {
        text: String,
    }
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    let unknown = || {
        let message = format!("expected the name of an experiment, found {name:?}");
        Refusal::of(StatusCode::NOT_FOUND, message)
    };
    if name.is_empty() || !name.chars().all(is_plain) {
        return Err(unknown());
    }
    let passed = Passed {
        method: Method::GET,
        path: &format!("/api/v1/files/experiments/{name}"),
        headers,
        body: Vec::new(),
        patience: PATIENCE,
    };
    let answer = pass(app, passed).await?;
    if !answer.status().is_success() {
        return Err(unknown());
    }
    let file: Result<File, _> = serde_json::from_slice(answer.body());
    file.map(|file| file.text)
        .map_err(|error| Refusal::machine(&error))
}
