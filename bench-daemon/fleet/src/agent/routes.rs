//! Routes of the fleet: benches of all sites, their jobs, and orders to them.

use axum::{
    Json,
    extract::{Path, Query, State},
    http::{HeaderMap, StatusCode},
};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    app::App,
    caller::{Energiser, Known, Reader, Whoami},
    forward::experiment_text,
    refusal::Refusal,
};
use crate::{
    api::{FleetJobs, FleetNeeds, FleetNow, FleetOutcome, name_of},
    client::{Command, Submission},
    job::Place,
    standing::OrderKind,
    view::{FleetView, JobFilter, JobView, MOST_JOBS},
};

/// Default number of jobs on one page.
const PAGE: usize = 100;

/// Conditions on jobs; all of them must hold.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct FleetJobsWanted {
    /// In this state: `queued`, `claimed`, `started`, `lost`, `done`, `failed` or `cancelled`.
    state: Option<String>,
    /// Of this campaign.
    campaign: Option<String>,
    /// Begin after this job: `after` of the previous answer.
    after: Option<String>,
    /// Maximum number of jobs. Left out: 100.
    #[param(minimum = 1, maximum = 1000)]
    most: Option<u16>,
}

/// Work for the fleet.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct SubmitJobs {
    /// Name of an experiment of the server beside the agent; left out if `text` is given.
    experiment: Option<String>,
    /// An experiment file in full (TOML). Files that it names are those of the bench that takes it.
    text: Option<String>,
    /// Requirements on the bench.
    #[serde(default)]
    needs: FleetNeeds,
    /// Number of jobs, 1 to 10 000. Left out: 1.
    count: Option<usize>,
    /// Label of a campaign.
    campaign: Option<String>,
    /// Label of the cell.
    cell: Option<String>,
    /// Another seed for the first job; each further job has the next one.
    seed: Option<u64>,
}

/// Jobs that were submitted.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct SubmittedJobs {
    /// Their names.
    jobs: Vec<String>,
}

/// A campaign.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct FleetCampaign {
    /// Its label.
    campaign: String,
}

/// Jobs that were cancelled.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct CancelledJobs {
    /// Their number.
    cancelled: usize,
}

/// Reason of an order.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct FleetWhy {
    /// In words; may be left out.
    #[serde(default)]
    why: Option<String>,
}

/// Who the token belongs to, as the server of the benches has it. Every token may ask.
#[utoipa::path(
    get,
    path = "/api/v1/whoami",
    tag = "access",
    responses((status = 200, body = Whoami)),
    security(("token" = []))
)]
pub(crate) async fn whoami(caller: Known) -> Json<Whoami> {
    Json(caller.known)
}

/// The fleet as it is now: its benches and numbers of jobs.
#[utoipa::path(
    get,
    path = "/api/v1/fleet",
    tag = "fleet",
    responses((status = 200, body = FleetNow)),
    security(("token" = ["read"]))
)]
pub(crate) async fn now(
    _caller: Reader,
    State(app): State<App>,
) -> Result<Json<FleetNow>, Refusal> {
    let fleet = app.fleet()?;
    let settings = fleet.settings();
    let view = match fleet.seer().await {
        Ok(seer) => seer.view(),
        Err(error) if fleet.is_connected() => return Err(error.into()),
        // Without the NATS server, the state is unknown, and the reply states this.
        Err(_) => FleetView::unseen(&settings.fleet),
    };
    Ok(Json(FleetNow::of(view, settings.server.clone())))
}

/// Jobs of the fleet, in the order of the queue.
#[utoipa::path(
    get,
    path = "/api/v1/fleet/jobs",
    tag = "fleet",
    params(FleetJobsWanted),
    responses((status = 200, body = FleetJobs)),
    security(("token" = ["read"]))
)]
pub(crate) async fn jobs(
    _caller: Reader,
    State(app): State<App>,
    Query(wanted): Query<FleetJobsWanted>,
) -> Result<Json<FleetJobs>, Refusal> {
    let most = wanted.most.map_or(PAGE, usize::from);
    if !(1..=MOST_JOBS).contains(&most) {
        let message = format!("most: expected 1 to {MOST_JOBS}, found {most}");
        return Err(Refusal::of(StatusCode::BAD_REQUEST, message));
    }
    if let Some(state) = wanted
        .state
        .as_deref()
        .filter(|state| !JobView::STATES.contains(state))
    {
        let states = JobView::STATES.join(", ");
        let message = format!("state: expected one of {states}, found {state:?}");
        return Err(Refusal::of(StatusCode::BAD_REQUEST, message));
    }
    let page = app.fleet()?.seer().await?.jobs(&JobFilter {
        state: wanted.state,
        open: false,
        campaign: wanted.campaign,
        after: wanted.after,
        most,
    });
    Ok(Json(page.into()))
}

/// Puts jobs into the queue of the fleet. The first free bench that fits takes each job, and checks it
/// like any submission to its server: that lets current flow.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/jobs",
    tag = "fleet",
    request_body = SubmitJobs,
    responses((status = 201, body = SubmittedJobs)),
    security(("token" = ["energise"]))
)]
pub(crate) async fn submit(
    caller: Energiser,
    State(app): State<App>,
    headers: HeaderMap,
    Json(wanted): Json<SubmitJobs>,
) -> Result<(StatusCode, Json<SubmittedJobs>), Refusal> {
    let client = app.client()?;
    let text = match (&wanted.experiment, wanted.text) {
        (Some(name), None) => experiment_text(&app, &headers, name).await?,
        (None, Some(text)) => text,
        _ => return Err(Refusal::unfit("expected either `experiment` or `text`")),
    };
    let submission = Submission {
        name: name_of(&text).map_err(Refusal::unfit)?,
        text,
        needs: wanted.needs.into(),
        count: wanted.count.unwrap_or(1),
        seed: wanted.seed,
        campaign: wanted.campaign,
        cell: wanted.cell,
        by: app.by(&caller.name),
    };
    let jobs = client.submit(&submission).await?;
    Ok((StatusCode::CREATED, Json(SubmittedJobs { jobs })))
}

/// Removes a waiting job from the queue.
#[utoipa::path(
    delete,
    path = "/api/v1/fleet/jobs/{job}",
    tag = "fleet",
    params(("job" = String, Path)),
    responses((status = 204)),
    security(("token" = ["energise"]))
)]
pub(crate) async fn cancel(
    caller: Energiser,
    State(app): State<App>,
    Path(job): Path<String>,
) -> Result<StatusCode, Refusal> {
    app.client()?.cancel(&job, &app.by(&caller.name)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Removes every waiting job of a campaign from the queue.
#[utoipa::path(
    delete,
    path = "/api/v1/fleet/jobs",
    tag = "fleet",
    params(FleetCampaign),
    responses((status = 200, body = CancelledJobs)),
    security(("token" = ["energise"]))
)]
pub(crate) async fn cancel_campaign(
    caller: Energiser,
    State(app): State<App>,
    Query(wanted): Query<FleetCampaign>,
) -> Result<Json<CancelledJobs>, Refusal> {
    let (client, by) = (app.client()?, app.by(&caller.name));
    let cancelled = client.cancel_campaign(&wanted.campaign, &by).await?;
    Ok(Json(CancelledJobs { cancelled }))
}

/// Puts a started job whose bench is gone back into the queue: a person decides that it may run again.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/jobs/{job}/release",
    tag = "fleet",
    params(("job" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 204)),
    security(("token" = ["energise"]))
)]
pub(crate) async fn release_job(
    caller: Energiser,
    State(app): State<App>,
    Path(job): Path<String>,
    why: Option<Json<FleetWhy>>,
) -> Result<StatusCode, Refusal> {
    let (by, why) = (app.by(&caller.name), reason(why));
    app.client()?.release_job(&job, &by, &why).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Returns the reason in a request.
pub(crate) fn reason(why: Option<Json<FleetWhy>>) -> String {
    let why = why.and_then(|why| why.0.why).unwrap_or_default();
    let plain: String = why.chars().filter(|c| !c.is_control()).take(200).collect();
    match plain.trim() {
        "" => "no reason given".to_owned(),
        given => given.to_owned(),
    }
}

/// Returns the order of a caller.
pub(crate) fn command(
    app: &App,
    kind: OrderKind,
    who: &str,
    why: Option<Json<FleetWhy>>,
) -> Command {
    Command {
        kind,
        by: app.by(who),
        why: reason(why),
    }
}

/// Gives an order to a bench through the NATS server.
pub(crate) async fn order(
    app: &App,
    place: &Place,
    command: Command,
) -> Result<Json<FleetOutcome>, Refusal> {
    let outcome = app.client()?.order(place, &command).await?;
    Ok(Json(outcome.into()))
}

/// Holds a bench of the fleet: no further run begins, and an active run continues.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/benches/{site}/{bench}/hold",
    tag = "fleet",
    params(("site" = String, Path), ("bench" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetOutcome)),
    security(("token" = ["energise"]))
)]
pub(crate) async fn hold(
    caller: Energiser,
    State(app): State<App>,
    Path(place): Path<Place>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetOutcome>, Refusal> {
    let command = command(&app, OrderKind::Hold, &caller.name, why);
    order(&app, &place, command).await
}

/// Revokes a hold, a drain and a stop of the fleet. A hold by the bench's own server and a latch
/// stay.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/benches/{site}/{bench}/release",
    tag = "fleet",
    params(("site" = String, Path), ("bench" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetOutcome)),
    security(("token" = ["energise"]))
)]
pub(crate) async fn release(
    caller: Energiser,
    State(app): State<App>,
    Path(place): Path<Place>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetOutcome>, Refusal> {
    let command = command(&app, OrderKind::Release, &caller.name, why);
    order(&app, &place, command).await
}

/// Lets a bench take no further job of the fleet; its jobs continue.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/benches/{site}/{bench}/drain",
    tag = "fleet",
    params(("site" = String, Path), ("bench" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetOutcome)),
    security(("token" = ["energise"]))
)]
pub(crate) async fn drain(
    caller: Energiser,
    State(app): State<App>,
    Path(place): Path<Place>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetOutcome>, Refusal> {
    let command = command(&app, OrderKind::Drain, &caller.name, why);
    order(&app, &place, command).await
}
