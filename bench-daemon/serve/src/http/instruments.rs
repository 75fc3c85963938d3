//! Routes of the instruments of a bench: their health, their identities, their outputs.

use axum::{
    Json,
    extract::{Path, State},
};
use bench_http::Refusal;
use serde::Serialize;
use utoipa::ToSchema;

use super::{
    App, benches,
    caller::{Operator, Reader},
};
use crate::{
    live::InstrumentNow,
    outputs::{self, ReadError},
    supervisor::Asked,
};
use bench_core::bench::outputs::{OutputReading, OutputsState};

/// Returns the instruments of a bench and their health.
#[utoipa::path(
    get,
    path = "/api/v1/benches/{bench}/instruments",
    tag = "benches",
    params(("bench" = String, Path)),
    responses((status = 200, body = [InstrumentNow])),
    security(("token" = ["read"]))
)]
pub async fn instruments(
    caller: Reader,
    app: State<App>,
    bench: Path<String>,
) -> Result<Json<Vec<InstrumentNow>>, Refusal> {
    Ok(Json(
        benches::detail(caller, app, bench)
            .await?
            .0
            .live
            .instruments,
    ))
}

/// Queries the identity of every instrument, and the state of the outputs; changes nothing on any
/// of them. A silent instrument does not hide the answers of the others. Refused while a run or a
/// stop is at work, because instruments accept one client; a run or a stop ends the queries.
#[utoipa::path(
    post,
    path = "/api/v1/benches/{bench}/identify",
    tag = "benches",
    params(("bench" = String, Path)),
    responses((status = 200, body = Identified)),
    security(("token" = ["operate"]))
)]
pub async fn identify(
    _caller: Operator,
    State(app): State<App>,
    Path(bench): Path<String>,
) -> Result<Json<Identified>, Refusal> {
    let config = benches::known(&app, &bench)?;
    let asked: Vec<Asked> =
        (outputs::ask(&app.server, config, "identify").await).map_err(refusal)?;
    app.server.identities().insert(bench, asked.clone());
    Ok(Json(Identified::of(asked)))
}

/// Reads the output state of every instrument that can move charge, and disconnects again; changes
/// nothing on any of them. Refused during a run or a stop, whose own readings show the outputs.
#[utoipa::path(
    post,
    path = "/api/v1/benches/{bench}/outputs/read",
    tag = "benches",
    params(("bench" = String, Path)),
    responses((status = 200, body = OutputsState)),
    security(("token" = ["operate"]))
)]
pub async fn read_outputs(
    _caller: Operator,
    State(app): State<App>,
    Path(bench): Path<String>,
) -> Result<Json<OutputsState>, Refusal> {
    let config = benches::known(&app, &bench)?;
    let read = outputs::read(&app.server, config).await;
    read.map(Json).map_err(refusal)
}

fn refusal(error: ReadError) -> Refusal {
    match error {
        ReadError::Busy(why) => Refusal::conflict(why),
        ReadError::Machine(_) => Refusal::machine(&error),
    }
}

/// Identities of the instruments.
#[derive(Debug, Serialize, ToSchema)]
pub struct Identified {
    /// Instruments that answered.
    answers: Vec<IdentifiedOne>,
    /// Instruments that did not answer.
    silent: Vec<SilentOne>,
    /// Which instruments did not answer or are another model, as text; null if there is none.
    trouble: Option<String>,
}

/// Identity of one instrument.
#[derive(Debug, Serialize, ToSchema)]
pub struct IdentifiedOne {
    /// Its role.
    role: String,
    /// Its answer.
    answer: String,
    /// Whether it is the configured model.
    recognised: bool,
    /// State of its output, if it can move charge.
    output: Option<OutputReading>,
}

/// An instrument that did not answer.
#[derive(Debug, Serialize, ToSchema)]
pub struct SilentOne {
    /// Its role.
    role: String,
    /// Its address.
    address: String,
    /// The reason.
    why: String,
}

impl Identified {
    fn of(asked: Vec<Asked>) -> Self {
        let (mut answers, mut silent) = (Vec::new(), Vec::new());
        let mut trouble = Vec::new();
        for one in asked {
            let Asked { role, address, .. } = one;
            let Some(identity) = one.identity else {
                trouble.push(format!("no answer: {role}"));
                let why = one.failure.unwrap_or_default();
                silent.push(SilentOne { role, address, why });
                continue;
            };
            let recognised = one.recognised.unwrap_or(false);
            if !recognised {
                trouble.push(format!("another model: {role}"));
            }
            answers.push(IdentifiedOne {
                role,
                answer: identity.raw,
                recognised,
                output: one.output,
            });
        }
        let trouble = Some(trouble.join("; ")).filter(|text| !text.is_empty());
        Self {
            answers,
            silent,
            trouble,
        }
    }
}
