//! Serves the files of the page, which are part of the program. They are compressed if the
//! browser accepts that, and are not sent again if it has them.

use std::{io::Write, sync::LazyLock};

use axum::{
    Router,
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
    routing::get,
};
use flate2::{Compression, write::GzEncoder};

use super::App;
use bench_plan::support::hash;

/// Text of a file of this crate.
macro_rules! text {
    ($($part:literal),+) => {
        include_str!(concat!(env!("CARGO_MANIFEST_DIR"), $($part),+))
    };
}

/// Files of the page's own folder, with their kinds.
macro_rules! own {
    ($($name:literal),* $(,)?) => {
        &[$((concat!("/", $name), text!("/src/page/", $name))),*]
    };
}

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";

/// Paths and texts of the project's own files.
const OWN: &[(&str, &str)] = own![
    "index.html",
    "style.css",
    "curves.css",
    "forms.css",
    "find.css",
    "analysis.css",
    "app.js",
    "bench.js",
    "energise.js",
    "server.js",
    "question.js",
    "time.js",
    "tour.js",
    "curves.js",
    "forms.js",
    "schema.js",
    "find.js",
    "catalog.js",
    "run.js",
    "cell.js",
    "overtime.js",
    "ageing.js",
    "notes.js",
    "notices.js",
    "analysis.js",
    "story.js",
    "pack.js",
];

/// Paths and texts of libraries (see `vendor`).
const VENDOR: &[(&str, &str)] = &[
    ("/uplot.js", text!("/../vendor/uplot/uPlot.iife.min.js")),
    ("/uplot.css", text!("/../vendor/uplot/uPlot.min.css")),
    ("/d3.js", text!("/../vendor/d3/d3.min.js")),
];

/// A file of the page.
struct PageFile {
    path: &'static str,
    kind: &'static str,
    text: &'static str,
    gzip: Vec<u8>,
    tag: String,
}

impl PageFile {
    fn of(path: &'static str, text: &'static str) -> Self {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        // Writing to memory cannot fail.
        let _ = encoder.write_all(text.as_bytes());
        let kind = match path.rsplit('.').next() {
            Some("css") => CSS,
            Some("js") => SCRIPT,
            _ => HTML,
        };
        Self {
            path: if path == "/index.html" { "/" } else { path },
            kind,
            text,
            gzip: encoder.finish().unwrap_or_default(),
            tag: format!("\"{}\"", &hash::sha256(text)[..16]),
        }
    }

    fn answer(&self, headers: &HeaderMap) -> Response {
        let has = |name, wanted: &str| {
            let value = headers.get(name).and_then(|value| value.to_str().ok());
            value.is_some_and(|value| value.split(',').any(|one| one.trim().starts_with(wanted)))
        };
        let common = [
            (header::CACHE_CONTROL, "no-cache"),
            (header::ETAG, self.tag.as_str()),
            (header::VARY, "Accept-Encoding"),
        ];
        if has(header::IF_NONE_MATCH, &self.tag) {
            return (StatusCode::NOT_MODIFIED, common).into_response();
        }
        let kind = [(header::CONTENT_TYPE, self.kind)];
        if has(header::ACCEPT_ENCODING, "gzip") && !self.gzip.is_empty() {
            let encoding = [(header::CONTENT_ENCODING, "gzip")];
            return (common, kind, encoding, self.gzip.clone()).into_response();
        }
        (common, kind, self.text).into_response()
    }
}

static FILES: LazyLock<Vec<PageFile>> = LazyLock::new(|| {
    let all = OWN.iter().chain(VENDOR);
    all.map(|(path, text)| PageFile::of(path, text)).collect()
});

/// Where they are found.
pub(super) fn routes() -> Router<App> {
    FILES.iter().fold(Router::new(), |router, file| {
        let answer = move |headers: HeaderMap| async move { file.answer(&headers) };
        router.route(file.path, get(answer))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Maximum transferred size of the page, bytes: the project's budget.
    const BUDGET: usize = 400_000;

    #[test]
    fn the_whole_page_keeps_its_budget() {
        let weight: usize = FILES.iter().map(|file| file.gzip.len()).sum();
        assert!(weight <= BUDGET, "{weight} bytes");
        assert!(FILES.iter().all(|file| file.gzip.len() < file.text.len()));
    }
}
