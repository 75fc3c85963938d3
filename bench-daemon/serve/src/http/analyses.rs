//! Routes of analyses of runs.

use axum::{
    Json,
    extract::{Path, State},
    http::StatusCode,
    response::Response,
};
use bench_http::Refusal;

use super::{
    App,
    aside::aside,
    caller::{Operator, Reader},
    runs::Log,
    sent::sent,
};
use crate::analyses::{Analysis, AnalysisError, Request, WithResults};
use bench_plan::support::confined_path::{self, plain};

/// Longest file of results that is sent, bytes.
const LONGEST: u64 = 64 * 1024 * 1024;

impl From<AnalysisError> for Refusal {
    fn from(error: AnalysisError) -> Self {
        match error {
            AnalysisError::Unfit(text) => Self::unfit(text),
            AnalysisError::Unknown(_) => Self::of(StatusCode::NOT_FOUND, error.to_string()),
            AnalysisError::Conflict(text) => Self::conflict(text),
            AnalysisError::Io(_) => Self::machine(&error),
        }
    }
}

/// Returns the latest analyses, the latest first.
#[utoipa::path(
    get,
    path = "/api/v1/analyses",
    tag = "analyses",
    responses((status = 200, body = [Analysis])),
    security(("token" = ["read"]))
)]
pub async fn list(_caller: Reader, State(app): State<App>) -> Result<Json<Vec<Analysis>>, Refusal> {
    aside(move || Ok(Json(app.server.analyses.list()))).await
}

/// Queues an analysis of runs. It begins when the analyses before it have ended; events `analysis`
/// report its progress.
#[utoipa::path(
    post,
    path = "/api/v1/analyses",
    tag = "analyses",
    request_body = Request,
    responses((status = 201, body = Analysis)),
    security(("token" = ["operate"]))
)]
pub async fn submit(
    caller: Operator,
    State(app): State<App>,
    Json(request): Json<Request>,
) -> Result<(StatusCode, Json<Analysis>), Refusal> {
    aside(move || {
        let analysis = app.server.analyses.submit(
            &app.server.settings,
            &app.server.hub,
            request,
            &caller.name,
        )?;
        Ok((StatusCode::CREATED, Json(analysis)))
    })
    .await
}

/// Returns an analysis with its results; for a diagnosis also its text.
#[utoipa::path(
    get,
    path = "/api/v1/analyses/{id}",
    tag = "analyses",
    params(("id" = String, Path)),
    responses((status = 200, body = WithResults)),
    security(("token" = ["read"]))
)]
pub async fn detail(
    _caller: Reader,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<WithResults>, Refusal> {
    aside(move || {
        let found = app.server.analyses.read(&app.server.settings, &id);
        found
            .map(Json)
            .ok_or_else(|| Refusal::not_found("an analysis", &id))
    })
    .await
}

/// Cancels a waiting or running analysis.
#[utoipa::path(
    delete,
    path = "/api/v1/analyses/{id}",
    tag = "analyses",
    params(("id" = String, Path)),
    responses((status = 200, body = Analysis)),
    security(("token" = ["operate"]))
)]
pub async fn cancel(
    _caller: Operator,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Analysis>, Refusal> {
    aside(move || Ok(Json(app.server.analyses.cancel(&app.server.hub, &id)?))).await
}

fn known(app: &App, id: &str) -> Result<(), Refusal> {
    let known = plain(id) && app.server.analyses.exists(id);
    known
        .then_some(())
        .ok_or_else(|| Refusal::not_found("an analysis", id))
}

/// Returns the last lines of the output of the process of an analysis.
#[utoipa::path(
    get,
    path = "/api/v1/analyses/{id}/log",
    tag = "analyses",
    params(("id" = String, Path)),
    responses((status = 200, body = Log)),
    security(("token" = ["read"]))
)]
pub async fn log(
    _caller: Reader,
    State(app): State<App>,
    Path(id): Path<String>,
) -> Result<Json<Log>, Refusal> {
    aside(move || {
        known(&app, &id)?;
        Ok(Json(Log::of(app.server.analyses.log(&id))))
    })
    .await
}

/// Returns a file of results as a download; it is not rendered as a page of this server.
#[utoipa::path(
    get,
    path = "/api/v1/analyses/{id}/files/{path}",
    tag = "analyses",
    params(("id" = String, Path), ("path" = String, Path)),
    responses((status = 200, body = [u8], content_type = "application/octet-stream")),
    security(("token" = ["read"]))
)]
pub async fn file(
    _caller: Reader,
    State(app): State<App>,
    Path((id, path)): Path<(String, String)>,
) -> Result<Response, Refusal> {
    aside(move || {
        known(&app, &id)?;
        let missing = || Refusal::not_found("a file of the results", &path);
        let file =
            confined_path::open(&app.server.analyses.results(&id), &path).ok_or_else(missing)?;
        sent(file, LONGEST)
    })
    .await
}
