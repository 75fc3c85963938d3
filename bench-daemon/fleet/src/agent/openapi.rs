//! The OpenAPI document of the agent, made from the handlers.

use axum::Json;
use utoipa::{
    Modify, OpenApi,
    openapi::security::{Http, HttpAuthScheme, SecurityScheme},
};

use super::{metrics, refusal, routes, stops};

#[derive(OpenApi)]
#[openapi(
    info(title = "eis-fleet", description = "A fleet of battery test benches: jobs, holds, stops."),
    paths(
        routes::whoami,
        routes::now,
        routes::jobs,
        routes::submit,
        routes::cancel,
        routes::cancel_campaign,
        routes::release_job,
        routes::hold,
        routes::release,
        routes::drain,
        stops::stop,
        stops::stop_all,
        metrics::metrics
    ),
    components(schemas(refusal::Problem)),
    modifiers(&Token)
)]
struct Document;

/// Security scheme of tokens.
struct Token;

impl Modify for Token {
    fn modify(&self, document: &mut utoipa::openapi::OpenApi) {
        let components = document.components.get_or_insert_default();
        let scheme = Http::builder()
            .scheme(HttpAuthScheme::Bearer)
            .description(Some("A token of the server of the benches."))
            .build();
        components.add_security_scheme("token", SecurityScheme::Http(scheme));
    }
}

/// Returns the document.
pub(crate) async fn document() -> Json<utoipa::openapi::OpenApi> {
    Json(Document::openapi())
}
