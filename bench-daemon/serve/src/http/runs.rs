//! Routes of runs: state, spectra, fits, readings and files, and run control requests.

use std::{collections::BTreeMap, path::PathBuf, process::Stdio, time::Duration};

use analysis::run_folder::{LOG, READINGS, SUMS};
use axum::{
    Json,
    extract::{Path, Query, State},
    http::StatusCode,
    response::Response,
};
use bench_http::Refusal;
use instruments::clock;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    App,
    aside::aside,
    benches::Most,
    caller::{Energiser, Operator, Reader},
    sent::sent,
};
use crate::watch::Watch;
use crate::{
    find::{self, Card},
    jobs::{self, Job},
    live::RunNow,
    queue::{Item, Kind, Wanted},
    spectra::{self, Spectrum},
    timeline::{Part, Readings},
    traced::Traced,
};
use bench_plan::support::{
    confined_path::{self, plain},
    hash,
};

/// Time within which a run control request is passed on, or not at all.
const RUN_CONTROL_DEADLINE: Duration = Duration::from_secs(20);
/// Longest file that is sent, bytes: captures are copied from the disk instead.
const LONGEST: u64 = 256 * 1024 * 1024;
/// Longest serial number of a cell, characters.
const LONGEST_SERIAL: usize = 100;

/// A run in full.
#[derive(Debug, Serialize, ToSchema)]
pub struct Run {
    /// Request for the run, and its end; null for a run that this server did not start.
    job: Option<Job>,
    /// Progress of the run.
    now: RunNow,
    /// True if it was interrupted and can be resumed.
    resumable: bool,
    /// Summary with cells and tags; null for a run that this server did not start.
    card: Option<Card>,
    /// SHA-256 of its list of hashes, by which a catalogue names the run; none before that is written.
    content_sha256: Option<String>,
}

/// A file of a run.
#[derive(Debug, Serialize, ToSchema)]
pub struct FileEntry {
    /// Its path in the run folder.
    path: String,
    /// Its length, bytes.
    bytes: u64,
}

/// Lines of a log.
#[derive(Debug, Serialize, ToSchema)]
pub struct Log {
    /// The latest lines, the latest last.
    lines: Vec<String>,
}

impl Log {
    /// These lines.
    pub(super) fn of(lines: Vec<String>) -> Self {
        Self { lines }
    }
}

/// Numbers of runs of a campaign.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct CampaignOrder {
    /// The next runs, in this order.
    runs: Vec<u32>,
}

/// Confirmation that the fixture was changed as asked.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FixtureChanged {
    /// Number of the question.
    question: u64,
    /// Serial number that was read from the cell, by eye or by a scanner; refused if it is not that
    /// of the requested cell.
    #[schema(max_length = 100)]
    serial: Option<String>,
}

/// Run control request that was passed on.
#[derive(Debug, Serialize, ToSchema)]
pub struct Conveyed {
    /// Reaction of the run, as text.
    #[serde(rename = "said")]
    message: String,
}

pub(super) fn folder(app: &App, run: &str) -> Result<PathBuf, Refusal> {
    confined_path::folder(&app.server.runs(), run).ok_or_else(|| Refusal::not_found("a run", run))
}

/// Returns all runs that this server started, the latest first.
#[utoipa::path(
    get,
    path = "/api/v1/runs",
    tag = "runs",
    params(Most),
    responses((status = 200, body = [Job])),
    security(("token" = ["read"]))
)]
pub async fn list(
    _caller: Reader,
    State(app): State<App>,
    Query(most): Query<Most>,
) -> Result<Json<Vec<Job>>, Refusal> {
    let most = most.or(500)?;
    aside(move || Ok(Json(app.server.jobs.latest().take(most).collect()))).await
}

/// Returns a run: its request, its progress and its end.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = Run)),
    security(("token" = ["read"]))
)]
pub async fn detail(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Run>, Refusal> {
    if !plain(&run) {
        return Err(Refusal::not_found("a run", &run));
    }
    aside(move || {
        let job = jobs::read(&app.server.settings.data, &run);
        // A run whose process could not be started has a record and no folder.
        let folder = match folder(&app, &run) {
            Err(_) if job.is_some() => app.server.runs().join(&run),
            found => found?,
        };
        let going = job.as_ref().is_some_and(|job| job.ended.is_none());
        let mut watch = Watch::new(&folder);
        watch.look();
        let resumable = !going && watch.experiment().is_some() && watch.ended() != Some("finished");
        let (data, notebook) = (&app.server.settings.data, &app.server.notebook);
        let card = job.as_ref().map(|job| find::card(data, notebook, job));
        Ok(Json(Run {
            content_sha256: hash::sha256_of(&folder.join(SUMS)).ok(),
            card,
            job,
            now: watch.now(Some(run), going),
            resumable,
        }))
    })
    .await
}

/// Returns the spectra of a run that are measured so far: `spectrum…` corrected, `raw_…` as read.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/spectra",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = [Spectrum])),
    security(("token" = ["read"]))
)]
pub async fn spectra(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Vec<Spectrum>>, Refusal> {
    let folder = folder(&app, &run)?;
    aside(move || {
        Ok(Json(
            spectra::stamps(&folder)
                .keys()
                .filter_map(|file| spectra::read(&folder, file))
                .collect(),
        ))
    })
    .await
}

/// Returns the fitted models of a run, by name, as in their files.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/fits",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = BTreeMap<String, serde_json::Value>)),
    security(("token" = ["read"]))
)]
pub async fn fits(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<BTreeMap<String, serde_json::Value>>, Refusal> {
    let folder = folder(&app, &run)?;
    aside(move || Ok(Json(spectra::fits(&folder).into_iter().collect()))).await
}

/// Returns the readings of a run, or of a part of it: all of them, or those with the least and
/// greatest values, so that no peak is lost. Steps and checks are returned with them.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/readings",
    tag = "runs",
    params(("run" = String, Path), Part),
    responses((status = 200, body = Readings)),
    security(("token" = ["read"]))
)]
pub async fn readings(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
    Query(part): Query<Part>,
) -> Result<Json<Readings>, Refusal> {
    let folder = folder(&app, &run)?;
    let most = part.most.map_or(1000, usize::from);
    if !(8..=10_000).contains(&most) {
        let expected = format!("most: expected 8 to 10000, found {most}");
        return Err(Refusal::of(StatusCode::BAD_REQUEST, expected));
    }
    aside(move || {
        let timelines = &app.server.timelines;
        timelines
            .read(&folder, &part, most)
            .map(Json)
            .ok_or_else(|| Refusal::not_found("a file", READINGS))
    })
    .await
}

/// Returns the last lines of a run: its log, followed by the output of its process.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/log",
    tag = "runs",
    params(("run" = String, Path), Most),
    responses((status = 200, body = Log)),
    security(("token" = ["read"]))
)]
pub async fn log(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
    Query(most): Query<Most>,
) -> Result<Json<Log>, Refusal> {
    let (folder, most) = (folder(&app, &run)?, most.or(200)?);
    aside(move || {
        let logs = app.server.settings.data.join("logs");
        let name = format!("{run}.log");
        let ends = [(&folder, LOG), (&logs, name.as_str())];
        let ends = ends.map(|(folder, name)| confined_path::tail(folder, name));
        let mut lines: Vec<String> = ends
            .iter()
            .flat_map(|end| end.lines().map(str::to_owned))
            .collect();
        lines.drain(..lines.len().saturating_sub(most));
        Ok(Json(Log { lines }))
    })
    .await
}

/// Returns the list of files of a run.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/files",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = [FileEntry])),
    security(("token" = ["read"]))
)]
pub async fn files(
    _caller: Reader,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Vec<FileEntry>>, Refusal> {
    let folder = folder(&app, &run)?;
    aside(move || {
        let found = confined_path::list(&folder).map_err(|error| Refusal::machine(&error))?;
        Ok(Json(
            found
                .into_iter()
                .map(|(path, bytes)| FileEntry { path, bytes })
                .collect(),
        ))
    })
    .await
}

/// Returns a file of a run as a download; it is not rendered as a page of this server.
#[utoipa::path(
    get,
    path = "/api/v1/runs/{run}/files/{path}",
    tag = "runs",
    params(("run" = String, Path), ("path" = String, Path)),
    responses((status = 200, body = [u8], content_type = "application/octet-stream")),
    security(("token" = ["read"]))
)]
pub async fn file(
    _caller: Reader,
    State(app): State<App>,
    Path((run, path)): Path<(String, String)>,
) -> Result<Response, Refusal> {
    let folder = folder(&app, &run)?;
    aside(move || {
        let missing = || Refusal::not_found("a file of the run", &path);
        let file = confined_path::open(&folder, &path).ok_or_else(missing)?;
        sent(file, LONGEST)
    })
    .await
}

/// Passes a run control request on, as a terminal would.
async fn send_request(
    app: &App,
    run: &str,
    word: &'static str,
    more: &[String],
) -> Result<Json<Conveyed>, Refusal> {
    let folder = folder(app, run)?;
    let mut command = tokio::process::Command::new(&app.server.program);
    command
        .arg(word)
        .arg(&folder)
        .args(more)
        .stdin(Stdio::null())
        .kill_on_drop(true)
        .env_remove("NOTIFY_SOCKET");
    let output = app
        .server
        .clock
        .deadline(RUN_CONTROL_DEADLINE, command.output())
        .await
        .map_err(|error| Refusal::machine(&error))?;
    let output = output.map_err(|error| Refusal::machine(&error))?;
    if output.status.success() {
        return Ok(Json(Conveyed {
            message: String::from_utf8_lossy(&output.stdout).trim().to_owned(),
        }));
    }
    let message = String::from_utf8_lossy(&output.stderr);
    let why = message
        .lines()
        .rev()
        .find_map(|line| line.strip_prefix("eis-bench: "))
        .unwrap_or("the request was refused");
    // The caller knows the run by its name; the machine's folders are not disclosed.
    let prefix = format!("{}: ", folder.display());
    Err(Refusal::conflict(why.strip_prefix(&prefix).unwrap_or(why)))
}

/// Pauses a run at its next point, without any current.
#[utoipa::path(
    post,
    path = "/api/v1/runs/{run}/pause",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = Conveyed)),
    security(("token" = ["operate"]))
)]
pub async fn pause(
    _caller: Operator,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Conveyed>, Refusal> {
    send_request(&app, &run, "pause", &[]).await
}

/// Continues a paused run: that lets current flow.
#[utoipa::path(
    post,
    path = "/api/v1/runs/{run}/go-on",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 200, body = Conveyed)),
    security(("token" = ["energise"]))
)]
pub async fn go_on(
    _caller: Energiser,
    State(app): State<App>,
    Path(run): Path<String>,
) -> Result<Json<Conveyed>, Refusal> {
    send_request(&app, &run, "go-on", &[]).await
}

/// Sets the next runs of a campaign.
#[utoipa::path(
    post,
    path = "/api/v1/runs/{run}/order",
    tag = "runs",
    params(("run" = String, Path)),
    request_body = CampaignOrder,
    responses((status = 200, body = Conveyed)),
    security(("token" = ["operate"]))
)]
pub async fn order(
    _caller: Operator,
    State(app): State<App>,
    Path(run): Path<String>,
    Json(order): Json<CampaignOrder>,
) -> Result<Json<Conveyed>, Refusal> {
    if order.runs.is_empty() || order.runs.len() > 1000 {
        return Err(Refusal::of(
            StatusCode::UNPROCESSABLE_ENTITY,
            "runs: expected 1 to 1000 numbers",
        ));
    }
    let numbers: Vec<String> = order.runs.iter().map(u32::to_string).collect();
    send_request(&app, &run, "reorder", &numbers).await
}

/// Answers the question of a run: the fixture is changed as asked. That lets current flow.
#[utoipa::path(
    post,
    path = "/api/v1/runs/{run}/answer",
    tag = "runs",
    params(("run" = String, Path)),
    request_body = FixtureChanged,
    responses((status = 200, body = Conveyed)),
    security(("token" = ["energise"]))
)]
pub async fn answer(
    caller: Energiser,
    State(app): State<App>,
    Path(run): Path<String>,
    Json(answer): Json<FixtureChanged>,
) -> Result<Json<Conveyed>, Refusal> {
    let mut words = vec![
        "--done".to_owned(),
        format!("--question={}", answer.question),
        format!("--by={}", caller.name),
    ];
    if let Some(serial) = answer.serial.map(|serial| serial.trim().to_owned()) {
        let is_long = serial.chars().count() > LONGEST_SERIAL;
        if serial.is_empty() || is_long || serial.contains(char::is_control) {
            let text = format!("serial: expected 1 to {LONGEST_SERIAL} characters, or none");
            return Err(Refusal::of(StatusCode::UNPROCESSABLE_ENTITY, text));
        }
        words.push(format!("--serial={serial}"));
    }
    send_request(&app, &run, "answer", &words).await
}

/// Appends an interrupted run to the queue, to continue where it was interrupted: that lets current
/// flow.
#[utoipa::path(
    post,
    path = "/api/v1/runs/{run}/resume",
    tag = "runs",
    params(("run" = String, Path)),
    responses((status = 201, body = Item)),
    security(("token" = ["energise"]))
)]
pub async fn resume(
    caller: Energiser,
    State(app): State<App>,
    traced: Traced,
    Path(run): Path<String>,
) -> Result<(StatusCode, Json<Item>), Refusal> {
    folder(&app, &run)?;
    aside(move || {
        let server = &app.server;
        let job = jobs::read(&server.settings.data, &run).filter(|_| plain(&run));
        let Some(job) = job else {
            return Err(Refusal::conflict(
                "expected a run that this server started, found another one",
            ));
        };
        let finished = job.ended.as_ref().map(|ended| ended.finished);
        if finished != Some(false) || server.queue().items().iter().any(|item| item.run == run) {
            return Err(Refusal::conflict(
                "expected a run that was interrupted, found one that is \
            finished, in work, or waits to go on",
            ));
        }
        let Item {
            experiment,
            bench,
            seed,
            expected_s,
            ..
        } = job.item;
        let wanted = Wanted {
            kind: Kind::Resume,
            experiment,
            bench,
            seed,
            expected_s,
            by: caller.name,
            unix_s: clock::unix_time_s(),
            traceparent: traced.0,
        };
        let item = server.queue().submit(&wanted, |_| run)?;
        server.tell_queue();
        Ok((StatusCode::CREATED, Json(item)))
    })
    .await
}
