//! The OpenAPI document, made from the handlers.

use axum::Json;
use utoipa::{
    Modify, OpenApi,
    openapi::{
        Content, Ref, RefOr, ResponseBuilder,
        path::Operation,
        security::{Http, HttpAuthScheme, SecurityScheme},
    },
};

use super::{
    analyses, archive, benches, catalog, events, find, imported, instruments, investigations,
    metrics, notices, pack, queue, runs, session, shelf,
};

#[derive(OpenApi)]
#[openapi(
    info(title = "eis-bench", description = "A battery test bench: queue, runs, live state, \
    trips."),
    paths(
        document,
        benches::whoami,
        benches::list,
        benches::detail,
        instruments::instruments,
        instruments::identify,
        instruments::read_outputs,
        benches::stop,
        benches::stop_all,
        benches::trips,
        benches::clear,
        benches::audit,
        benches::enter,
        queue::list,
        queue::experiments,
        queue::plan,
        queue::submit,
        queue::cancel,
        queue::reorder,
        queue::hold,
        queue::release,
        queue::notes,
        runs::list,
        runs::detail,
        runs::spectra,
        runs::fits,
        runs::readings,
        runs::log,
        runs::files,
        runs::file,
        runs::pause,
        runs::go_on,
        runs::answer,
        runs::order,
        runs::resume,
        find::run_notes,
        find::note_run,
        find::tag_run,
        find::campaign,
        find::models,
        find::capture,
        imported::read,
        catalog::runs,
        catalog::run,
        catalog::spectra,
        catalog::fits,
        catalog::diagnoses,
        catalog::cells,
        catalog::ageing,
        catalog::choices,
        archive::now,
        find::cell_notes,
        find::note_cell,
        analyses::list,
        analyses::submit,
        analyses::detail,
        analyses::cancel,
        analyses::log,
        analyses::file,
        investigations::list,
        investigations::begin,
        investigations::detail,
        investigations::cancel,
        notices::list,
        notices::test,
        pack::under_load,
        pack::models,
        session::begin,
        session::end,
        shelf::schema,
        shelf::list,
        shelf::read,
        shelf::write,
        shelf::draft,
        shelf::of_run,
        events::events,
        metrics::metrics
    ),
    components(schemas(bench_http::Problem)),
    modifiers(&Common)
)]
struct Document;

/// Parts common to all paths: how a token is shown, and how a request is refused.
struct Common;

/// Refusals that apply to any request, and those of requests with a token.
const REFUSALS: [(&str, &str); 10] = [
    ("400", "The path, the query or the body is not as expected."),
    (
        "403",
        "Another host or origin is meant, or the token lacks the scope.",
    ),
    ("404", "The resource does not exist."),
    ("408", "The body took too long."),
    ("413", "The body is too large."),
    ("414", "The path is too long."),
    ("415", "The body is not JSON."),
    ("422", "The body is JSON, but not what is expected."),
    ("429", "Too many requests."),
    ("431", "The head is too large."),
];
const WITH_TOKEN: [(&str, &str); 3] = [
    ("401", "The token is missing or invalid."),
    ("409", "The request conflicts with the current state."),
    ("503", "The server's machine cannot serve the request."),
];

impl Modify for Common {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let components = document.components.get_or_insert_default();
        let scheme = Http::builder()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some("`eis-bench token add` makes one."))
            .build();
        components.add_security_scheme("token", SecurityScheme::Http(scheme));
        for item in document.paths.paths.values_mut() {
            [
                &mut item.get,
                &mut item.post,
                &mut item.put,
                &mut item.delete,
            ]
            .into_iter()
            .flatten()
            .for_each(refusals);
        }
    }
}

fn refusals(operation: &mut Operation) {
    let with_token = operation.security.is_some();
    let more = WITH_TOKEN.iter().filter(|_| with_token);
    for (status, description) in REFUSALS.iter().chain(more) {
        let content = Content::new(Some(RefOr::<utoipa::openapi::Schema>::Ref(
            Ref::from_schema_name("Problem"),
        )));
        let response = ResponseBuilder::new()
            .description(*description)
            .content("application/json", content)
            .build();
        operation
            .responses
            .responses
            .entry((*status).to_owned())
            .or_insert_with(|| response.into());
    }
}

/// The document itself.
pub fn openapi() -> utoipa::openapi::OpenApi {
    Document::openapi()
}

/// Returns this document.
#[utoipa::path(
    get,
    path = "/api/v1/openapi.json",
    tag = "access",
    responses((status = 200, body = serde_json::Value))
)]
pub async fn document() -> Json<utoipa::openapi::OpenApi> {
    Json(openapi())
}
