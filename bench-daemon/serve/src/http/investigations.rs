//! Routes of investigations: diagnoses and recommended experiments in turn.

use axum::{
    Json,
    extract::{Path, State},
    http::StatusCode,
};
use bench_http::Refusal;

use super::{
    App,
    aside::aside,
    caller::{Energiser, Operator, Reader},
};
use crate::{
    investigations::{Investigation, InvestigationRequest},
    investigator,
};

/// Returns the latest investigations, the latest first.
#[utoipa::path(
    get,
    path = "/api/v1/investigations",
    tag = "investigations",
    responses((status = 200, body = [Investigation])),
    security(("token" = ["read"]))
)]
pub async fn list(
    _caller: Reader,
    State(app): State<App>,
) -> Result<Json<Vec<Investigation>>, Refusal> {
    aside(move || Ok(Json(app.server.analyses.investigations.list()))).await
}

/// Starts an investigation of a finished run. It diagnoses the data, appends the recommended
/// experiment to the queue, and diagnoses all data again, until the verdict is clear or the budget
/// is used up. Its experiments let current flow. Events `investigation` report its progress.
#[utoipa::path(
    post,
    path = "/api/v1/investigations",
    tag = "investigations",
    request_body = InvestigationRequest,
    responses((status = 201, body = Investigation)),
    security(("token" = ["energise"]))
)]
pub async fn begin(
    caller: Energiser,
    State(app): State<App>,
    Json(request): Json<InvestigationRequest>,
) -> Result<(StatusCode, Json<Investigation>), Refusal> {
    aside(move || {
        let begun = investigator::begin(&app.server, request, &caller.name)?;
        Ok((StatusCode::CREATED, Json(begun)))
    })
    .await
}

/// Returns an investigation with its steps.
#[utoipa::path(
    get,
    path = "/api/v1/investigations/{id}",
    tag = "investigations",
    params(("id" = String, Path)),
    responses((status = 200, body = Investigation)),
    security(("token" = ["read"]))
)]
pub async fn detail(
    _caller: Reader,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Investigation>, Refusal> {
    aside(move || Ok(Json(known(&app, &id)?))).await
}

/// Ends an investigation. If its experiment waits in the queue, it is removed; a running one
/// continues to its end unless it is stopped.
#[utoipa::path(
    post,
    path = "/api/v1/investigations/{id}/cancel",
    tag = "investigations",
    params(("id" = String, Path)),
    responses((status = 200, body = Investigation)),
    security(("token" = ["operate"]))
)]
pub async fn cancel(
    caller: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Investigation>, Refusal> {
    aside(move || {
        known(&app, &id)?;
        Ok(Json(investigator::cancel(&app.server, &id, &caller.name)?))
    })
    .await
}

fn known(app: &App, id: &str) -> Result<Investigation, Refusal> {
    let found = app.server.analyses.investigations.find(id);
    found.ok_or_else(|| Refusal::not_found("an investigation", id))
}
