//! Route of the archive.

use analysis::run_folder::archive_status::ArchiveStatus;
use axum::{Json, extract::State, http::StatusCode};
use bench_http::Refusal;

use super::{App, caller::Reader};

/// State of the archive as `eis-archive` wrote it last: numbers of runs by state, sizes, troubles.
#[utoipa::path(
    get,
    path = "/api/v1/archive",
    tag = "archive",
    responses(
        (status = 200, body = Object, description = "Numbers of runs by state, sizes and troubles."),
        (
            status = 404,
            body = bench_http::Problem,
            description = "No archive has written its state into the data folder."
        )
    ),
    security(("token" = ["read"]))
)]
pub async fn now(_caller: Reader, State(app): State<App>) -> Result<Json<ArchiveStatus>, Refusal> {
    let status = ArchiveStatus::read(&app.server.settings.data);
    let status = status.map_err(|reason| Refusal::machine(&reason))?;
    status.map(Json).ok_or_else(|| {
        let expected = "expected the state of an archive in the data folder, found none: start \
            `eis-archive follow`";
        Refusal::new(StatusCode::NOT_FOUND, "no-archive", expected)
    })
}
