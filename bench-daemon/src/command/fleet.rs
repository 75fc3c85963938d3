//! `eis-bench fleet`: a fleet of benches, seen, given work, held and stopped. A client of the NATS
//! server; no daemon of the fleet is needed for it.

mod args;
mod campaign;
mod print;

use std::{fs, path::Path};

use bench_fleet::{
    Client, FleetError, FleetView, Place, Submission,
    client::{Ages, Command, Forgotten, Outcome},
    standing::OrderKind,
    view::{JobFilter, JobPage},
};
use instruments::clock::{Clock, TimeMode};

use super::printed::say_json;
use crate::{
    campaign::CampaignFile,
    safety::failure::Failure,
    serve::{
        fleet_settings::FleetSection, fleet_told::FleetOutcome, settings::Settings, submission,
    },
    support::{account, terminal::say},
};
use args::{Act, CancelArgs, ConnectArgs, ForgetArgs, OrderArgs, StopArgs, SubmitArgs};

pub use args::FleetArgs;

/// A text that no job has is kept for so long, s: a submission writes it before its jobs.
const YOUNG_TEXT_S: f64 = 86_400.0;

/// A snapshot of a fleet from one query. A short query cannot observe that a bench is silent.
struct Asked {
    view: FleetView,
    page: JobPage,
}

/// Shows a fleet, or sends it a command.
///
/// # Errors
/// An argument that is not as expected; a NATS server that does not answer; a stop that is not
/// verified.
pub fn fleet(args: &FleetArgs) -> Result<(), Failure> {
    let runtime = Clock::runtime(TimeMode::Real)?;
    runtime.block_on(act(args))
}

async fn act(args: &FleetArgs) -> Result<(), Failure> {
    let section = section(&args.connect)?;
    let client = Client::connect(&section.open()?).await.map_err(failed)?;
    match &args.act {
        Act::Status(filter) => {
            let asked = ask(&client, &section.name, filter.filter()).await?;
            if args.json {
                let Asked { view, page } = asked;
                return say_json(&print::Status::of(view, page, section.server));
            }
            print::status(&asked.view, &asked.page);
        }
        Act::Submit(submit) => {
            let jobs = client
                .submit(&submission_of(submit)?)
                .await
                .map_err(failed)?;
            if args.json {
                return say_json(&serde_json::json!({ "jobs": jobs }));
            }
            jobs.iter().for_each(|job| say!("{job}"));
        }
        Act::Campaign { file } => {
            let file = CampaignFile::read(file)?;
            let known = campaign::seeds(&client, &section.name, &file.name).await;
            let all = campaign::missing(&file, &known.map_err(failed)?, &by())?;
            let jobs = client.submit_all(&all).await.map_err(failed)?;
            if args.json {
                return say_json(&serde_json::json!({ "jobs": jobs }));
            }
            say!("{} jobs", jobs.len());
        }
        Act::Cancel(cancel) => cancelled(&client, cancel, args.json).await?,
        Act::Release(order) if !order.what.contains('/') => {
            let (job, why) = (&order.what, &order.why);
            client.release_job(job, &by(), why).await.map_err(failed)?;
            told(args.json, job, "back in the queue")?;
        }
        Act::Release(order) => say_order(&client, OrderKind::Release, order, args.json).await?,
        Act::Hold(order) => say_order(&client, OrderKind::Hold, order, args.json).await?,
        Act::Drain(order) => say_order(&client, OrderKind::Drain, order, args.json).await?,
        Act::Stop(stop) => stopped(&client, stop, args.json).await?,
        Act::Forget(forget) => forgotten(&client, forget, args.json).await?,
    }
    Ok(())
}

fn failed(error: FleetError) -> Failure {
    match error {
        FleetError::Unreachable(_) => std::io::Error::other(error.to_string()).into(),
        error => Failure::Usage(error.to_string()),
    }
}

/// Which fleet is meant.
fn section(connect: &ConnectArgs) -> Result<FleetSection, Failure> {
    if let Some(config) = &connect.config {
        return Settings::load(config)?.fleet.ok_or_else(|| {
            Failure::Usage(format!(
                "{}: expected a section [fleet], found none",
                config.display()
            ))
        });
    }
    let Some(name) = &connect.fleet else {
        return Err(Failure::Usage(
            "expected --config FILE of a server, or --fleet NAME with --server ADDRESS, found \
            neither"
                .to_owned(),
        ));
    };
    let section = FleetSection::of_client(name, &connect.server)?;
    Ok(FleetSection {
        credentials: connect.credentials.clone(),
        ca: connect.ca.clone(),
        ..section
    })
}

/// Returns the caller's name for the records of the benches: the account and its machine.
fn by() -> String {
    let host = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    format!("{}@{}", account::who(), host.trim())
}

fn told(json: bool, what: &str, how: &str) -> Result<(), Failure> {
    if json {
        return say_json(&serde_json::json!({ "what": what, "how": how }));
    }
    say!("{what}: {how}");
    Ok(())
}

/// Returns the present state of the fleet: its records, and which benches reply now.
async fn ask(client: &Client, fleet: &str, filter: JobFilter) -> Result<Asked, Failure> {
    let looking = client.seer(fleet).await.map_err(failed)?;
    looking
        .seer
        .asked(client.look(&looking.seer.places()).await);
    let view = looking.seer.view();
    let page = looking.seer.jobs(&filter);
    Ok(Asked { view, page })
}

fn submission_of(args: &SubmitArgs) -> Result<Submission, Failure> {
    let text = read(&args.experiment)?;
    let name = submission::name_of(&text)
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

fn read(path: &Path) -> Result<String, Failure> {
    let wrong = |error: std::io::Error| Failure::Usage(format!("{}: {error}", path.display()));
    fs::read_to_string(path).map_err(wrong)
}

fn place(text: &str) -> Result<Place, Failure> {
    let expected = || Failure::Usage(format!("expected a bench SITE/BENCH, found {text:?}"));
    let (site, bench) = text.split_once('/').ok_or_else(expected)?;
    Ok(Place::new(site, bench))
}

async fn say_order(
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
    let outcome = client.order(&place(&order.what)?, &command).await;
    outcomes(&[outcome.map_err(failed)?], json)
}

async fn cancelled(client: &Client, cancel: &CancelArgs, json: bool) -> Result<(), Failure> {
    if let Some(job) = &cancel.job {
        client.cancel(job, &by()).await.map_err(failed)?;
        return told(json, job, "cancelled");
    }
    let campaign = cancel.campaign.as_deref().unwrap_or_default();
    let count = client.cancel_campaign(campaign, &by()).await;
    let count = count.map_err(failed)?;
    told(json, &format!("{count} jobs of {campaign}"), "cancelled")
}

async fn forgotten(client: &Client, forget: &ForgetArgs, json: bool) -> Result<(), Failure> {
    if let Some(bench) = &forget.bench {
        let place = place(bench)?;
        client.forget_bench(&place).await.map_err(failed)?;
        return told(json, bench, "forgotten");
    }
    let jobs_s = forget.older_s.unwrap_or(f64::INFINITY);
    let texts_s = jobs_s.max(YOUNG_TEXT_S);
    let Forgotten { jobs, texts } =
        (client.forget(Ages { jobs_s, texts_s }).await).map_err(failed)?;
    told(
        json,
        &format!("{jobs} jobs, {texts} texts of experiments"),
        "forgotten",
    )
}

async fn stopped(client: &Client, stop: &StopArgs, json: bool) -> Result<(), Failure> {
    let all = match &stop.bench {
        Some(bench) => {
            let command = Command {
                kind: OrderKind::Stop,
                by: by(),
                why: stop.why.clone(),
            };
            let outcome = client.order(&place(bench)?, &command).await;
            vec![outcome.map_err(failed)?]
        }
        None => client.stop_all(&by(), &stop.why).await.map_err(failed)?,
    };
    outcomes(&all, json)?;
    let unproven = all.iter().filter(|outcome| outcome.verified != Some(true));
    let names: Vec<String> = unproven
        .map(|outcome| format!("{}/{}", outcome.site, outcome.bench))
        .collect();
    if names.is_empty() {
        return Ok(());
    }
    Err(Failure::Unsafe {
        failures: format!(
            "nobody has verified that these are off: {}",
            names.join(", ")
        ),
        cause: String::new(),
    })
}

fn outcomes(all: &[Outcome], json: bool) -> Result<(), Failure> {
    if json {
        let told = all.iter().cloned().map(FleetOutcome::from);
        return say_json(&told.collect::<Vec<_>>());
    }
    all.iter().for_each(print::outcome);
    Ok(())
}
