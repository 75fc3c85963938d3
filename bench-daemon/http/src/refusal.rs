//! Answer to a refused request: a status, and JSON of one shape.

use axum::{
    Json,
    http::{StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Reason for the refusal of a request.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// Keyword for programs, such as `not_found`.
    pub code: String,
    /// Message for people: what was expected and what was found.
    pub message: String,
}

/// A refusal.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refusal(pub StatusCode, pub Problem);

/// The code of a refusal, for the audit trail.
#[derive(Debug, Clone)]
pub struct Code(pub String);

impl Refusal {
    /// With a code of its own.
    pub fn new(status: StatusCode, code: &str, message: impl Into<String>) -> Self {
        Self(
            status,
            Problem {
                code: code.to_owned(),
                message: message.into(),
            },
        )
    }

    /// With the code of the status.
    pub fn of(status: StatusCode, message: impl Into<String>) -> Self {
        Self::new(status, code_of(status), message)
    }

    /// The requested object does not exist.
    pub fn not_found(what: &str, found: &str) -> Self {
        Self::of(
            StatusCode::NOT_FOUND,
            format!("expected the name of {what}, found {found:?}"),
        )
    }

    /// A body that is valid JSON, but has unexpected content.
    pub fn unfit(message: impl Into<String>) -> Self {
        Self::of(StatusCode::UNPROCESSABLE_ENTITY, message)
    }

    /// The request conflicts with the current state.
    pub fn conflict(message: impl Into<String>) -> Self {
        Self::of(StatusCode::CONFLICT, message)
    }

    /// The machine.
    pub fn machine(error: &dyn std::fmt::Display) -> Self {
        tracing::error!("{error}");
        Self::of(
            StatusCode::SERVICE_UNAVAILABLE,
            "the program cannot do that now; its log states the reason",
        )
    }
}

/// One word for each status.
pub fn code_of(status: StatusCode) -> &'static str {
    match status.as_u16() {
        400 => "bad_request",
        401 => "unauthorised",
        403 => "forbidden",
        404 => "not_found",
        405 => "method_not_allowed",
        408 => "too_slow",
        409 => "conflict",
        413 => "too_large",
        414 => "path_too_long",
        415 => "not_json",
        422 => "unfit",
        429 => "too_many",
        431 => "head_too_large",
        503 => "unavailable",
        _ => "refused",
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let code = Code(self.1.code.clone());
        let mut response = (self.0, Json(self.1)).into_response();
        if self.0 == StatusCode::UNAUTHORIZED {
            response.headers_mut().insert(
                header::WWW_AUTHENTICATE,
                header::HeaderValue::from_static("Bearer realm=\"eis-bench\""),
            );
        }
        response.extensions_mut().insert(code);
        response
    }
}
