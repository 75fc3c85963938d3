//! Commands that show a fleet, submit jobs, and hold and stop benches. They are clients of the NATS
//! server and need no agent.

mod args;
mod campaign;
mod print;

use instruments_link::clock::{Clock, TimeMode};

use crate::{
    api::{FleetOutcome, name_of},
    client::{Ages, Client, Command, Forgotten, Outcome, Submission},
    config::{self, AgentFile, read},
    failure::Failure,
    job::Place,
    settings::FleetSettings,
    standing::OrderKind,
    terminal::{say, say_json},
    view::{FleetView, JobFilter, JobPage},
};
use args::{CancelArgs, ForgetArgs, OrderArgs, StopArgs, SubmitArgs};
use campaign::PlannedCampaign;

pub use args::{Act, ConnectArgs};

/// Time that a text without jobs is kept, s: a submission writes it before its jobs.
const YOUNG_TEXT_S: f64 = 86_400.0;

/// A snapshot of a fleet from one query. A short query cannot observe that a bench is silent.
struct Asked {
    view: FleetView,
    page: JobPage,
}

/// Shows a fleet, or sends it a command.
///
/// # Errors
/// An argument is invalid, the NATS server does not answer, or a stop is not verified.
pub fn run(connect: &ConnectArgs, act: &Act, json: bool) -> Result<(), Failure> {
    let runtime = Clock::runtime(TimeMode::Real)?;
    runtime.block_on(run_act(connect, act, json))
}

async fn run_act(connect: &ConnectArgs, act: &Act, json: bool) -> Result<(), Failure> {
    let settings = settings(connect)?;
    let client = Client::connect(&settings).await?;
    match act {
        Act::Status(filter) => {
            let Asked { view, page } = ask(&client, &settings.fleet, filter.filter()).await?;
            if json {
                return say_json(&print::Status::of(view, page, settings.server));
            }
            print::status(&view, &page);
        }
        Act::Submit(submit) => {
            let jobs = client.submit(&submission_of(submit)?).await?;
            if json {
                return say_json(&serde_json::json!({ "jobs": jobs }));
            }
            jobs.iter().for_each(|job| say!("{job}"));
        }
        Act::Campaign { file } => {
            let planned = PlannedCampaign::plan(file)?;
            let known = campaign::seeds(&client, &settings.fleet, &planned.campaign).await?;
            let jobs = client.submit_all(&planned.missing(&known, &by())).await?;
            if json {
                return say_json(&serde_json::json!({ "jobs": jobs }));
            }
            say!("{} jobs", jobs.len());
        }
        Act::Cancel(cancel) => run_cancel(&client, cancel, json).await?,
        Act::Release(order) if !order.what.contains('/') => {
            let (job, why) = (&order.what, &order.why);
            client.release_job(job, &by(), why).await?;
            say_done(json, job, "back in the queue")?;
        }
        Act::Release(order) => send_order(&client, OrderKind::Release, order, json).await?,
        Act::Hold(order) => send_order(&client, OrderKind::Hold, order, json).await?,
        Act::Drain(order) => send_order(&client, OrderKind::Drain, order, json).await?,
        Act::Stop(stop) => run_stop(&client, stop, json).await?,
        Act::Forget(forget) => run_forget(&client, forget, json).await?,
    }
    Ok(())
}

/// Returns the fleet from the arguments.
fn settings(connect: &ConnectArgs) -> Result<FleetSettings, Failure> {
    if let Some(config) = &connect.config {
        return Ok(AgentFile::load(config)?.settings);
    }
    let Some(name) = &connect.fleet else {
        return Err(Failure::Usage(
            "expected --config FILE of an agent, or --fleet NAME with --server ADDRESS, found \
            neither"
                .to_owned(),
        ));
    };
    let settings = config::of_client(name, &connect.server, connect.credentials.as_deref())?;
    Ok(FleetSettings {
        ca: connect.ca.clone(),
        ..settings
    })
}

/// Returns the caller's name for the records of the benches: the account and its machine.
fn by() -> String {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let uid = nix::unistd::Uid::current();
    let user = nix::unistd::User::from_uid(uid).ok().flatten();
    let who = user.map_or_else(|| format!("uid {uid}"), |user| user.name);
    format!("{who}@{}", host.trim())
}

fn say_done(json: bool, what: &str, how: &str) -> Result<(), Failure> {
    if json {
        return say_json(&serde_json::json!({ "what": what, "how": how }));
    }
    say!("{what}: {how}");
    Ok(())
}

/// Returns the present state of the fleet: its records, and the benches that reply.
async fn ask(client: &Client, fleet: &str, filter: JobFilter) -> Result<Asked, Failure> {
    let looking = client.seer(fleet).await?;
    looking
        .seer
        .asked(client.look(&looking.seer.places()).await);
    let view = looking.seer.view();
    let page = looking.seer.jobs(&filter);
    Ok(Asked { view, page })
}

fn submission_of(args: &SubmitArgs) -> Result<Submission, Failure> {
    let text = read(&args.experiment)?;
    let name = name_of(&text)
        .map_err(|error| Failure::Usage(format!("{}: {error}", args.experiment.display())))?;
    Ok(Submission {
        name,
        text,
        needs: args.needs(),
        count: args.count,
        seed: args.seed,
        campaign: args.campaign.clone(),
        cell: args.cell.clone(),
        by: by(),
    })
}

fn place(text: &str) -> Result<Place, Failure> {
    let expected = || Failure::Usage(format!("expected a bench SITE/BENCH, found {text:?}"));
    let (site, bench) = text.split_once('/').ok_or_else(expected)?;
    Ok(Place::new(site, bench))
}

async fn send_order(
    client: &Client,
    kind: OrderKind,
    order: &OrderArgs,
    json: bool,
) -> Result<(), Failure> {
    let command = Command {
        kind,
        by: by(),
        why: order.why.clone(),
    };
    let outcome = client.order(&place(&order.what)?, &command).await?;
    say_outcomes(&[outcome], json)
}

async fn run_cancel(client: &Client, cancel: &CancelArgs, json: bool) -> Result<(), Failure> {
    if let Some(job) = &cancel.job {
        client.cancel(job, &by()).await?;
        return say_done(json, job, "cancelled");
    }
    let campaign = cancel.campaign.as_deref().unwrap_or_default();
    let count = client.cancel_campaign(campaign, &by()).await?;
    say_done(json, &format!("{count} jobs of {campaign}"), "cancelled")
}

async fn run_forget(client: &Client, forget: &ForgetArgs, json: bool) -> Result<(), Failure> {
    if let Some(bench) = &forget.bench {
        client.forget_bench(&place(bench)?).await?;
        return say_done(json, bench, "forgotten");
    }
    let jobs_s = forget.older_s.unwrap_or(f64::INFINITY);
    let texts_s = jobs_s.max(YOUNG_TEXT_S);
    let Forgotten { jobs, texts } = client.forget(Ages { jobs_s, texts_s }).await?;
    let what = format!("{jobs} jobs, {texts} texts of experiments");
    say_done(json, &what, "forgotten")
}

async fn run_stop(client: &Client, stop: &StopArgs, json: bool) -> Result<(), Failure> {
    let all = match &stop.bench {
        Some(bench) => {
            let command = Command {
                kind: OrderKind::Stop,
                by: by(),
                why: stop.why.clone(),
            };
            vec![client.order(&place(bench)?, &command).await?]
        }
        None => client.stop_all(&by(), &stop.why).await?,
    };
    say_outcomes(&all, json)?;
    let unproven = all.iter().filter(|outcome| outcome.verified != Some(true));
    let names: Vec<String> = unproven
        .map(|outcome| format!("{}/{}", outcome.site, outcome.bench))
        .collect();
    if names.is_empty() {
        return Ok(());
    }
    let names = names.join(", ");
    Err(Failure::Unsafe(format!(
        "these are not verified off: {names}"
    )))
}

fn say_outcomes(all: &[Outcome], json: bool) -> Result<(), Failure> {
    if json {
        let shown = all.iter().cloned().map(FleetOutcome::from);
        return say_json(&shown.collect::<Vec<_>>());
    }
    all.iter().for_each(print::outcome);
    Ok(())
}
