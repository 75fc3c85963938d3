//! Routes of the pack explorer.

use axum::{Json, extract::State};
use bench_http::Refusal;

use super::{App, aside::aside, caller::Reader};
use crate::pack::{self, Load, RunModel, UnderLoad};

/// Simulates a load on a pack of cells. Changes nothing.
#[utoipa::path(
    post,
    path = "/api/v1/pack",
    tag = "pack",
    request_body = Load,
    responses((status = 200, body = UnderLoad)),
    security(("token" = ["read"]))
)]
pub async fn under_load(
    _caller: Reader,
    State(app): State<App>,
    Json(load): Json<Load>,
) -> Result<Json<UnderLoad>, Refusal> {
    aside(move || {
        pack::under_load(&app.server.settings, &app.server.last_model, &load)
            .map(Json)
            .map_err(Refusal::unfit)
    })
    .await
}

/// Returns the models of cells that runs have fitted, of the latest run first.
#[utoipa::path(
    get,
    path = "/api/v1/pack/models",
    tag = "pack",
    responses((status = 200, body = [RunModel])),
    security(("token" = ["read"]))
)]
pub async fn models(
    _caller: Reader,
    State(app): State<App>,
) -> Result<Json<Vec<RunModel>>, Refusal> {
    aside(move || Ok(Json(pack::models(&app.server.settings, &app.server.jobs)))).await
}
