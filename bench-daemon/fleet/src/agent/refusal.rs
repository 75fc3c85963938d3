//! Answers to refused requests, from the errors of the fleet and of the server.

use axum::http::StatusCode;
pub(crate) use bench_http::{Problem, Refusal};

use super::server::{CallError, ServerRefusal};
use crate::error::FleetError;

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
