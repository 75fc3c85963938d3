//! Routes of what people write about runs and cells, and of models and records over a spectrum.

use analysis::catalog::query::Filter;
use axum::{
    Json,
    extract::{Path, Query, State},
    http::StatusCode,
};
use bench_http::Refusal;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    App,
    aside::aside,
    caller::{Operator, Reader},
    catalog,
    runs::folder,
};
use crate::{
    capture::{self, CaptureView},
    find::{self, Matrix},
    jobs,
    models::{self, ModelOver},
    notebook::{About, LONGEST_NOTE, LONGEST_TAG, MOST_TAGS, Note},
};
use bench_plan::support::confined_path;

/// Longest name of a cell, characters.
const LONGEST_CELL: usize = 200;

/// A new note.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewNote {
    /// The text, 1 to 4000 characters.
    text: String,
}

/// All tags of a run.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Tags {
    /// At most 20, each of 1 to 40 letters, digits, `-` and `_`.
    tags: Vec<String>,
}

/// A spectrum of a run.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct OfSpectrum {
    /// Name of the spectrum, as listed by `/spectra`.
    spectrum: String,
}

/// A point of a spectrum of a run.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct OfPoint {
    /// Name of the spectrum, as listed by `/spectra`.
    spectrum: String,
    /// Frequency of the point, Hz.
    freq_hz: f64,
}

impl NewNote {
    fn checked(self) -> Result<String, Refusal> {
        let text = self.text.trim().to_owned();
        let count = text.chars().count();
        let strange = text
            .chars()
            .any(|c| c.is_control() && c != '\n' && c != '\t');
        if count == 0 || count > LONGEST_NOTE || strange {
            return Err(Refusal::unfit(format!(
                "text: expected 1 to {LONGEST_NOTE} characters without control characters, found {count}"
            )));
        }
        Ok(text)
    }
}

impl Tags {
    fn checked(mut self) -> Result<Vec<String>, Refusal> {
        self.tags
            .iter_mut()
            .for_each(|tag| *tag = tag.trim().to_owned());
        self.tags.sort();
        self.tags.dedup();
        let plain = |tag: &&String| {
            !(1..=LONGEST_TAG).contains(&tag.chars().count())
                || !tag
                    .chars()
                    .all(|c| c.is_alphanumeric() || matches!(c, '-' | '_'))
        };
        if let Some(tag) = self.tags.iter().find(plain) {
            return Err(Refusal::unfit(format!(
                "tags: expected 1 to {LONGEST_TAG} letters, digits, `-` and `_` each, found {tag:?}"
            )));
        }
        if self.tags.len() > MOST_TAGS {
            return Err(Refusal::unfit(format!(
                "tags: expected at most {MOST_TAGS}, found {}",
                self.tags.len()
            )));
        }
        Ok(self.tags)
    }
}

/// A run that was begun here, in work, waiting or ended.
fn known_run(app: &App, run: &str) -> Result<(), Refusal> {
    let found = confined_path::plain(run) && jobs::read(&app.server.settings.data, run).is_some();
    found
        .then_some(())
        .ok_or_else(|| Refusal::not_found("a run", run))
}

/// A cell that a run of the catalogue has measured.
fn known_cell(app: &App, cell: &str) -> Result<(), Refusal> {
    let filter = Filter {
        cell: Some(cell.to_owned()),
        ..Filter::default()
    };
    let asked = cell.chars().count() <= LONGEST_CELL;
    let found = asked && {
        let catalog = app.server.catalog.open();
        let found = catalog.and_then(|catalog| catalog.cells(&filter));
        let found = found.map_err(|error| catalog::refused(&error))?;
        found.cells.iter().any(|one| one.cell == cell)
    };
    found
        .then_some(())
        .ok_or_else(|| Refusal::not_found("a cell that a run has measured", cell))
}

/// Returns the notes about a run, the latest last.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/notes",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = [Note])),
    security(("token" = ["read"]))
)]
pub async fn run_notes(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Vec<Note>>, Refusal> {
    aside(move || {
        known_run(&app, &run)?;
        Ok(Json(app.server.notebook.read(About::Run(&run)).notes))
    })
    .await
}

/// Adds a note to a run. Notes cannot be changed or removed.
#[utoipa::path(
    post,
    path = "/api/v1/runs/{run}/notes",
    tag = "runs",
    params(("run" = String, Path)),
    request_body = NewNote,
    responses((status = 201, body = Note)),
    security(("token" = ["operate"]))
)]
pub async fn note_run(
    caller: Operator,
    State(app): State<App>,
    Path(run): Path<String>,
    Json(note): Json<NewNote>,
) -> Result<(StatusCode, Json<Note>), Refusal> {
    let text = note.checked()?;
    aside(move || {
        known_run(&app, &run)?;
        let note = app
            .server
            .notebook
            .note(About::Run(&run), &caller.name, &text);
        let note = note.map_err(|error| Refusal::machine(&error))?;
        app.server.catalog.refresh_run(&run);
        Ok((StatusCode::CREATED, Json(note)))
    })
    .await
}

/// Replaces all tags of a run.
#[utoipa::path(
    put,
    path = "/api/v1/runs/{run}/tags",
    tag = "runs",
    params(("run" = String, Path)),
    request_body = Tags,
    responses((status = 200, body = Tags)),
    security(("token" = ["operate"]))
)]
pub async fn tag_run(
    caller: Operator,
    State(app): State<App>,
    Path(run): Path<String>,
    Json(tags): Json<Tags>,
) -> Result<Json<Tags>, Refusal> {
    let tags = tags.checked()?;
    aside(move || {
        known_run(&app, &run)?;
        let kept = app
            .server
            .notebook
            .tag(About::Run(&run), &caller.name, &tags);
        kept.map_err(|error| Refusal::machine(&error))?;
        app.server.catalog.refresh_run(&run);
        Ok(Json(Tags { tags }))
    })
    .await
}

/// Returns a campaign as a table of cells and repeats.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/campaign",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = Matrix)),
    security(("token" = ["read"]))
)]
pub async fn campaign(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Matrix>, Refusal> {
    aside(move || {
        known_run(&app, &run)?;
        let matrix = find::campaign(&app.server.settings.data, &run);
        matrix
            .map(Json)
            .ok_or_else(|| Refusal::not_found("a campaign", &run))
    })
    .await
}

/// Returns the fitted models of a run over one of its spectra, with the residual of each point.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/models",
    tag = "runs",
    params(("run" = String, Path), OfSpectrum),
    responses((status = 200, body = [ModelOver])),
    security(("token" = ["read"]))
)]
pub async fn models(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
    Query(of): Query<OfSpectrum>,
) -> Result<Json<Vec<ModelOver>>, Refusal> {
    let folder = folder(&app, &run)?;
    aside(move || {
        let found = models::over(&folder, &of.spectrum);
        found
            .map(Json)
            .ok_or_else(|| Refusal::not_found("a spectrum of the run", &of.spectrum))
    })
    .await
}

/// Returns the record behind a point of a spectrum.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/capture",
    tag = "runs",
    params(("run" = String, Path), OfPoint),
    responses((status = 200, body = CaptureView)),
    security(("token" = ["read"]))
)]
pub async fn capture(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
    Query(of): Query<OfPoint>,
) -> Result<Json<CaptureView>, Refusal> {
    let folder = folder(&app, &run)?;
    aside(move || {
        let known = crate::spectra::stamps(&folder).contains_key(&format!("{}.csv", of.spectrum));
        if !known {
            return Err(Refusal::not_found("a spectrum of the run", &of.spectrum));
        }
        capture::view(&folder, &of.spectrum, of.freq_hz)
            .map(Json)
            .map_err(|words| Refusal::of(StatusCode::NOT_FOUND, words))
    })
    .await
}

/// Returns the notes about a cell, the latest last.
#[utoipa::path(
    get,
    path = "/api/v1/cells/{cell}/notes",
    tag = "cells",
    params(("cell" = String, Path)),
    responses((status = 200, body = [Note])),
    security(("token" = ["read"]))
)]
pub async fn cell_notes(
    _caller: Reader,
    State(app): State<App>,
    Path(cell): Path<String>,
) -> Result<Json<Vec<Note>>, Refusal> {
    aside(move || {
        known_cell(&app, &cell)?;
        Ok(Json(app.server.notebook.read(About::Cell(&cell)).notes))
    })
    .await
}

/// Adds a note to a cell. Notes cannot be changed or removed.
#[utoipa::path(
    post,
    path = "/api/v1/cells/{cell}/notes",
    tag = "cells",
    params(("cell" = String, Path)),
    request_body = NewNote,
    responses((status = 201, body = Note)),
    security(("token" = ["operate"]))
)]
pub async fn note_cell(
    caller: Operator,
    State(app): State<App>,
    Path(cell): Path<String>,
    Json(note): Json<NewNote>,
) -> Result<(StatusCode, Json<Note>), Refusal> {
    let text = note.checked()?;
    aside(move || {
        known_cell(&app, &cell)?;
        let note = app
            .server
            .notebook
            .note(About::Cell(&cell), &caller.name, &text);
        let note = note.map_err(|error| Refusal::machine(&error))?;
        Ok((StatusCode::CREATED, Json(note)))
    })
    .await
}
