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

use axum::{Router, middleware, routing::get};

pub use connection::Listener;

pub use app::App;

/// All routes.
pub fn router(app: &App) -> Router {
    Router::new()
        .nest("/api/v1", openapi::routes())
        .route("/metrics", get(metrics::metrics))
        .merge(page::routes())
        .layer(middleware::from_fn_with_state(app.clone(), guard::guard))
        .with_state(app.clone())
}
