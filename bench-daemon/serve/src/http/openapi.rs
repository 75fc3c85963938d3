//! The operations of the API: their routes, and the OpenAPI document, made from the handlers.

use axum::{Json, Router, routing::MethodRouter};
use utoipa::{
    Modify, OpenApi,
    openapi::{
        Content, Ref, RefOr, ResponseBuilder,
        path::Operation,
        security::{Http, HttpAuthScheme, SecurityScheme},
    },
};

use super::{
    App, analyses, archive, benches, catalog, events, find, imported, instruments, investigations,
    metrics, notices, openapi, pack, queue, runs, session, shelf,
};

/// Defines the routes below `/api/v1`, and the document of the same operations and of the
/// metrics.
macro_rules! operations {
    ($($path:literal => $($method:ident $module:ident::$handler:ident),+;)+) => {
        /// Returns the routes below `/api/v1`.
        pub fn routes() -> Router<App> {
            Router::new()$(.route($path, MethodRouter::new()$(.$method($module::$handler))+))+
        }

        #[derive(OpenApi)]
        #[openapi(
            info(
                title = "eis-bench",
                description = "A battery test bench: queue, runs, live state, trips."
            ),
            paths($($($module::$handler,)+)+ metrics::metrics),
            components(schemas(bench_http::Problem)),
            modifiers(&Common)
        )]
        struct Document;
    };
}

operations! {
    "/openapi.json" => get openapi::document;
    "/stop" => post benches::stop_all;
    "/session" => post session::begin, delete session::end;
    "/whoami" => get benches::whoami;
    "/benches" => get benches::list;
    "/benches/{bench}" => get benches::detail;
    "/benches/{bench}/instruments" => get instruments::instruments;
    "/benches/{bench}/identify" => post instruments::identify;
    "/benches/{bench}/outputs/read" => post instruments::read_outputs;
    "/benches/{bench}/stop" => post benches::stop;
    "/benches/{bench}/trips" => get benches::trips;
    "/benches/{bench}/trips/clear" => post benches::clear;
    "/benches/{bench}/hold" => post queue::hold;
    "/benches/{bench}/release" => post queue::release;
    "/benches/{bench}/notes" => get queue::notes;
    "/experiments" => get queue::experiments;
    "/experiments/{experiment}/plan" => get queue::plan;
    "/analyses" => get analyses::list, post analyses::submit;
    "/analyses/{id}" => get analyses::detail, delete analyses::cancel;
    "/analyses/{id}/log" => get analyses::log;
    "/analyses/{id}/files/{*path}" => get analyses::file;
    "/investigations" => get investigations::list, post investigations::begin;
    "/investigations/{id}" => get investigations::detail;
    "/investigations/{id}/cancel" => post investigations::cancel;
    "/notices" => get notices::list;
    "/notices/test" => post notices::test;
    "/pack" => post pack::under_load;
    "/pack/models" => get pack::models;
    "/schemas/{kind}" => get shelf::schema;
    "/files/{kind}" => get shelf::list;
    "/files/{kind}/{name}" => get shelf::read, put shelf::write;
    "/drafts" => post shelf::draft;
    "/queue" => get queue::list, post queue::submit;
    "/queue/order" => post queue::reorder;
    "/queue/{id}" => delete queue::cancel;
    "/runs" => get runs::list;
    "/runs/{run}" => get runs::detail;
    "/runs/{run}/experiment" => get shelf::of_run;
    "/runs/{run}/notes" => get find::run_notes, post find::note_run;
    "/runs/{run}/tags" => put find::tag_run;
    "/runs/{run}/campaign" => get find::campaign;
    "/runs/{run}/models" => get find::models;
    "/runs/{run}/capture" => get find::capture;
    "/spectra/read" => post imported::read;
    "/catalog/runs" => get catalog::runs;
    "/catalog/runs/{run}" => get catalog::run;
    "/catalog/spectra" => get catalog::spectra;
    "/catalog/fits" => get catalog::fits;
    "/catalog/diagnoses" => get catalog::diagnoses;
    "/catalog/cells" => get catalog::cells;
    "/catalog/ageing" => get catalog::ageing;
    "/catalog/choices" => get catalog::choices;
    "/archive" => get archive::now;
    "/cells/{cell}/notes" => get find::cell_notes, post find::note_cell;
    "/runs/{run}/spectra" => get runs::spectra;
    "/runs/{run}/fits" => get runs::fits;
    "/runs/{run}/readings" => get runs::readings;
    "/runs/{run}/log" => get runs::log;
    "/runs/{run}/files" => get runs::files;
    "/runs/{run}/files/{*path}" => get runs::file;
    "/runs/{run}/pause" => post runs::pause;
    "/runs/{run}/go-on" => post runs::go_on;
    "/runs/{run}/answer" => post runs::answer;
    "/runs/{run}/order" => post runs::order;
    "/runs/{run}/resume" => post runs::resume;
    "/audit" => get benches::audit, post benches::enter;
    "/events" => get events::events;
}

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
