//! All routes of the agent.

use axum::{
    Router,
    extract::DefaultBodyLimit,
    http::StatusCode,
    middleware,
    routing::{delete, get, post},
};

use super::{app::App, forward, guard, metrics, openapi, page, refusal::Refusal, routes, stops};

/// Longest body of a request, bytes: an experiment as text in JSON.
const MOST_BODY: usize = 2 << 20;

/// All routes.
pub(crate) fn router(app: &App) -> Router {
    let bench = "/fleet/benches/{site}/{bench}";
    let of_bench = |act: &str| format!("{bench}/{act}");
    let api = Router::new()
        .route("/openapi.json", get(openapi::document))
        .route("/whoami", get(routes::whoami))
        .route("/session", post(forward::session).delete(forward::session))
        .route("/experiments", get(forward::experiments))
        .route("/files/experiments/{name}", get(forward::experiments))
        .route("/drafts", post(forward::experiments))
        .route("/fleet", get(routes::now))
        .route("/fleet/stop", post(stops::stop_all))
        .route(
            "/fleet/jobs",
            get(routes::jobs)
                .post(routes::submit)
                .delete(routes::cancel_campaign),
        )
        .route("/fleet/jobs/{job}", delete(routes::cancel))
        .route("/fleet/jobs/{job}/release", post(routes::release_job))
        .route(&of_bench("hold"), post(routes::hold))
        .route(&of_bench("drain"), post(routes::drain))
        .route(&of_bench("stop"), post(stops::stop))
        .route(&of_bench("release"), post(routes::release))
        .fallback(not_found);
    Router::new()
        .nest("/api/v1", api)
        .route("/metrics", get(metrics::metrics))
        .merge(page::routes())
        .layer(DefaultBodyLimit::max(MOST_BODY))
        .layer(middleware::from_fn_with_state(app.clone(), guard::guard))
        .with_state(app.clone())
}

async fn not_found() -> Refusal {
    Refusal::of(
        StatusCode::NOT_FOUND,
        "expected a path of this agent, found another one",
    )
}
