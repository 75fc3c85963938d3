//! Routes of files of the configuration, of drafts, and of the schemas that forms are made from.

use axum::{
    Json,
    extract::{Path, Query, State},
};
use bench_http::Refusal;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    App,
    aside::aside,
    caller::{Energiser, Reader},
    queue::Planned,
};
use crate::{
    draft::{self, KeyChange, Margin, Mistake},
    jobs,
    settings::Settings,
    shelf::{self, Change, FileKind, Listed, ShelfError, Version},
    submission,
};
use bench_plan::{config::schema, support::confined_path::plain};

/// Longest reason of a change, characters.
const LONGEST_WHY: usize = 1000;
/// Longest name of a file, characters.
const LONGEST_NAME: usize = 60;

/// A file with its history. The text of a bench is the proposed version if there is one, otherwise
/// the version in force; version 0 is the file in force.
#[derive(Debug, Serialize, ToSchema)]
pub struct ShelfFile {
    /// Its name.
    name: String,
    /// Its text, TOML.
    text: String,
    /// The text as values; null if it is not valid TOML.
    value: serde_json::Value,
    /// SHA-256 of the text.
    sha256: String,
    /// All versions, the oldest first.
    versions: Vec<Version>,
    /// Keys in which the text differs from the file of the configuration, which for a bench is the
    /// file in force. Null if that file does not exist, or if either text is not valid TOML.
    changes: Option<Vec<KeyChange>>,
    /// For a bench: the version that is proposed but not in force; null if there is none.
    proposed: Option<usize>,
    /// For a bench: why no run starts on it until the server is restarted; null if runs can start.
    restart: Option<String>,
}

/// A new version of a file.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewVersion {
    /// The whole text.
    text: String,
    /// Reason for the change, 1 to 1000 characters.
    why: String,
    /// SHA-256 of the text that it is based on; null for a new file.
    was_sha256: Option<String>,
}

/// Selects a version.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub struct OfVersion {
    /// Its number. Left out: the latest.
    version: Option<usize>,
}

/// A draft of a file.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct NewDraft {
    /// Its text, TOML. Left out if `value` is given.
    text: Option<String>,
    /// Its values, according to the schema of experiments.
    value: Option<serde_json::Value>,
    /// The bench. Left out: the one that the experiment names.
    bench: Option<String>,
    /// Kind of the file. Left out: an experiment. A cell and a bench have no plan.
    kind: Option<FileKind>,
    /// Name of the file of a cell or a bench.
    name: Option<String>,
}

/// Effect of a draft.
#[derive(Debug, Serialize, ToSchema)]
pub struct Draft {
    /// Its text.
    text: String,
    /// Its values; null if the text is not valid TOML.
    value: serde_json::Value,
    /// The first invalid field.
    mistakes: Vec<Mistake>,
    /// The plan, if the draft is valid.
    plan: Option<Planned>,
    /// Requirements of the plan and the limits of the cell.
    margins: Vec<Margin>,
}

impl Draft {
    fn without_plan(text: String, value: serde_json::Value, mistake: Option<Mistake>) -> Self {
        Self {
            text,
            value,
            mistakes: mistake.into_iter().collect(),
            margins: Vec::new(),
            plan: None,
        }
    }
}

/// The experiment of a run.
#[derive(Debug, Serialize, ToSchema)]
pub struct OfRun {
    /// Its name.
    name: String,
    /// The bench of the run.
    bench: String,
    /// Its text, TOML.
    text: String,
    /// Its values.
    value: serde_json::Value,
}

/// Returns a text as values, or null if it is not valid TOML.
fn value_of(text: &str) -> serde_json::Value {
    let value: Option<toml::Value> = toml::from_str(text).ok();
    value
        .and_then(|value| serde_json::to_value(value).ok())
        .unwrap_or_default()
}

/// Formats values as TOML; null values are left out.
fn text_of(mut value: serde_json::Value) -> Result<String, Refusal> {
    without_nulls(&mut value);
    if !value.is_object() {
        return Err(Refusal::unfit("value: expected an object"));
    }
    toml::to_string_pretty(&value).map_err(|error| Refusal::unfit(format!("value: {error}")))
}

fn without_nulls(value: &mut serde_json::Value) {
    match value {
        serde_json::Value::Object(all) => {
            all.retain(|_, value| !value.is_null());
            all.values_mut().for_each(without_nulls);
        }
        serde_json::Value::Array(all) => {
            all.retain(|value| !value.is_null());
            all.iter_mut().for_each(without_nulls);
        }
        _ => {}
    }
}

/// Returns the JSON Schema of a kind of file.
#[utoipa::path(
    get,
    path = "/api/v1/schemas/{kind}",
    tag = "files",
    params(("kind" = String, Path, description = "`experiment`, `cell` or `bench`")),
    responses((status = 200, body = serde_json::Value)),
    security(("token" = ["read"]))
)]
pub async fn schema(
    _caller: Reader,
    Path(kind): Path<String>,
) -> Result<Json<serde_json::Value>, Refusal> {
    let kind = match kind.as_str() {
        "experiment" => schema::Kind::Experiment,
        "cell" => schema::Kind::Cell,
        "bench" => schema::Kind::Bench,
        _ => return Err(Refusal::not_found("a schema", &kind)),
    };
    serde_json::from_str(kind.schema())
        .map(Json)
        .map_err(|error| Refusal::machine(&error))
}

/// Returns all files of a kind.
#[utoipa::path(
    get,
    path = "/api/v1/files/{kind}",
    tag = "files",
    params(("kind" = FileKind, Path)),
    responses((status = 200, body = [Listed])),
    security(("token" = ["read"]))
)]
pub async fn list(
    _caller: Reader,
    State(app): State<App>,
    Path(kind): Path<FileKind>,
) -> Result<Json<Vec<Listed>>, Refusal> {
    aside(move || Ok(Json(shelf::list(&app.server.settings, kind)))).await
}

/// Returns a file with its history.
#[utoipa::path(
    get,
    path = "/api/v1/files/{kind}/{name}",
    tag = "files",
    params(("kind" = FileKind, Path), ("name" = String, Path), OfVersion),
    responses((status = 200, body = ShelfFile)),
    security(("token" = ["read"]))
)]
pub async fn read(
    _caller: Reader,
    State(app): State<App>,
    Path((kind, name)): Path<(FileKind, String)>,
    Query(of): Query<OfVersion>,
) -> Result<Json<ShelfFile>, Refusal> {
    aside(move || shelf_file(&app.server.settings, kind, &name, of.version).map(Json)).await
}

fn shelf_file(
    settings: &Settings,
    kind: FileKind,
    name: &str,
    version: Option<usize>,
) -> Result<ShelfFile, Refusal> {
    let file = shelf::read(settings, kind, name, version)
        .map_err(|error| Refusal::machine(&error))?
        .ok_or_else(|| Refusal::not_found("a file", name))?;
    let bench = settings.bench(name).filter(|_| kind == FileKind::Benches);
    let changes = |was: &String| draft::key_changes(was, &file.text);
    Ok(ShelfFile {
        name: name.to_owned(),
        changes: file.original.as_ref().and_then(changes),
        proposed: file.proposed,
        restart: bench.and_then(shelf::restart_needed),
        value: value_of(&file.text),
        text: file.text,
        sha256: file.sha256,
        versions: file.versions,
    })
}

/// A name that a file may have.
fn named(name: &str) -> Result<(), Refusal> {
    if plain(name) && name.len() <= LONGEST_NAME {
        return Ok(());
    }
    Err(Refusal::unfit(format!(
        "expected a name of at most {LONGEST_NAME} letters, digits, `-` and `_`, found {name:?}"
    )))
}

/// Checks a text and stores it as a new version of a file. The file of the configuration is not
/// changed. Later submissions use the new version of an experiment or a cell. A version of a bench
/// is a proposal: `eis-bench config take`, at the machine, puts it in force.
#[utoipa::path(
    put,
    path = "/api/v1/files/{kind}/{name}",
    tag = "files",
    params(("kind" = FileKind, Path), ("name" = String, Path)),
    request_body = NewVersion,
    responses((status = 200, body = ShelfFile)),
    security(("token" = ["energise"]))
)]
pub async fn write(
    caller: Energiser,
    State(app): State<App>,
    Path((kind, name)): Path<(FileKind, String)>,
    Json(new): Json<NewVersion>,
) -> Result<Json<ShelfFile>, Refusal> {
    let why = new.why.trim().to_owned();
    if why.is_empty() || why.chars().count() > LONGEST_WHY || why.chars().any(char::is_control) {
        return Err(Refusal::unfit(format!(
            "why: expected 1 to {LONGEST_WHY} characters in one line"
        )));
    }
    if kind != FileKind::Benches {
        named(&name)?;
    }
    aside(move || {
        let settings = &app.server.settings;
        if kind == FileKind::Benches && settings.bench(&name).is_none() {
            return Err(Refusal::not_found("a bench", &name));
        }
        draft::check(settings, kind, &name, &new.text)
            .map_err(|mistake| Refusal::unfit(format!("text: {}", mistake.in_words())))?;
        let change = Change {
            text: &new.text,
            by: &caller.name,
            why: &why,
            was_sha256: new.was_sha256.as_deref(),
        };
        let _one = app.server.shelf();
        shelf::write(settings, kind, &name, change).map_err(|error| match error {
            ShelfError::Io(_) => Refusal::machine(&error),
            _ => Refusal::conflict(error.to_string()),
        })?;
        shelf_file(settings, kind, &name, None).map(Json)
    })
    .await
}

/// Returns the plan of an experiment on a bench, or the mistakes in an experiment, a cell or a
/// bench. Changes nothing.
#[utoipa::path(
    post,
    path = "/api/v1/drafts",
    tag = "files",
    request_body = NewDraft,
    responses((status = 200, body = Draft)),
    security(("token" = ["read"]))
)]
pub async fn draft(
    _caller: Reader,
    State(app): State<App>,
    Json(new): Json<NewDraft>,
) -> Result<Json<Draft>, Refusal> {
    aside(move || {
        let text = match (new.text, new.value) {
            (Some(text), None) => text,
            (None, Some(value)) => text_of(value)?,
            _ => return Err(Refusal::unfit("expected either `text` or `value`")),
        };
        let settings = &app.server.settings;
        let value = value_of(&text);
        if let Some(kind) = new.kind.filter(|kind| *kind != FileKind::Experiments) {
            let name = new.name.unwrap_or_default();
            if settings.bench(&name).is_none() {
                named(&name)?;
            }
            let mistake = draft::check(settings, kind, &name, &text).err();
            return Ok(Json(Draft::without_plan(text, value, mistake)));
        }
        let found = draft::submission(settings, &text, new.bench.as_deref());
        Ok(Json(match found {
            Ok(submission) => Draft {
                text,
                value,
                mistakes: Vec::new(),
                margins: draft::margins(&submission),
                plan: Some(Planned::of(&submission)),
            },
            Err(mistake) => Draft::without_plan(text, value, Some(mistake)),
        }))
    })
    .await
}

/// Returns the experiment of a run that this server started or that waits in its queue, as it was
/// submitted.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/experiment",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = OfRun)),
    security(("token" = ["read"]))
)]
pub async fn of_run(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<OfRun>, Refusal> {
    aside(move || {
        let data = &app.server.settings.data;
        let item = Some(&run)
            .filter(|run| plain(run))
            .and_then(|run| jobs::submitted(data, &app.server.queue(), run));
        let item = item.ok_or_else(|| Refusal::not_found("a run", &run))?;
        let text = submission::of_run(data, &run).map(|(_, text)| text);
        let text = text.ok_or_else(|| Refusal::not_found("the experiment of the run", &run))?;
        Ok(Json(OfRun {
            name: item.experiment,
            bench: item.bench,
            value: value_of(&text),
            text,
        }))
    })
    .await
}
