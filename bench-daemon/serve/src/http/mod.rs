//! The server over HTTP: the routes, and the way from a socket to them.

pub mod analyses;
mod app;
pub mod archive;
mod aside;
pub mod benches;
mod body;
pub mod caller;
pub mod catalog;
mod connection;
pub mod events;
pub mod find;
pub mod guard;
pub mod imported;
pub mod instruments;
pub mod investigations;
pub mod metrics;
pub mod notices;
pub mod openapi;
pub mod pack;
mod page;
pub mod queue;
pub mod runs;
mod sent;
pub mod session;
pub mod shelf;

use axum::{
    Router, middleware,
    routing::{delete, get, post, put},
};

pub use connection::Listener;

pub use app::App;

/// All routes.
pub fn router(app: &App) -> Router {
    let api = Router::new()
        .route("/openapi.json", get(openapi::document))
        .route("/stop", post(benches::stop_all))
        .route("/session", post(session::begin).delete(session::end))
        .route("/whoami", get(benches::whoami))
        .route("/benches", get(benches::list))
        .route("/benches/{bench}", get(benches::detail))
        .route(
            "/benches/{bench}/instruments",
            get(instruments::instruments),
        )
        .route("/benches/{bench}/identify", post(instruments::identify))
        .route(
            "/benches/{bench}/outputs/read",
            post(instruments::read_outputs),
        )
        .route("/benches/{bench}/stop", post(benches::stop))
        .route("/benches/{bench}/trips", get(benches::trips))
        .route("/benches/{bench}/trips/clear", post(benches::clear))
        .route("/benches/{bench}/hold", post(queue::hold))
        .route("/benches/{bench}/release", post(queue::release))
        .route("/benches/{bench}/notes", get(queue::notes))
        .route("/experiments", get(queue::experiments))
        .route("/experiments/{experiment}/plan", get(queue::plan))
        .route("/analyses", get(analyses::list).post(analyses::submit))
        .route(
            "/analyses/{id}",
            get(analyses::detail).delete(analyses::cancel),
        )
        .route("/analyses/{id}/log", get(analyses::log))
        .route("/analyses/{id}/files/{*path}", get(analyses::file))
        .route(
            "/investigations",
            get(investigations::list).post(investigations::begin),
        )
        .route("/investigations/{id}", get(investigations::detail))
        .route("/investigations/{id}/cancel", post(investigations::cancel))
        .route("/notices", get(notices::list))
        .route("/notices/test", post(notices::test))
        .route("/pack", post(pack::under_load))
        .route("/pack/models", get(pack::models))
        .route("/schemas/{kind}", get(shelf::schema))
        .route("/files/{kind}", get(shelf::list))
        .route("/files/{kind}/{name}", get(shelf::read).put(shelf::write))
        .route("/drafts", post(shelf::draft))
        .route("/queue", get(queue::list).post(queue::submit))
        .route("/queue/order", post(queue::reorder))
        .route("/queue/{id}", delete(queue::cancel))
        .route("/runs", get(runs::list))
        .route("/runs/{run}", get(runs::detail))
        .route("/runs/{run}/experiment", get(shelf::of_run))
        .route(
            "/runs/{run}/notes",
            get(find::run_notes).post(find::note_run),
        )
        .route("/runs/{run}/tags", put(find::tag_run))
        .route("/runs/{run}/campaign", get(find::campaign))
        .route("/runs/{run}/models", get(find::models))
        .route("/runs/{run}/capture", get(find::capture))
        .route("/spectra/read", post(imported::read))
        .route("/catalog/runs", get(catalog::runs))
        .route("/catalog/runs/{run}", get(catalog::run))
        .route("/catalog/spectra", get(catalog::spectra))
        .route("/catalog/fits", get(catalog::fits))
        .route("/catalog/diagnoses", get(catalog::diagnoses))
        .route("/catalog/cells", get(catalog::cells))
        .route("/catalog/ageing", get(catalog::ageing))
        .route("/catalog/choices", get(catalog::choices))
        .route("/archive", get(archive::now))
        .route(
            "/cells/{cell}/notes",
            get(find::cell_notes).post(find::note_cell),
        )
        .route("/runs/{run}/spectra", get(runs::spectra))
        .route("/runs/{run}/fits", get(runs::fits))
        .route("/runs/{run}/readings", get(runs::readings))
        .route("/runs/{run}/log", get(runs::log))
        .route("/runs/{run}/files", get(runs::files))
        .route("/runs/{run}/files/{*path}", get(runs::file))
        .route("/runs/{run}/pause", post(runs::pause))
        .route("/runs/{run}/go-on", post(runs::go_on))
        .route("/runs/{run}/answer", post(runs::answer))
        .route("/runs/{run}/order", post(runs::order))
        .route("/runs/{run}/resume", post(runs::resume))
        .route("/audit", get(benches::audit).post(benches::enter))
        .route("/events", get(events::events));
    Router::new()
        .nest("/api/v1", api)
        .route("/metrics", get(metrics::metrics))
        .merge(page::routes())
        .layer(middleware::from_fn_with_state(app.clone(), guard::guard))
        .with_state(app.clone())
}
