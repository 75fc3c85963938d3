//! Sends files as downloads, never as pages of this server.

use axum::{
    body::Body,
    http::header,
    response::{IntoResponse, Response},
};
use bench_http::Refusal;

/// A file as an answer.
///
/// # Errors
/// A file that is too long or cannot be read.
pub(super) fn sent(file: std::fs::File, longest: u64) -> Result<Response, Refusal> {
    let length = file
        .metadata()
        .map_err(|error| Refusal::machine(&error))?
        .len();
    if length > longest {
        return Err(Refusal::conflict(format!(
            "expected a file of at most {longest} bytes, found {length}: copy it from the disk"
        )));
    }
    let mut bytes = Vec::new();
    std::io::Read::read_to_end(&mut std::io::Read::take(file, longest), &mut bytes)
        .map_err(|error| Refusal::machine(&error))?;
    let headers = [
        (header::CONTENT_TYPE, "application/octet-stream"),
        (header::CONTENT_DISPOSITION, "attachment"),
    ];
    Ok((headers, Body::from(bytes)).into_response())
}
