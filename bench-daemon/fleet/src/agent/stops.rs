//! Routes of the stops. The server stops a bench of its own site at once, without the NATS server;
//! benches of other sites are stopped through the NATS server.

use axum::{
    Json,
    extract::{Path, State},
};
use futures_util::future::join_all;
use serde::Serialize;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::{
    app::App,
    bench,
    caller::Known,
    refusal::Refusal,
    routes::{FleetWhy, command, order, reason},
    server::Call,
};
use crate::{
    api::FleetOutcome,
    client::Outcome,
    job::Place,
    local::Away,
    standing::{OrderKind, through_the_fleet},
};

/// Result of a stop of all benches.
#[derive(Debug, Serialize, ToSchema)]
pub(crate) struct FleetStopped {
    /// Each bench.
    benches: Vec<FleetOutcome>,
    /// Why further benches may not have been reached; null if all are listed above.
    unreached: Option<String>,
}

/// A stop of a bench of this site by its own server.
struct OwnStop {
    place: Place,
    /// Name of the caller, as other sites show it.
    by: String,
    report: Result<Value, Away>,
}

impl OwnStop {
    /// Stops a bench of this site; returns `None` for a bench of another site.
    async fn run(app: &App, place: &Place, who: &str) -> Option<Self> {
        let benches = &app.joined.get()?.benches;
        if place.site != app.settings.site || !benches.contains(&place.bench) {
            return None;
        }
        // The name of the user in the fleet, so that a release by the fleet lifts the hold.
        let by = app.by(who);
        let report = bench::stop(&app.server, &place.bench, &by).await;
        let place = place.clone();
        Some(Self { place, by, report })
    }

    fn held(&self) -> String {
        format!("stopped by {}", through_the_fleet(&self.by))
    }

    /// Returns whether every output is known to be off.
    fn is_proven(&self) -> bool {
        let is = |key: &str| self.report.as_ref().is_ok_and(|report| report[key] == true);
        is("over") && (is("verified") || is("simulated"))
    }

    /// Holds the bench for its own server, if the NATS server does not keep the stop: an older release
    /// of the fleet that is heard later must not take it back.
    async fn hold_here(&self, app: &App, through: Option<&FleetOutcome>) {
        if self.report.is_err() || through.is_some_and(|through| through.kept) {
            return;
        }
        let (server, why) = (app.server.clone(), self.held());
        let path = format!("/benches/{}/hold", self.place.bench);
        let work = move || {
            let call = Call {
                person: None,
                ..Call::post(&path, "", json!({ "why": why }))
            };
            server.call::<Value>(call)
        };
        match tokio::task::spawn_blocking(work).await {
            Ok(Ok(_)) => {}
            Ok(Err(error)) => tracing::error!("{}: not held: {}", self.place, error.into_away()),
            Err(error) => tracing::error!("{}: not held: {error}", self.place),
        }
    }

    fn outcome(&self, through: Option<&FleetOutcome>) -> FleetOutcome {
        let is_reached = self.report.is_ok();
        FleetOutcome {
            site: self.place.site.clone(),
            bench: self.place.bench.clone(),
            kept: through.is_some_and(|through| through.kept),
            heard: is_reached,
            held: is_reached.then(|| self.held()),
            outputs_verified: is_reached.then(|| self.is_proven()),
            words: match &self.report {
                Ok(_) => "stopped by its own server".to_owned(),
                Err(away) => {
                    format!("IT WAS NOT REACHED: stop it at its own server or its switch ({away})")
                }
            },
            report: self.report.as_ref().ok().cloned(),
        }
    }
}

/// Stops whatever runs on a bench of the fleet and reads every output back, by the bench's own server.
/// A bench of this site is stopped without the NATS server.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/benches/{site}/{bench}/stop",
    tag = "fleet",
    params(("site" = String, Path), ("bench" = String, Path)),
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetOutcome)),
    security(("token" = []))
)]
pub(crate) async fn stop(
    caller: Known,
    State(app): State<App>,
    Path(place): Path<Place>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetOutcome>, Refusal> {
    app.fleet()?;
    let who = caller.name;
    // It continues if the peer disconnects.
    let work = tokio::spawn(async move {
        let command = command(&app, OrderKind::Stop, &who, why);
        let own = OwnStop::run(&app, &place, &who);
        let through = order(&app, &place, command);
        match tokio::join!(own, through) {
            (Some(own), through) => {
                let through = through.ok().map(|through| through.0);
                own.hold_here(&app, through.as_ref()).await;
                Ok(Json(own.outcome(through.as_ref())))
            }
            (None, through) => through,
        }
    });
    work.await.map_err(|error| Refusal::machine(&error))?
}

/// Stops every bench of the fleet at once. Answers when all have answered, or after 2 min.
#[utoipa::path(
    post,
    path = "/api/v1/fleet/stop",
    tag = "fleet",
    request_body = Option<FleetWhy>,
    responses((status = 200, body = FleetStopped)),
    security(("token" = []))
)]
pub(crate) async fn stop_all(
    caller: Known,
    State(app): State<App>,
    why: Option<Json<FleetWhy>>,
) -> Result<Json<FleetStopped>, Refusal> {
    app.fleet()?;
    let work = async move { stop_every(&app, &caller.name, &reason(why)).await };
    let stopped = tokio::spawn(work).await;
    stopped.map(Json).map_err(|error| Refusal::machine(&error))
}

/// Outcomes of stops through the NATS server.
struct Through {
    outcomes: Vec<Outcome>,
    /// Why further benches may not have been reached.
    unreached: Option<String>,
}

/// Sends stops through the NATS server. If it does not list its benches, the benches seen earlier are
/// asked.
async fn stop_through(app: &App, who: &str, why: &str) -> Result<Through, Refusal> {
    let (client, by) = (app.client()?, app.by(who));
    match client.stop_all(&by, why).await {
        Ok(outcomes) => Ok(Through {
            outcomes,
            unreached: None,
        }),
        Err(error) => {
            let seer = app.fleet()?.seer().await;
            let seen = seer.map(|seer| seer.places()).unwrap_or_default();
            Ok(Through {
                outcomes: client.stop_these(&seen, &by, why).await?,
                unreached: Some(error.to_string()),
            })
        }
    }
}

async fn stop_every(app: &App, who: &str, why: &str) -> FleetStopped {
    let benches = app.joined.get().map(|joined| joined.benches.iter());
    let place = |bench: &String| Place::new(&app.settings.site, bench);
    let places: Vec<Place> = benches.into_iter().flatten().map(place).collect();
    let own = join_all(places.iter().map(|place| OwnStop::run(app, place, who)));
    let (own, through) = tokio::join!(own, stop_through(app, who, why));
    let through = through.unwrap_or_else(|refusal| Through {
        outcomes: Vec::new(),
        unreached: Some(refusal.1.message),
    });
    let others = through.outcomes.into_iter();
    let mut all: Vec<FleetOutcome> = others.map(Into::into).collect();
    for own in own.iter().flatten() {
        let is_same =
            |one: &FleetOutcome| one.site == own.place.site && one.bench == own.place.bench;
        let through = all.iter().position(is_same).map(|at| all.remove(at));
        own.hold_here(app, through.as_ref()).await;
        all.push(own.outcome(through.as_ref()));
    }
    FleetStopped {
        benches: all,
        unreached: through.unreached,
    }
}
