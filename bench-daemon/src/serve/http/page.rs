//! Serves the files of the page, which are part of the program.

use axum::{Router, http::header, response::IntoResponse, routing::get};

use super::App;

/// Text of a file of this crate.
macro_rules! text {
    ($path:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), $path))
    };
}

const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Where the files are found, their kinds and texts.
const FILES: [(&str, &str, &str); 9] = [
    (
        "/",
        "text/html; charset=utf-8",
        text!("/src/serve/page/index.html"),
    ),
    ("/style.css", CSS, text!("/src/serve/page/style.css")),
    ("/app.js", SCRIPT, text!("/src/serve/page/app.js")),
    ("/bench.js", SCRIPT, text!("/src/serve/page/bench.js")),
    ("/plots.js", SCRIPT, text!("/src/serve/page/plots.js")),
    ("/time.js", SCRIPT, text!("/src/serve/page/time.js")),
    ("/server.js", SCRIPT, text!("/src/serve/page/server.js")),
    (
        "/uplot.js",
        SCRIPT,
        text!("/vendor/uplot/uPlot.iife.min.js"),
    ),
    ("/uplot.css", CSS, text!("/vendor/uplot/uPlot.min.css")),
];

/// Where they are found.
pub(super) fn routes() -> Router<App> {
    let with = |router: Router<App>,
                (path, kind, text): (&'static str, &'static str, &'static str)| {
        router.route(
            path,
            get(move || async move { ([(header::CONTENT_TYPE, kind)], text).into_response() }),
        )
    };
    FILES.into_iter().fold(Router::new(), with)
}
