//! Routes of the queue and of the experiments that can be put into it.

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
    benches::known,
    caller::{Energiser, Operator, Reader},
};
use crate::{
    jobs,
    notebook::{About, Note},
    queue::{HeldBy, Item, Kind, Queue, QueueError, Wanted},
    queue_now::QueueNow,
    shelf,
    submission::{ExperimentRequest, Refused, Submission},
    token::Scope,
    traced::Traced,
};
use bench_plan::{procedure, support::confined_path::plain};
use instruments::clock;

/// A run to submit.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Submit {
    /// Name of an experiment of this server. Left out if `text` is given.
    experiment: Option<String>,
    /// A complete experiment file (TOML), as if it were among those of this server.
    text: Option<String>,
    /// A bench instead of the one that the experiment names.
    bench: Option<String>,
    /// A seed instead of that of the experiment.
    seed: Option<u64>,
    /// Name that the run gets, for a token with the scope `fleet`. If a run of this name was
    /// submitted before, nothing is submitted, and the answer is that run, with status 200.
    run: Option<String>,
}

/// Queue numbers in the requested order.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Order {
    /// These come first; the others follow in their previous order.
    ids: Vec<u64>,
}

/// Reason for a hold.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Why {
    /// Reason as text. Optional.
    #[serde(default)]
    why: Option<String>,
}

/// An experiment that can be submitted.
#[derive(Debug, Serialize, ToSchema)]
pub struct Offered {
    /// Its name.
    experiment: String,
}

/// Plan of an experiment.
#[derive(Debug, Serialize, ToSchema)]
pub struct Planned {
    /// Name of the experiment.
    experiment: String,
    /// Name of the bench.
    bench: String,
    /// Expected duration, bench s.
    expected_s: f64,
    /// Longest possible duration, bench s.
    longest_s: f64,
    /// Charge into the cell by direct currents over the expected times, C.
    #[serde(rename = "charge_c")]
    charge_coulomb: f64,
    /// Charge out of the cell by direct currents over the expected times, C.
    #[serde(rename = "discharge_c")]
    discharge_coulomb: f64,
    /// Its stages.
    stages: Vec<PlannedStage>,
}

/// A stage of a plan.
#[derive(Debug, Serialize, ToSchema)]
pub struct PlannedStage {
    /// Purpose of the stage.
    purpose: String,
    /// Its steps, as text.
    steps: Vec<String>,
    /// Expected duration, bench s.
    expected_s: f64,
}

impl Planned {
    /// The plan of a submission.
    pub(super) fn of(submission: &Submission) -> Self {
        let plan = procedure::plan(&submission.experiment);
        let extent = plan.extent();
        let stages = plan.stages.iter().map(|stage| PlannedStage {
            purpose: stage.purpose.to_string(),
            steps: stage.steps.iter().map(ToString::to_string).collect(),
            expected_s: stage
                .steps
                .iter()
                .map(|step| step.expected_s().value())
                .sum(),
        });
        Self {
            experiment: submission.experiment.name.clone(),
            bench: submission.experiment.bench.name.clone(),
            expected_s: submission.expected_s,
            longest_s: submission.longest_s,
            charge_coulomb: extent.into_coulomb.0,
            discharge_coulomb: extent.out_coulomb.0,
            stages: stages.collect(),
        }
    }
}

/// Selects a bench.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct On {
    /// A bench instead of the one that the experiment names.
    bench: Option<String>,
}

impl From<QueueError> for Refusal {
    fn from(error: QueueError) -> Self {
        match error {
            QueueError::Unknown(_) => Self::of(StatusCode::NOT_FOUND, error.to_string()),
            QueueError::InWork(_) | QueueError::Full => Self::conflict(error.to_string()),
            QueueError::Twice(_) => Self::of(StatusCode::UNPROCESSABLE_ENTITY, error.to_string()),
            QueueError::Io { .. } => Self::machine(&error),
        }
    }
}

impl From<Refused> for Refusal {
    fn from(refused: Refused) -> Self {
        match refused {
            Refused::Unknown(_) => Self::of(StatusCode::NOT_FOUND, refused.to_string()),
            Refused::Unfit(_) | Refused::Mistake(_) => {
                Self::of(StatusCode::UNPROCESSABLE_ENTITY, refused.to_string())
            }
            Refused::Kept(_) => Self::machine(&refused),
        }
    }
}

/// Returns the running and waiting runs.
#[utoipa::path(
    get,
    path = "/api/v1/queue",
    tag = "queue",
    responses((status = 200, body = QueueNow)),
    security(("token" = ["read"]))
)]
pub async fn list(_caller: Reader, State(app): State<App>) -> Json<QueueNow> {
    Json(QueueNow::of(&app.server))
}

/// Returns the experiments that can be submitted by name.
#[utoipa::path(
    get,
    path = "/api/v1/experiments",
    tag = "queue",
    responses((status = 200, body = [Offered])),
    security(("token" = ["read"]))
)]
pub async fn experiments(_caller: Reader, State(app): State<App>) -> Json<Vec<Offered>> {
    let all = shelf::list(&app.server.settings, shelf::FileKind::Experiments);
    let offered = |file: shelf::Listed| Offered {
        experiment: file.name,
    };
    Json(all.into_iter().map(offered).collect())
}

/// Returns the plan of an experiment, step by step. Changes nothing.
#[utoipa::path(
    get,
    path = "/api/v1/experiments/{experiment}/plan",
    tag = "queue",
    params(("experiment" = String, Path), On),
    responses((status = 200, body = Planned)),
    security(("token" = ["read"]))
)]
pub async fn plan(
    _caller: Reader,
    State(app): State<App>,
    Path(name): Path<String>,
    Query(on): Query<On>,
) -> Result<Json<Planned>, Refusal> {
    aside(move || {
        let submission = Submission::new(
            &app.server.settings,
            ExperimentRequest {
                name: &name,
                text: None,
                bench: on.bench.as_deref(),
            },
        )?;
        Ok(Json(Planned::of(&submission)))
    })
    .await
}

/// Checks an experiment and appends it to the queue. It starts automatically when its bench is
/// free: that lets current flow.
#[utoipa::path(
    post,
    path = "/api/v1/queue",
    tag = "queue",
    request_body = Submit,
    responses((status = 201, body = Item), (status = 200, body = Item)),
    security(("token" = ["energise"]))
)]
pub async fn submit(
    caller: Energiser,
    State(app): State<App>,
    traced: Traced,
    Json(submit): Json<Submit>,
) -> Result<(StatusCode, Json<Item>), Refusal> {
    let wanted_run = wanted_run(&caller, submit.run.as_deref())?;
    aside(move || {
        let server = &app.server;
        // Two requests for one run are answered one after the other.
        let _one = wanted_run.as_ref().map(|_| server.shelf());
        let known = |queue: &Queue| {
            let run = wanted_run.as_deref()?;
            jobs::submitted(&server.settings.data, queue, run)
        };
        if let Some(item) = known(&server.queue()) {
            return Ok((StatusCode::OK, Json(item)));
        }
        let (name, text) = match (&submit.experiment, &submit.text) {
            (Some(name), None) => (name.as_str(), None),
            (None, Some(text)) => ("submitted", Some(text.as_str())),
            _ => {
                return Err(Refusal::of(
                    StatusCode::UNPROCESSABLE_ENTITY,
                    "expected either `experiment` or `text`",
                ));
            }
        };
        let submission = Submission::new(
            &server.settings,
            ExperimentRequest {
                name,
                text,
                bench: submit.bench.as_deref(),
            },
        )?;
        let experiment = &submission.experiment;
        let wanted = Wanted {
            kind: Kind::Run,
            experiment: experiment.name.clone(),
            bench: experiment.bench.name.clone(),
            seed: submit.seed,
            expected_s: submission.expected_s,
            by: caller.name,
            unix_s: clock::unix_time_s(),
            traceparent: traced.0,
        };
        // The files of the run are written before the queue names it.
        let mut queue = server.queue();
        let own_run = || format!("{}-{}", experiment.name, queue.next_id());
        let run = wanted_run.clone().unwrap_or_else(own_run);
        submission.freeze(&server.settings.data.join("submitted").join(&run))?;
        let item = queue.submit(&wanted, |_| run)?;
        drop(queue);
        server.tell_queue();
        Ok((StatusCode::CREATED, Json(item)))
    })
    .await
}

/// Returns the name that a run must get. Only an agent of a fleet may choose one.
fn wanted_run(caller: &Energiser, run: Option<&str>) -> Result<Option<String>, Refusal> {
    let Some(run) = run else { return Ok(None) };
    if !caller.scopes.contains(&Scope::Fleet) {
        let message = "run: expected from a token with the scope `fleet` only";
        return Err(Refusal::of(StatusCode::FORBIDDEN, message));
    }
    if !plain(run) {
        let message =
            format!("run: expected a name of letters, digits, `-` and `_`, found {run:?}");
        return Err(Refusal::unfit(message));
    }
    Ok(Some(run.to_owned()))
}

/// Removes a waiting entry from the queue.
#[utoipa::path(
    delete,
    path = "/api/v1/queue/{id}",
    tag = "queue",
    params(("id" = u64, Path)),
    responses((status = 200, body = Item)),
    security(("token" = ["operate"]))
)]
pub async fn cancel(
    _caller: Operator,
    State(app): State<App>,
    Path(id): Path<u64>,
) -> Result<Json<Item>, Refusal> {
    let item = app.server.queue().cancel(id)?;
    app.server.tell_queue();
    Ok(Json(item))
}

/// Moves entries to the front of the queue.
#[utoipa::path(
    post,
    path = "/api/v1/queue/order",
    tag = "queue",
    request_body = Order,
    responses((status = 200, body = QueueNow)),
    security(("token" = ["operate"]))
)]
pub async fn reorder(
    _caller: Operator,
    State(app): State<App>,
    Json(order): Json<Order>,
) -> Result<Json<QueueNow>, Refusal> {
    app.server.queue().reorder(&order.ids)?;
    app.server.tell_queue();
    Ok(Json(QueueNow::of(&app.server)))
}

/// Holds a bench: no run starts on it from now on; a run in progress continues.
#[utoipa::path(
    post,
    path = "/api/v1/benches/{bench}/hold",
    tag = "queue",
    params(("bench" = String, Path)),
    request_body = Option<Why>,
    responses((status = 200, body = QueueNow)),
    security(("token" = ["operate"]))
)]
pub async fn hold(
    caller: Operator,
    State(app): State<App>,
    Path(bench): Path<String>,
    why: Option<Json<Why>>,
) -> Result<Json<QueueNow>, Refusal> {
    known(&app, &bench)?;
    let why = why
        .and_then(|why| why.0.why)
        .unwrap_or_else(|| "held by hand".to_owned());
    let why: String = why.chars().filter(|c| !c.is_control()).take(200).collect();
    app.server
        .queue()
        .hold(caller.side, &bench, &format!("{why} ({})", caller.name))?;
    app.server.tell_queue();
    Ok(Json(QueueNow::of(&app.server)))
}

/// Releases the queue of a bench, so that waiting runs may start: that lets current flow. The name
/// of the caller and the reason are stored with the bench.
#[utoipa::path(
    post,
    path = "/api/v1/benches/{bench}/release",
    tag = "queue",
    params(("bench" = String, Path)),
    request_body = Option<Why>,
    responses((status = 200, body = QueueNow)),
    security(("token" = ["energise"]))
)]
pub async fn release(
    caller: Energiser,
    State(app): State<App>,
    Path(bench): Path<String>,
    why: Option<Json<Why>>,
) -> Result<Json<QueueNow>, Refusal> {
    known(&app, &bench)?;
    let why = why.and_then(|why| why.0.why).unwrap_or_default();
    let why: String = why.chars().filter(|c| !c.is_control()).take(200).collect();
    aside(move || {
        let (by, held) = {
            let queue = app.server.queue();
            // A person here revokes the hold that is shown; a hold of the fleet then becomes
            // visible. The fleet revokes its own hold only.
            let by = match caller.side {
                HeldBy::Here => queue.holder(&bench),
                HeldBy::Fleet => HeldBy::Fleet,
            };
            (by, queue.held_by(by, &bench).map(str::to_owned))
        };
        if caller.side == HeldBy::Fleet && held.is_none() {
            return Ok(Json(QueueNow::of(&app.server)));
        }
        let text = format!(
            "released: {}; it was held: {}",
            said(&why),
            said(&held.unwrap_or_default())
        );
        let kept = app
            .server
            .notebook
            .note(About::Bench(&bench), &caller.name, &text);
        kept.map_err(|error| Refusal::machine(&error))?;
        app.server.queue().release(by, &bench)?;
        app.server.tell_queue();
        Ok(Json(QueueNow::of(&app.server)))
    })
    .await
}

/// Returns the text, or a placeholder for an empty one.
fn said(words: &str) -> &str {
    if words.trim().is_empty() {
        "no reason given"
    } else {
        words
    }
}

/// Returns the notes about a bench, such as releases of its queue with their reasons; the latest
/// last.
#[utoipa::path(
    get,
    path = "/api/v1/benches/{bench}/notes",
    tag = "queue",
    params(("bench" = String, Path)),
    responses((status = 200, body = [Note])),
    security(("token" = ["read"]))
)]
pub async fn notes(
    _caller: Reader,
    State(app): State<App>,
    Path(bench): Path<String>,
) -> Result<Json<Vec<Note>>, Refusal> {
    known(&app, &bench)?;
    aside(move || Ok(Json(app.server.notebook.read(About::Bench(&bench)).notes))).await
}
