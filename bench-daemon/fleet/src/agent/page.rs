//! Serves the files of the page of the fleet, which are part of the program. The page uses style and
//! helpers of the page of the server, and loads nothing from elsewhere.

use std::sync::Arc;

use axum::{
    Router,
    http::header,
    response::{IntoResponse, Response},
    routing::get,
};

use super::app::App;

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// A file of the page.
#[derive(Clone, Copy)]
struct PageFile {
    path: &'static str,
    kind: &'static str,
    text: &'static str,
}

/// Text of a file of this crate.
macro_rules! own {
    ($name:literal) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/src/page/", $name))
    };
}

/// Text of a file of the page of the server.
macro_rules! shared {
    ($name:literal) => {
        include_str!(concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../serve/src/page/",
            $name
        ))
    };
}

const FILES: [PageFile; 9] = [
    PageFile {
        path: "/",
        kind: HTML,
        text: own!("index.html"),
    },
    PageFile {
        path: "/shell.js",
        kind: SCRIPT,
        text: own!("shell.js"),
    },
    PageFile {
        path: "/fleet.js",
        kind: SCRIPT,
        text: own!("fleet.js"),
    },
    PageFile {
        path: "/fleet.css",
        kind: CSS,
        text: own!("fleet.css"),
    },
    PageFile {
        path: "/style.css",
        kind: CSS,
        text: shared!("style.css"),
    },
    PageFile {
        path: "/find.css",
        kind: CSS,
        text: shared!("find.css"),
    },
    PageFile {
        path: "/bench.js",
        kind: SCRIPT,
        text: shared!("bench.js"),
    },
    PageFile {
        path: "/find.js",
        kind: SCRIPT,
        text: shared!("find.js"),
    },
    PageFile {
        path: "/server.js",
        kind: SCRIPT,
        text: shared!("server.js"),
    },
];

impl PageFile {
    fn answer(self) -> Response {
        let head = [
            (header::CACHE_CONTROL, "no-cache"),
            (header::CONTENT_TYPE, self.kind),
        ];
        (head, self.text).into_response()
    }
}

/// The routes of the files.
pub(crate) fn routes() -> Router<App> {
    FILES.iter().fold(Router::<Arc<_>>::new(), |router, file| {
        let answer = move || async move { file.answer() };
        router.route(file.path, get(answer))
    })
}
