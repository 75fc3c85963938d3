//! Answer to a refused request: a status, and JSON of the same shape as that of the server.

use axum::{
    Json,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::Serialize;
use utoipa::ToSchema;

use super::server::{CallError, ServerRefusal};
use crate::error::FleetError;

/// Why a request was refused.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct Problem {
    /// One word for programs, such as `not_found`.
    code: String,
    /// For people: what was expected and what was found.
    message: String,
}

/// A refusal.
#[derive(Debug)]
pub(crate) struct Refusal {
    status: StatusCode,
    problem: Problem,
}

impl Refusal {
    /// Creates a refusal with its own code.
    pub(crate) fn new(status: StatusCode, code: &str, message: impl Into<String>) -> Self {
        let problem = Problem {
            code: code.to_owned(),
            message: message.into(),
        };
        Self { status, problem }
    }

    /// Creates a refusal with the code of the status.
    pub(crate) fn of(status: StatusCode, message: impl Into<String>) -> Self {
        Self::new(status, code_of(status), message)
    }

    /// A body that is valid JSON, but has unexpected content.
    pub(crate) fn unfit(message: impl Into<String>) -> Self {
        Self::of(StatusCode::UNPROCESSABLE_ENTITY, message)
    }

    /// Creates a refusal for an internal error.
    pub(crate) fn machine(error: &dyn std::fmt::Display) -> Self {
        tracing::error!("{error}");
        let message = "the agent cannot do that now; its log states the reason";
        Self::of(StatusCode::SERVICE_UNAVAILABLE, message)
    }

    /// Its message.
    pub(crate) fn message(self) -> String {
        self.problem.message
    }
}

/// Returns one word for each status.
fn code_of(status: StatusCode) -> &'static str {
    match status.as_u16() {
        400 => "bad_request",
        401 => "unauthorised",
        403 => "forbidden",
        404 => "not_found",
        405 => "method_not_allowed",
        409 => "conflict",
        413 => "too_large",
        415 => "not_json",
        422 => "unfit",
        429 => "too_many",
        503 => "unavailable",
        _ => "refused",
    }
}

impl From<FleetError> for Refusal {
    fn from(error: FleetError) -> Self {
        let status = match error {
            FleetError::Unknown { .. } => StatusCode::NOT_FOUND,
            FleetError::Conflict(_) => StatusCode::CONFLICT,
            FleetError::Unfit(_) => StatusCode::UNPROCESSABLE_ENTITY,
            FleetError::Unreachable(_) | FleetError::Bench(_) => StatusCode::SERVICE_UNAVAILABLE,
            _ => return Self::machine(&error),
        };
        Self::of(status, error.to_string())
    }
}

impl From<CallError> for Refusal {
    fn from(error: CallError) -> Self {
        match error {
            CallError::Away(away) => Self::of(StatusCode::SERVICE_UNAVAILABLE, away.to_string()),
            CallError::Refused(ServerRefusal { status, message }) => Self::of(status, message),
        }
    }
}

impl IntoResponse for Refusal {
    fn into_response(self) -> Response {
        let mut response = (self.status, Json(self.problem)).into_response();
        if self.status == StatusCode::UNAUTHORIZED {
            let value = HeaderValue::from_static("Bearer realm=\"eis-bench\"");
            response
                .headers_mut()
                .insert(header::WWW_AUTHENTICATE, value);
        }
        response
    }
}
