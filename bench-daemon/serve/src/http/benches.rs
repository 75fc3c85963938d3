//! Routes of benches: present state, instruments, trips, and the stop.

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
    caller::{Agent, Clearer, Known, Operator, Reader, Stopping},
};
use crate::{
    audit::{By, Deed},
    capabilities::Capabilities,
    live::{Live, StopReport, TripNow},
    stop::{self, Stopper},
    token::Scope,
};
use bench_core::safety::state;
use bench_plan::config;

/// Identity of the caller.
#[derive(Debug, Serialize, ToSchema)]
pub struct Caller {
    /// Name of the token; `local` if none is required.
    name: String,
    /// Scopes of its token.
    scopes: Vec<Scope>,
    /// The benches that every holder of a token may stop.
    benches: Vec<String>,
}

/// A bench as it is now.
#[derive(Debug, Serialize, ToSchema)]
pub struct BenchNow {
    #[serde(flatten)]
    pub(super) live: Live,
    /// Properties that follow from its file.
    capabilities: Capabilities,
}

impl BenchNow {
    fn of(app: &App, bench: &config::Bench) -> Option<Self> {
        let live = app.server.live().get(&bench.name).cloned()?;
        let capabilities = Capabilities::of(bench);
        Some(Self { live, capabilities })
    }
}

/// Something that an agent of a fleet did for a person.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct AgentDeed {
    /// What it did.
    what: String,
    /// Result of it.
    outcome: String,
}

/// Longest text of a deed of an agent that is kept, characters.
const LONGEST_DEED: usize = 500;

/// Confirms that a person has looked.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Confirm {
    /// The current cause, verbatim. A different cause is refused, so that only a cause that was
    /// seen can be cleared.
    cause: String,
    /// Who looked, what they found and what they did, at most 1000 characters; stored with the
    /// trip.
    #[serde(default)]
    found: Option<String>,
}

/// Longest text of what was found, characters.
const LONGEST_FOUND: usize = 1000;

/// Length of the answer.
#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub struct Most {
    /// Maximum number of entries, the latest ones.
    #[param(minimum = 1, maximum = 10_000)]
    most: Option<u16>,
}

impl Most {
    /// Within its bounds.
    pub fn or(&self, other: usize) -> Result<usize, Refusal> {
        match self.most {
            None => Ok(other),
            Some(most) if (1..=10_000).contains(&most) => Ok(usize::from(most)),
            Some(most) => Err(Refusal::of(
                StatusCode::BAD_REQUEST,
                format!("most: expected 1 to 10000, found {most}"),
            )),
        }
    }
}

/// One bench of the server.
pub fn known<'a>(app: &'a App, name: &str) -> Result<&'a config::Bench, Refusal> {
    app.server
        .settings
        .bench(name)
        .ok_or_else(|| Refusal::not_found("a bench", name))
}

fn state_of(bench: &config::Bench) -> Result<Option<state::State>, Refusal> {
    state::State::of(bench).map_err(|error| Refusal::machine(&error))
}

/// Returns the holder and the scopes of the token. Every token may call it.
#[utoipa::path(
    get,
    path = "/api/v1/whoami",
    tag = "access",
    responses((status = 200, body = Caller)),
    security(("token" = []))
)]
pub async fn whoami(caller: Known, State(app): State<App>) -> Json<Caller> {
    let benches = app
        .server
        .settings
        .benches
        .iter()
        .map(|bench| bench.name.clone())
        .collect();
    Json(Caller {
        name: caller.name,
        scopes: caller.scopes,
        benches,
    })
}

/// Returns the current state of all benches.
#[utoipa::path(
    get,
    path = "/api/v1/benches",
    tag = "benches",
    responses((status = 200, body = [BenchNow])),
    security(("token" = ["read"]))
)]
pub async fn list(_caller: Reader, State(app): State<App>) -> Json<Vec<BenchNow>> {
    let benches = app.server.settings.benches.iter();
    Json(
        benches
            .filter_map(|bench| BenchNow::of(&app, bench))
            .collect(),
    )
}

/// Returns the current state of a bench.
#[utoipa::path(
    get,
    path = "/api/v1/benches/{bench}",
    tag = "benches",
    params(("bench" = String, Path)),
    responses((status = 200, body = BenchNow)),
    security(("token" = ["read"]))
)]
pub async fn detail(
    _caller: Reader,
    State(app): State<App>,
    Path(bench): Path<String>,
) -> Result<Json<BenchNow>, Refusal> {
    let now = BenchNow::of(&app, known(&app, &bench)?);
    now.map(Json)
        .ok_or_else(|| Refusal::not_found("a bench", &bench))
}

/// Stops whatever runs on a bench and reads all outputs back. Answers when that is done; events
/// report the progress. Every token may stop, and so may anyone on the server's machine, with or
/// without a token. The number of stops is not limited.
#[utoipa::path(
    post,
    path = "/api/v1/benches/{bench}/stop",
    tag = "benches",
    params(("bench" = String, Path)),
    responses((status = 200, body = StopReport)),
    security(("token" = []), ())
)]
pub async fn stop(
    caller: Stopping,
    State(app): State<App>,
    Path(bench): Path<String>,
) -> Result<Json<StopReport>, Refusal> {
    let config = known(&app, &bench)?.clone();
    // A peer that goes away does not end it.
    let work = tokio::spawn(async move {
        let by = Stopper {
            held_by: caller.side,
            name: &caller.name,
        };
        stop::stop(&app.server, &config, by).await
    });
    work.await
        .map(Json)
        .map_err(|error| Refusal::machine(&error))
}

/// Stops all benches at once, like the stop of each of them. Answers when all is done. Whoever may
/// stop one bench may stop all.
#[utoipa::path(
    post,
    path = "/api/v1/stop",
    tag = "benches",
    responses((status = 200, body = [StopReport])),
    security(("token" = []), ())
)]
pub async fn stop_all(
    caller: Stopping,
    State(app): State<App>,
) -> Result<Json<Vec<StopReport>>, Refusal> {
    let benches = app.server.settings.benches.clone();
    let begin = |bench: config::Bench| {
        let (server, caller) = (app.server.clone(), caller.clone());
        tokio::spawn(async move {
            let by = Stopper {
                held_by: caller.side,
                name: &caller.name,
            };
            stop::stop(&server, &bench, by).await
        })
    };
    let work: Vec<_> = benches.into_iter().map(begin).collect();
    let mut reports = Vec::with_capacity(work.len());
    for one in work {
        reports.push(one.await.map_err(|error| Refusal::machine(&error))?);
    }
    Ok(Json(reports))
}

/// Returns all latches and clearings of a bench, the latest last.
#[utoipa::path(
    get,
    path = "/api/v1/benches/{bench}/trips",
    tag = "trips",
    params(("bench" = String, Path), Most),
    responses((status = 200, body = Trips)),
    security(("token" = ["read"]))
)]
pub async fn trips(
    _caller: Reader,
    State(app): State<App>,
    Path(bench): Path<String>,
    Query(most): Query<Most>,
) -> Result<Json<Trips>, Refusal> {
    let most = most.or(100)?;
    let Some(state) = state_of(known(&app, &bench)?)? else {
        return Ok(Json(Trips {
            latched: None,
            history: Vec::new(),
        }));
    };
    let latched = state
        .latched()
        .map_err(|error| Refusal::machine(&error))?
        .map(TripNow::from);
    let text = std::fs::read_to_string(state.path("trips.jsonl")).unwrap_or_default();
    let mut history: Vec<Happened> = text.lines().filter_map(happened).collect();
    history.drain(..history.len().saturating_sub(most));
    Ok(Json(Trips { latched, history }))
}

fn happened(line: &str) -> Option<Happened> {
    let value: serde_json::Value = serde_json::from_str(line).ok()?;
    let text = |value: &serde_json::Value| value.as_str().map(str::to_owned);
    let unix_s = [
        &value["unix_s"],
        &value["trip"]["unix_s"],
        &value["report"]["unix_s"],
    ]
    .into_iter()
    .find_map(serde_json::Value::as_f64);
    Some(Happened {
        what: text(&value["what"])?,
        who: text(&value["who"]),
        found: text(&value["found"]),
        cause: text(&value["trip"]["cause"]),
        unix_s,
    })
}

/// The trips of a bench.
#[derive(Debug, Serialize, ToSchema)]
pub struct Trips {
    /// Why it is latched now, if it is.
    latched: Option<TripNow>,
    /// Latches, clearings, and switch-offs by guardians.
    history: Vec<Happened>,
}

/// A latch, a clearing, or a switch-off by a guardian.
#[derive(Debug, Serialize, ToSchema)]
pub struct Happened {
    /// Kind of the event.
    what: String,
    /// Who cleared it: the name of the token, or the account on a terminal or if no token is
    /// required.
    who: Option<String>,
    /// Finding of the person who cleared it, verbatim.
    found: Option<String>,
    /// The cause.
    cause: Option<String>,
    /// Time, s since 1970.
    unix_s: Option<f64>,
}

/// Clears a latched bench after a person has inspected it and the cell.
#[utoipa::path(
    post,
    path = "/api/v1/benches/{bench}/trips/clear",
    tag = "trips",
    params(("bench" = String, Path)),
    request_body = Confirm,
    responses((status = 200, body = TripNow)),
    security(("token" = ["clear-trip"]))
)]
pub async fn clear(
    caller: Clearer,
    State(app): State<App>,
    Path(bench): Path<String>,
    Json(confirm): Json<Confirm>,
) -> Result<Json<TripNow>, Refusal> {
    let state = state_of(known(&app, &bench)?)?;
    let latched = state
        .as_ref()
        .map(|state| state.latched().map(|trip| (state, trip)))
        .transpose()
        .map_err(|error| Refusal::machine(&error))?;
    let Some((state, Some(trip))) = latched else {
        return Err(Refusal::conflict(
            "expected a bench that is latched, found one that is not",
        ));
    };
    if confirm.cause != trip.cause {
        return Err(Refusal::conflict(format!(
            "expected the cause that is shown now, {:?}, found {:?}",
            trip.cause, confirm.cause
        )));
    }
    let found = confirm
        .found
        .as_deref()
        .map(str::trim)
        .filter(|text| !text.is_empty());
    if found.is_some_and(|text| text.chars().count() > LONGEST_FOUND) {
        return Err(Refusal::of(
            StatusCode::BAD_REQUEST,
            format!("found: expected at most {LONGEST_FOUND} characters"),
        ));
    }
    state
        .clear(
            &trip,
            caller.token_sha256.as_ref().map(|_| caller.name.as_str()),
            found,
        )
        .map_err(|error| Refusal::machine(&error))?;
    Ok(Json(trip.into()))
}

/// Returns the audit trail, the latest entry last.
#[utoipa::path(
    get,
    path = "/api/v1/audit",
    tag = "access",
    params(Most),
    responses((status = 200, body = [Deed])),
    security(("token" = ["operate"]))
)]
pub async fn audit(
    _caller: Operator,
    State(app): State<App>,
    Query(most): Query<Most>,
) -> Result<Json<Vec<Deed>>, Refusal> {
    app.server
        .audit
        .latest(most.or(200)?)
        .map(Json)
        .map_err(|error| Refusal::machine(&error))
}

/// Enters what an agent of a fleet did for a person, in the name of that person.
#[utoipa::path(
    post,
    path = "/api/v1/audit",
    tag = "access",
    request_body = AgentDeed,
    responses((status = 204)),
    security(("token" = ["fleet"]))
)]
pub async fn enter(
    caller: Agent,
    State(app): State<App>,
    Json(deed): Json<AgentDeed>,
) -> Result<StatusCode, Refusal> {
    let plain = |text: &str| -> String {
        let plain = text.chars().filter(|c| !c.is_control());
        plain.take(LONGEST_DEED).collect()
    };
    let by = By {
        who: &caller.name,
        from: "fleet",
    };
    let written = (app.server.audit).write(by, &plain(&deed.what), &plain(&deed.outcome));
    written.map_err(|error| Refusal::machine(&error))?;
    Ok(StatusCode::NO_CONTENT)
}
