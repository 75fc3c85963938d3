//! The body of a request, read within the bounds of the server.

use std::time::Duration;

use axum::{
    body::{Body, Bytes, HttpBody, to_bytes},
    http::{Method, StatusCode, Uri},
};
use bench_http::Refusal;
use instruments::clock::Clock;

/// Bounds of a body.
#[derive(Debug, Clone, Copy)]
pub(super) struct BodyBounds {
    /// Most bytes.
    pub(super) most: usize,
    /// Longest time, s.
    pub(super) patience_s: f64,
}

/// Returns whether the body is a file, which its handler reads once the caller is known, because
/// it may be larger than other bodies.
pub(super) fn is_file(method: &Method, uri: &Uri) -> bool {
    method == Method::POST && uri.path() == "/api/v1/spectra/read"
}

/// A whole body within its bounds.
///
/// # Errors
/// A body that is too large, too slow or broken.
pub(super) async fn whole(
    clock: &Clock,
    body: Body,
    BodyBounds { most, patience_s }: BodyBounds,
) -> Result<Bytes, Refusal> {
    let too_large = || {
        let message = format!("expected a body of at most {most} bytes, found a longer one");
        Refusal::of(StatusCode::PAYLOAD_TOO_LARGE, message)
    };
    if body.size_hint().lower() > most as u64 {
        return Err(too_large());
    }
    let patience = Duration::from_secs_f64(patience_s);
    match clock.deadline(patience, to_bytes(body, most)).await {
        Ok(Ok(bytes)) => Ok(bytes),
        Ok(Err(error)) if is_length(&error) => Err(too_large()),
        Ok(Err(_)) => Err(Refusal::of(
            StatusCode::BAD_REQUEST,
            "expected a whole body, found a broken one",
        )),
        Err(_) => Err(Refusal::of(
            StatusCode::REQUEST_TIMEOUT,
            format!("expected the whole body within {patience_s} s, found a part of it"),
        )),
    }
}

fn is_length(error: &axum::Error) -> bool {
    std::error::Error::source(error)
        .is_some_and(|source| source.to_string().contains("length limit"))
}
