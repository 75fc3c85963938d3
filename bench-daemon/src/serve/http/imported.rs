//! Route of spectra of a file that somebody sends.

use std::{ffi::OsStr, path::Path, time::Duration};

use axum::{
    Json,
    body::Body,
    extract::{Query, State},
    http::{HeaderMap, StatusCode, header},
};
use serde::Deserialize;
use tokio::sync::OwnedSemaphorePermit;
use utoipa::IntoParams;

use super::{
    App,
    aside::aside,
    body::{self, BodyBounds},
    caller::Reader,
    problem::{Problem, Refusal},
};
use crate::serve::imported::{self, AT_ONCE, ImportedSpectra, LONGEST};

/// Longest name, bytes: NAME_MAX of Linux.
const LONGEST_NAME: usize = 255;
/// Kind of the body.
const BYTES: &str = "application/octet-stream";

/// Name of a file.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct FileNamed {
    /// Its name without a folder, at most 255 bytes; spectra and messages are named after it.
    #[param(min_length = 1, max_length = 255)]
    name: String,
}

impl FileNamed {
    /// The name, where it is one of a file.
    fn plain(self) -> Result<String, Refusal> {
        let is_file = Path::new(&self.name).file_name() == Some(OsStr::new(&self.name));
        if is_file && self.name.len() <= LONGEST_NAME && !self.name.contains(char::is_control) {
            return Ok(self.name);
        }
        let expected = format!("expected the name of a file of at most {LONGEST_NAME} bytes");
        Err(Refusal::of(
            StatusCode::BAD_REQUEST,
            format!("name: {expected}, found {:?}", self.name),
        ))
    }
}

/// Spectra of a file of any format that `eis-bench fit` reads, in the shape of those of a run, to
/// be compared with these. Nothing is kept.
#[utoipa::path(
    post,
    path = "/api/v1/spectra/read",
    tag = "runs",
    params(FileNamed),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses(
        (status = 200, body = ImportedSpectra),
        (status = 413, body = Problem, description = "The file has more than 8 000 000 bytes."),
        (status = 415, body = Problem, description = "The body is not said to be bytes."),
        (status = 422, body = Problem, description = "The file is of no known format.")
    ),
    security(("token" = ["read"]))
)]
pub async fn read(
    _caller: Reader,
    State(app): State<App>,
    Query(file): Query<FileNamed>,
    headers: HeaderMap,
    body: Body,
) -> Result<Json<ImportedSpectra>, Refusal> {
    let name = file.plain()?;
    of_bytes(&headers)?;
    let place = place(&app).await?;
    let bounds = BodyBounds {
        most: LONGEST,
        patience_s: app.server.settings.limits.patience_s,
    };
    let bytes = body::whole(&app.server.clock, body, bounds).await?;
    aside(move || {
        // Held until it is read, even where nobody waits for the answer any more.
        let _place = place;
        imported::read(&name, &bytes)
            .map(Json)
            .map_err(Refusal::unfit)
    })
    .await
}

/// Refuses a body that is said to be something else than bytes.
fn of_bytes(headers: &HeaderMap) -> Result<(), Refusal> {
    let kind = headers.get(header::CONTENT_TYPE);
    let kind = kind.and_then(|kind| kind.to_str().ok()).unwrap_or("none");
    if kind.eq_ignore_ascii_case(BYTES) {
        return Ok(());
    }
    Err(Refusal::new(
        StatusCode::UNSUPPORTED_MEDIA_TYPE,
        "not_bytes",
        format!("Content-Type: expected {BYTES}, found {kind}"),
    ))
}

/// A place among the files that are read at the same time.
async fn place(app: &App) -> Result<OwnedSemaphorePermit, Refusal> {
    let patience = Duration::from_secs_f64(app.server.settings.limits.patience_s);
    let waits = app.imports.clone().acquire_owned();
    match app.server.clock.deadline(patience, waits).await {
        Ok(Ok(place)) => Ok(place),
        _ => Err(Refusal::of(
            StatusCode::SERVICE_UNAVAILABLE,
            format!(
                "expected at most {AT_ONCE} files to be read at once, found as many: try again"
            ),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_one_of_a_file_and_leads_nowhere() {
        let plain = |name: &str| {
            let name = name.to_owned();
            FileNamed { name }.plain().is_ok()
        };
        for name in ["a.csv", "Zelle ä #2.mpt", ".hidden", "a\\b"] {
            assert!(plain(name), "{name}");
        }
        let long = "x".repeat(256);
        for name in ["", ".", "..", "/", "a/b", "../a", "a/", "/a", "a\nb", &long] {
            assert!(!plain(name), "{name}");
        }
    }
}
