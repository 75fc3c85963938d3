//! Route of the archive.

use axum::{Json, extract::State, http::StatusCode};

use super::{App, caller::Reader, problem::Refusal};
use crate::serve::archive::ArchiveNow;

/// The archive as it is now: runs that are there, and those that are not yet.
#[utoipa::path(
    get,
    path = "/api/v1/archive",
    tag = "archive",
    responses(
        (status = 200, body = ArchiveNow),
        (status = 404, body = super::problem::Problem, description = "No archive is configured.")
    ),
    security(("token" = ["read"]))
)]
pub async fn now(_caller: Reader, State(app): State<App>) -> Result<Json<ArchiveNow>, Refusal> {
    if app.server.settings.archive.is_none() {
        let expected = "expected a section [archive] in the server's file, found none";
        return Err(Refusal::new(StatusCode::NOT_FOUND, "no-archive", expected));
    }
    Ok(Json(app.server.archive.now().clone()))
}
