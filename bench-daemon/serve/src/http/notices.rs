//! Routes of notifications to people away from the page.

use axum::{Json, extract::State};
use bench_http::Refusal;
use serde::Serialize;
use utoipa::ToSchema;

use super::{
    App,
    caller::{Operator, Reader},
};
use crate::{notices::Notice, notify};

/// Targets of notices, and the latest notices.
#[derive(Debug, Serialize, ToSchema)]
pub struct NoticesNow {
    /// Host of the webhook; its full address may contain a secret.
    webhook: Option<String>,
    /// Receivers of e-mails.
    email: Vec<String>,
    /// Quiet hours, local time.
    quiet: Option<String>,
    /// The latest notices, the latest first.
    latest: Vec<Notice>,
}

/// Returns the targets of notices, and the latest notices with their outcome.
#[utoipa::path(
    get,
    path = "/api/v1/notices",
    tag = "notices",
    responses((status = 200, body = NoticesNow)),
    security(("token" = ["read"]))
)]
pub async fn list(_caller: Reader, State(app): State<App>) -> Json<NoticesNow> {
    let targets = &app.server.settings.notify;
    let host = |address: &String| {
        let (_, rest) = address.split_once("://")?;
        rest.split('/').next().map(str::to_owned)
    };
    let email = targets
        .email
        .iter()
        .flat_map(|email| &email.to)
        .map(ToString::to_string);
    let quiet = targets.quiet.map(|(from, to)| {
        format!(
            "{:02}:{:02}-{:02}:{:02}",
            from.hour(),
            from.minute(),
            to.hour(),
            to.minute()
        )
    });
    Json(NoticesNow {
        webhook: targets.webhook.as_ref().and_then(host),
        email: email.collect(),
        quiet,
        latest: app.server.notices.list(),
    })
}

/// Sends a test notice now, and returns its outcome.
#[utoipa::path(
    post,
    path = "/api/v1/notices/test",
    tag = "notices",
    responses((status = 200, body = Notice)),
    security(("token" = ["operate"]))
)]
pub async fn test(caller: Operator, State(app): State<App>) -> Result<Json<Notice>, Refusal> {
    let targets = &app.server.settings.notify;
    if targets.webhook.is_none() && targets.email.is_none() {
        return Err(Refusal::conflict(
            "expected a webhook or an e-mail in [notify] of the server's file, found none",
        ));
    }
    let Ok(_one) = app.server.notices.testing.try_acquire() else {
        return Err(Refusal::conflict(
            "expected one test at a time, found one under way",
        ));
    };
    Ok(Json(notify::test(&app.server, &caller.name).await))
}
