//! Route for the spectra of an uploaded file.

use std::{ffi::OsStr, path::Path, process::Stdio, time::Duration};

use axum::{
    body::Body,
    extract::{Query, State},
    http::{HeaderMap, StatusCode, header},
    response::{IntoResponse, Response},
};
use bench_http::{Problem, Refusal};
use serde::Deserialize;
use tokio::{io::AsyncWriteExt, sync::OwnedSemaphorePermit};
use utoipa::IntoParams;

use super::{
    App,
    body::{self, BodyBounds},
    caller::Reader,
};
use crate::imported::{self, AT_ONCE, ImportedSpectra, LONGEST, WAIT_S};

/// Longest name, bytes: NAME_MAX of Linux.
const LONGEST_NAME: usize = 255;
/// Kind of the body.
const BYTES: &str = "application/octet-stream";

/// Name of a file.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct FileNamed {
    /// Its name without a folder, at most 255 bytes; used in the names of spectra and in messages.
    #[param(min_length = 1, max_length = 255)]
    name: String,
}

impl FileNamed {
    /// Returns the name if it is a plain file name.
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

/// Returns the spectra of a file of any format that `eis-bench fit` reads, in the format of those
/// of a run, for comparison. Nothing is stored.
#[utoipa::path(
    post,
    path = "/api/v1/spectra/read",
    tag = "runs",
    params(FileNamed),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses(
        (status = 200, body = ImportedSpectra),
        (status = 413, body = Problem, description = "The file has more than 8 000 000 bytes."),
        (status = 415, body = Problem, description = "The content type of the body is not bytes."),
        (status = 422, body = Problem, description = "The format of the file is unknown.")
    ),
    security(("token" = ["read"]))
)]
pub async fn read(
    _caller: Reader,
    State(app): State<App>,
    Query(file): Query<FileNamed>,
    headers: HeaderMap,
    body: Body,
) -> Result<Response, Refusal> {
    let name = file.plain()?;
    of_bytes(&headers)?;
    let place = place(&app).await?;
    let bounds = BodyBounds {
        most: LONGEST,
        patience_s: app.server.settings.limits.patience_s,
    };
    let bytes = body::whole(&app.server.clock, body, bounds).await?;
    let spectra = by_process(&app, &name, &bytes).await;
    drop(place);
    Ok(([(header::CONTENT_TYPE, "application/json")], spectra?).into_response())
}

/// Lets a process of its own read a file; the spectra as JSON.
async fn by_process(app: &App, name: &str, bytes: &[u8]) -> Result<Vec<u8>, Refusal> {
    let failed = |error: std::io::Error| Refusal::machine(&error);
    let mut child = tokio::process::Command::new(&app.server.program)
        .args(["read-spectra", "--", name])
        // A thread of the pools needs address space.
        .envs([("POLARS_MAX_THREADS", "1"), ("RAYON_NUM_THREADS", "1")])
        .env_remove("NOTIFY_SOCKET")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .kill_on_drop(true)
        .spawn()
        .map_err(failed)?;
    let input = child.stdin.take();
    let feed = async move {
        if let Some(mut input) = input {
            // One that ends early has said why.
            let _ = input.write_all(bytes).await;
        }
    };
    let whole = async { tokio::join!(feed, child.wait_with_output()).1 };
    let wait = Duration::from_secs_f64(WAIT_S);
    let output = app.server.clock.deadline(wait, whole).await;
    let output = output
        .map_err(|error| Refusal::machine(&error))?
        .map_err(failed)?;
    if output.status.success() {
        return Ok(output.stdout);
    }
    let errors = String::from_utf8_lossy(&output.stderr);
    Err(Refusal::unfit(imported::refusal(
        name,
        output.status.code(),
        &errors,
    )))
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

/// Takes one of the permits for files that are read at the same time.
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
