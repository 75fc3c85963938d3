//! Routes of the fleet: benches of all sites, their jobs, and orders to them.

use std::sync::Arc;

use axum::{
    Json,
    extract::{Path, Query, State},
    http::StatusCode,
};
use bench_fleet::{
    Client, Fleet, FleetError, FleetView, Place, Submission,
    client::{Command, Outcome},
    standing::{OrderKind, through_the_fleet},
    view::{JobFilter, JobView, MOST_JOBS},
};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::{
    App,
    caller::{Energiser, Known, Reader},
    problem::Refusal,
};
use crate::serve::{
    fleet_told::{FleetJobs, FleetNeeds, FleetNow, FleetOutcome},
    live::StopReport,
    queue::HeldBy,
    stop::{self, Stopper},
    submission::{name_of, text_of},
};

/// Default number of jobs on one page.
const PAGE: usize = 100;

/// Conditions on jobs; all of them must hold.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FleetJobsWanted {
    /// In this state: `queued`, `claimed`, `started`, `lost`, `done`, `failed` or `cancelled`.
    state: Option<String>,
    /// Of this campaign.
    campaign: Option<String>,
    /// Where to go on: `after` of the answer before.
    after: Option<String>,
    /// At most so many.
    #[param(minimum = 1, maximum = 1000)]
    most: Option<u16>,
}

/// Work for the fleet.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SubmitJobs {
    /// Name of an experiment of this server; left out where `text` is there.
    experiment: Option<String>,
    /// An experiment file in full (TOML). Files that it names are those of the bench that takes it.
    text: Option<String>,
    /// Requirements on the bench.
    #[serde(default)]
    needs: FleetNeeds,
    /// So many jobs, 1 to 10 000. Left out: 1.
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
pub struct SubmittedJobs {
    /// Their names.
    jobs: Vec<String>,
}

/// A campaign.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FleetCampaign {
    /// Its label.
    campaign: String,
}

/// Jobs that were cancelled.
#[derive(Debug, Serialize, ToSchema)]
pub struct CancelledJobs {
    /// Their number.
    cancelled: usize,
}

/// Why, in words.
#[derive(Debug, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FleetWhy {
    /// In words; may be left out.
    #[serde(default)]
    why: Option<String>,
}

/// Result of a stop of all benches.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetStopped {
    /// Each bench.
    benches: Vec<FleetOutcome>,
    /// Why further benches may not have been reached; null where all are told above.
    unreached: Option<String>,
}

impl From<FleetError> for Refusal {
    fn from(error: FleetError) -> Self {
        let status = match error {
            FleetError::Unknown { .. } => StatusCode::NOT_FOUND,
            FleetError::Conflict(_) => StatusCode::CONFLICT,
            FleetError::Unfit(_) => StatusCode::UNPROCESSABLE_ENTITY,
            FleetError::Unreachable(_) => StatusCode::SERVICE_UNAVAILABLE,
            _ => return Self::machine(&error),
        };
        Self::of(status, error.to_string())
    }
}

fn fleet(app: &App) -> Result<&Arc<Fleet>, Refusal> {
    app.server.fleet.get().ok_or_else(|| {
        let message = "expected a section [fleet] in the file of the server, found none";
        Refusal::new(StatusCode::NOT_FOUND, "no-fleet", message)
    })
}

fn client(app: &App) -> Result<Client, Refusal> {
    Ok(fleet(app)?.client()?)
}

/// Returns the caller's name as other sites show it.
fn by(app: &App, name: &str) -> String {
    let section = app.server.settings.fleet.as_ref();
    format!("{name}@{}", section.map_or("", |section| &section.site))
}

/// The fleet as it is now: its benches and numbers of jobs.
#[utoipa::path(
    get,
    path = "/api/v1/fleet",
    tag = "fleet",
    responses((status = 200, body = FleetNow)),
    security(("token" = ["read"]))
)]
pub async fn now(_caller: Reader, State(app): State<App>) -> Result<Json<FleetNow>, Refusal> {
    let fleet = fleet(&app)?;
    let settings = fleet.settings();
    let view = match fleet.seer().await {
        Ok(seer) => seer.view(),
        Err(error) if fleet.is_connected() => return Err(error.into()),
        // Without the NATS server no state is known, and the reply says so.
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
pub async fn jobs(
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
    let page = fleet(&app)?.seer().await?.jobs(&JobFilter {
        state: wanted.state,
        open: false,
        campaign: wanted.campaign,
        after: wanted.after,
        most,
    });
    Ok(Json(page.into()))
}

/// Puts jobs into the queue of the fleet. The first bench that is free and fits takes each, and checks
/// it as whatever is submitted there: that lets current flow.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/jobs",
    tag = "fleet",
    request_body = SubmitJobs,
    responses((status = 201, body = SubmittedJobs)),
    security(("token" = ["energise"]))
)]
pub async fn submit(
    caller: Energiser,
    State(app): State<App>,
    Json(wanted): Json<SubmitJobs>,
) -> Result<(StatusCode, Json<SubmittedJobs>), Refusal> {
    let client = client(&app)?;
    let text = match (&wanted.experiment, wanted.text) {
        (Some(name), None) => text_of(&app.server.settings, name)?,
        (None, Some(text)) => text,
        _ => return Err(Refusal::unfit("expected either `experiment` or `text`")),
    };
    let submission = Submission {
        name: name_of(&text)?,
        text,
        needs: wanted.needs.into(),
        count: wanted.count.unwrap_or(1),
        seed: wanted.seed,
        campaign: wanted.campaign,
        cell: wanted.cell,
        by: by(&app, &caller.name),
    };
    let jobs = client.submit(&submission).await?;
    Ok((StatusCode::CREATED, Json(SubmittedJobs { jobs })))
}

/// Takes a job that waits out of the queue.
#[utoipa::path(
    delete,
    path = "/api/v1/fleet/jobs/{job}",
    tag = "fleet",
    params(("job" = String, Path)),
    responses((status = 204)),
    security(("token" = ["energise"]))
)]
pub async fn cancel(
    caller: Energiser,
    State(app): State<App>,
    Path(job): Path<String>,
) -> Result<StatusCode, Refusal> {
    let by = by(&app, &caller.name);
    client(&app)?.cancel(&job, &by).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Takes every job of a campaign that waits out of the queue.
#[utoipa::path(
    delete,
    path = "/api/v1/fleet/jobs",
    tag = "fleet",
    params(FleetCampaign),
    responses((status = 200, body = CancelledJobs)),
    security(("token" = ["energise"]))
)]
pub async fn cancel_campaign(
    caller: Energiser,
    State(app): State<App>,
    Query(wanted): Query<FleetCampaign>,
) -> Result<Json<CancelledJobs>, Refusal> {
    let by = by(&app, &caller.name);
    let client = client(&app)?;
    let cancelled = client.cancel_campaign(&wanted.campaign, &by).await?;
    Ok(Json(CancelledJobs { cancelled }))
}

/// Puts a started job whose bench is gone back into the queue: a person says that it may run again.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/jobs/{job}/release",
    tag = "fleet",
    params(("job" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 204)),
    security(("token" = ["energise"]))
)]
pub async fn release_job(
    caller: Energiser,
    State(app): State<App>,
    Path(job): Path<String>,
    why: Option<Json<FleetWhy>>,
) -> Result<StatusCode, Refusal> {
    let (by, why) = (by(&app, &caller.name), said(why));
    client(&app)?.release_job(&job, &by, &why).await?;
    Ok(StatusCode::NO_CONTENT)
}

fn said(why: Option<Json<FleetWhy>>) -> String {
    let why = why.and_then(|why| why.0.why).unwrap_or_default();
    let plain: String = why.chars().filter(|c| !c.is_control()).take(200).collect();
    match plain.trim() {
        "" => "no reason given".to_owned(),
        said => said.to_owned(),
    }
}

/// Order of a caller.
fn command(app: &App, kind: OrderKind, who: &str, why: Option<Json<FleetWhy>>) -> Command {
    Command {
        kind,
        by: by(app, who),
        why: said(why),
    }
}

async fn order(app: &App, place: &Place, command: Command) -> Result<Json<FleetOutcome>, Refusal> {
    let outcome = client(app)?.order(place, &command).await?;
    Ok(Json(outcome.into()))
}

/// From now on nothing begins on a bench of the fleet; what is in work goes on.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/benches/{site}/{bench}/hold",
    tag = "fleet",
    params(("site" = String, Path), ("bench" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetOutcome)),
    security(("token" = ["energise"]))
)]
pub async fn hold(
    caller: Energiser,
    State(app): State<App>,
    Path(place): Path<Place>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetOutcome>, Refusal> {
    let command = command(&app, OrderKind::Hold, &caller.name, why);
    order(&app, &place, command).await
}

/// Takes back what the fleet has held, drained or stopped. A hold by the bench's own server and a
/// latch stay.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/benches/{site}/{bench}/release",
    tag = "fleet",
    params(("site" = String, Path), ("bench" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetOutcome)),
    security(("token" = ["energise"]))
)]
pub async fn release(
    caller: Energiser,
    State(app): State<App>,
    Path(place): Path<Place>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetOutcome>, Refusal> {
    let command = command(&app, OrderKind::Release, &caller.name, why);
    order(&app, &place, command).await
}

/// A bench takes no further job of the fleet; what it has goes on.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/benches/{site}/{bench}/drain",
    tag = "fleet",
    params(("site" = String, Path), ("bench" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetOutcome)),
    security(("token" = ["energise"]))
)]
pub async fn drain(
    caller: Energiser,
    State(app): State<App>,
    Path(place): Path<Place>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetOutcome>, Refusal> {
    let command = command(&app, OrderKind::Drain, &caller.name, why);
    order(&app, &place, command).await
}

/// Stops whatever runs on a bench of the fleet and reads every output back, by the bench's own server.
/// A bench of this server is stopped without the NATS server.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/benches/{site}/{bench}/stop",
    tag = "fleet",
    params(("site" = String, Path), ("bench" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetOutcome)),
    security(("token" = []))
)]
pub async fn stop(
    caller: Known,
    State(app): State<App>,
    Path(place): Path<Place>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetOutcome>, Refusal> {
    fleet(&app)?;
    let who = caller.name;
    // A peer that goes away does not end it.
    let work = tokio::spawn(async move {
        let own = own_stop(&app, &place, &who);
        let command = command(&app, OrderKind::Stop, &who, why);
        let through = order(&app, &place, command);
        match tokio::join!(own, through) {
            (Some(report), through) => {
                let through = through.ok().map(|through| through.0);
                hold_here(&app, &report, through.as_ref());
                Ok(Json(of_own(&place, &report, through.as_ref())))
            }
            (None, through) => through,
        }
    });
    work.await.map_err(|error| Refusal::machine(&error))?
}

/// Stops a bench of this server; returns `None` for a bench of another server.
async fn own_stop(app: &App, place: &Place, who: &str) -> Option<StopReport> {
    let section = app.server.settings.fleet.as_ref()?;
    let bench = app.server.settings.bench(&place.bench)?;
    if section.site != place.site {
        return None;
    }
    // Uses the fleet's name of the user, so that a release by the fleet lifts the hold.
    let by = through_the_fleet(&by(app, who));
    Some(stop::stop(&app.server, bench, Stopper::fleet(&by)).await)
}

/// A stop that the NATS server does not keep is this server's own: an older release of the fleet that is
/// heard later must not take it back.
fn hold_here(app: &App, report: &StopReport, through: Option<&FleetOutcome>) {
    if through.is_none_or(|through| !through.kept) {
        stop::hold(&app.server, HeldBy::Here, report);
    }
}

fn of_own(place: &Place, report: &StopReport, through: Option<&FleetOutcome>) -> FleetOutcome {
    let kept = through.is_some_and(|through| through.kept);
    FleetOutcome {
        site: place.site.clone(),
        bench: place.bench.clone(),
        kept,
        heard: true,
        held: Some(report.held()),
        outputs_verified: Some(report.proven()),
        words: "stopped by this server".to_owned(),
        report: serde_json::to_value(report).ok(),
    }
}

/// Stops every bench of the fleet at once. Answers when all have answered, or 2 min have passed.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/stop",
    tag = "fleet",
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetStopped)),
    security(("token" = []))
)]
pub async fn stop_all(
    caller: Known,
    State(app): State<App>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetStopped>, Refusal> {
    fleet(&app)?;
    let work = tokio::spawn(async move { stopped(&app, &caller.name, &said(why)).await });
    let stopped = work.await.map_err(|error| Refusal::machine(&error))?;
    Ok(Json(stopped))
}

/// Sends stops through the NATS server. Returns their replies, and why further benches may not
/// have been reached. If NATS does not list its benches, the benches seen earlier are asked.
async fn stopped_through(
    app: &App,
    who: &str,
    why: &str,
) -> Result<(Vec<Outcome>, Option<String>), Refusal> {
    let (client, by) = (client(app)?, by(app, who));
    match client.stop_all(&by, why).await {
        Ok(outcomes) => Ok((outcomes, None)),
        Err(error) => {
            let seer = fleet(app)?.seer().await;
            let seen = seer.map(|seer| seer.places()).unwrap_or_default();
            let outcomes = client.stop_these(&seen, &by, why).await?;
            Ok((outcomes, Some(error.to_string())))
        }
    }
}

async fn stopped(app: &App, who: &str, why: &str) -> FleetStopped {
    let settings = &app.server.settings;
    let site = settings.fleet.as_ref().map_or("", |section| &section.site);
    let benches = settings.benches.iter();
    let places: Vec<Place> = benches.map(|bench| Place::new(site, &bench.name)).collect();
    let own = futures_util::future::join_all(places.iter().map(|place| own_stop(app, place, who)));
    let (own, through) = tokio::join!(own, stopped_through(app, who, why));
    let (others, unreached) = match through {
        Ok(told) => told,
        Err(Refusal(_, problem)) => (Vec::new(), Some(problem.message)),
    };
    let mut all: Vec<FleetOutcome> = others.into_iter().map(Into::into).collect();
    for (place, report) in places.iter().zip(own.iter().flatten()) {
        let same = |one: &FleetOutcome| one.site == place.site && one.bench == place.bench;
        let through = all.iter().position(same).map(|index| all.remove(index));
        hold_here(app, report, through.as_ref());
        all.push(of_own(place, report, through.as_ref()));
    }
    FleetStopped {
        benches: all,
        unreached,
    }
}
