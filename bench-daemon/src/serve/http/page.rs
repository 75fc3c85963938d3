//! Serves the files of the page, which are part of the program.

use axum::{
    Router,
    http::header,
    response::{IntoResponse, Response},
    routing::get,
};

use super::App;

macro_rules! file {
    ($name:literal, $kind:literal) => {
        get(|| async { with_kind($kind, include_str!(concat!("../page/", $name))) })
    };
}

macro_rules! vendored {
    ($name:literal, $kind:literal) => {
        get(|| async {
            let text = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/vendor/", $name));
            with_kind($kind, text)
        })
    };
}

fn with_kind(kind: &'static str, text: &'static str) -> Response {
    ([(header::CONTENT_TYPE, kind)], text).into_response()
}

/// Where they are found.
pub(super) fn routes() -> Router<App> {
    Router::new()
        .route("/", file!("index.html", "text/html; charset=utf-8"))
        .route("/style.css", file!("style.css", "text/css; charset=utf-8"))
        .route("/app.js", file!("app.js", "text/javascript; charset=utf-8"))
        .route(
            "/bench.js",
            file!("bench.js", "text/javascript; charset=utf-8"),
        )
        .route(
            "/plots.js",
            file!("plots.js", "text/javascript; charset=utf-8"),
        )
        .route(
            "/time.js",
            file!("time.js", "text/javascript; charset=utf-8"),
        )
        .route(
            "/uplot.js",
            vendored!("uplot/uPlot.iife.min.js", "text/javascript; charset=utf-8"),
        )
        .route(
            "/uplot.css",
            vendored!("uplot/uPlot.min.css", "text/css; charset=utf-8"),
        )
        .route(
            "/server.js",
            file!("server.js", "text/javascript; charset=utf-8"),
        )
}
