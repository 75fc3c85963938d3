//! `eis-bench identify`: queries which instruments answer at the configured addresses, or at any
//! others, what they can do and what is programmed into them.

use crate::command::printed::say_json;
use std::{collections::BTreeMap, path::Path};

use instruments::{
    clock::{Clock, TimeMode},
    exchange::Identity,
    link::{Link, LinkError, LinkOptions},
    scpi::decode::Terminator,
    transcript::Tap,
    transport::{Address, MemoryHub},
};
use serde::Serialize;

use bench_core::{
    bench::survey::{AnyInstrument, InstrumentReport, KnownDialect},
    bench::{Bench, BenchError, Connections},
    safety::failure::Failure,
    sim::Simulation,
};
use bench_evaluate::doctor;
use bench_plan::{
    config::{self, load_any_bench},
    support::terminal::say,
};

/// Arguments of `identify`.
#[derive(Debug, clap::Args)]
pub struct IdentifyArgs {
    /// Bench or experiment files, and addresses of single instruments: `tcp://HOST:PORT`,
    /// `serial:/dev/PORT?baud=9600`.
    #[arg(required = true, value_name = "CONFIG|ADDRESS")]
    pub of: Vec<String>,
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
}

/// Instrument found at one address.
#[derive(Debug, Serialize)]
struct IdentifiedInstrument {
    /// Its role; for a single address, that of the dialect.
    role: Option<&'static str>,
    /// The dialect that was chosen.
    model: Option<String>,
    address: String,
    #[serde(flatten)]
    report: Option<InstrumentReport>,
    /// Reason why it did not answer.
    failure: Option<String>,
    /// Wall time from connecting to the last answer, s.
    took_s: f64,
    /// Lines for the bench file that would force a dialect on an instrument that no dialect knows.
    could_be_forced: Vec<String>,
}

impl IdentifiedInstrument {
    fn good(&self) -> bool {
        self.report.as_ref().is_some_and(|report| report.recognised)
    }
}

/// Queries each instrument and prints the replies. A silent instrument does not prevent queries
/// of the others.
///
/// # Errors
/// A mistake in a file; a bench that a process runs, whose instruments are not queried; after all
/// queries, an instrument that does not answer or whose model is unknown.
pub fn identify(args: &IdentifyArgs) -> Result<(), Failure> {
    let mut found = Vec::new();
    for of in &args.of {
        if Path::new(of).is_file() {
            found.extend(bench(&load_any_bench(Path::new(of))?, args.json)?);
        } else {
            let address = of.parse::<Address>().map_err(|error| {
                Failure::Usage(format!("expected a file or an address: {error}"))
            })?;
            if matches!(address, Address::Memory { .. }) {
                return Err(Failure::Usage(format!(
                    "{address}: a memory: address exists only within a process; give the bench \
                    file of the simulated instruments instead"
                )));
            }
            found.extend(single(&address, args.json)?);
        }
    }
    if args.json {
        say_json(&found)?;
    }
    match found.iter().filter(|found| !found.good()).count() {
        0 => Ok(()),
        wrong => {
            let listed: Vec<&str> = found
                .iter()
                .filter(|found| !found.good())
                .map(|found| found.role.unwrap_or(&found.address))
                .collect();
            Err(Failure::Unidentified {
                asked: found.len(),
                wrong,
                listed: listed.join(", "),
            })
        }
    }
}

fn bench(config: &config::Bench, quiet: bool) -> Result<Vec<IdentifiedInstrument>, Failure> {
    let in_process = config.in_process();
    let mode = if in_process {
        TimeMode::Virtual
    } else {
        config.time()
    };
    Clock::runtime(mode)?.block_on(async {
        let clock = Clock::start(mode);
        doctor::free(config, &clock).await?;
        let hub = MemoryHub::new();
        let simulation = config.simulation.as_ref().filter(|_| in_process);
        let simulation = simulation
            .map(|section| Simulation::new(&section.scenario, 0))
            .transpose()?;
        if let Some(simulation) = &simulation {
            simulation.serve_in_process(config, &clock, &hub)?;
        }
        let mut all = Vec::new();
        for (role, instrument) in config.instruments.addressed() {
            let one = config::Bench {
                instruments: config.instruments.only(role),
                ..config.clone()
            };
            let connections = Connections {
                clock: clock.clone(),
                hub: hub.clone(),
                taps: BTreeMap::new(),
            };
            let start_s = clock.machine_s();
            let outcome = ask(&one, instrument, &connections).await;
            let found = found(Some(role), instrument, outcome, clock.machine_s() - start_s);
            if !quiet {
                print(&found);
            }
            all.push(found);
        }
        Ok(all)
    })
}

async fn ask(
    one: &config::Bench,
    instrument: &config::Instrument,
    connections: &Connections,
) -> Result<InstrumentReport, BenchError> {
    let first = AnyInstrument::of(Bench::open(one, connections).await?)
        .into_iter()
        .next();
    let (role, mut any) = first.ok_or(BenchError::Missing { role: "instrument" })?;
    let report = any.describe().await;
    report.map_err(|source| BenchError::Link {
        role,
        model: instrument.model.clone(),
        source: Box::new(source),
    })
}

fn found(
    role: Option<&'static str>,
    instrument: &config::Instrument,
    outcome: Result<InstrumentReport, BenchError>,
    took_s: f64,
) -> IdentifiedInstrument {
    let (report, failure) = match outcome {
        Ok(report) if report.identity.is_web_server() => (None, Some(web(&report.identity))),
        Ok(report) => (Some(report), None),
        Err(error) => (None, Some(error.to_string())),
    };
    let unknown = report.as_ref().filter(|report| !report.recognised);
    let could_be_forced = unknown.map_or_else(Vec::new, |report| {
        forcing(role, &report.identity, &instrument.address)
    });
    IdentifiedInstrument {
        role,
        model: Some(instrument.model.clone()),
        address: instrument.address.to_string(),
        report,
        failure,
        took_s,
        could_be_forced,
    }
}

/// Queries an unknown address with one identification method after the other.
fn single(address: &Address, quiet: bool) -> Result<Vec<IdentifiedInstrument>, Failure> {
    Clock::runtime(TimeMode::Real)?.block_on(async {
        let clock = Clock::start(TimeMode::Real);
        let (mut answered, mut failure) = (None, None);
        for way in ways() {
            let mut dialect_of_role = false;
            // A terminator that the instrument before did not know may have left half a message
            // behind.
            for _ in 0..if way.profile.terminator == Terminator::Lf {
                1
            } else {
                2
            } {
                match identity(address, &way, &clock).await {
                    Ok(identity) => (answered, dialect_of_role) = (Some(identity), true),
                    Err(error) => failure = Some(error),
                }
                if dialect_of_role {
                    break;
                }
            }
            if dialect_of_role
                || matches!(
                    failure,
                    Some(LinkError::Connect { .. } | LinkError::ConnectTimeout { .. })
                )
            {
                break;
            }
        }
        let mut all = Vec::new();
        let web_server = answered.take_if(|identity| identity.is_web_server());
        let known: Vec<KnownDialect> = answered
            .iter()
            .flat_map(|identity| {
                KnownDialect::all()
                    .into_iter()
                    .filter(|known| known.recognises(identity))
            })
            .collect();
        for known in &known {
            let start_s = clock.machine_s();
            let report = match Link::open(options(address, known, &clock)).await {
                Ok(link) => known.on(link).describe().await,
                Err(error) => Err(error),
            };
            let took_s = clock.machine_s() - start_s;
            let (report, failure) = report.map_or_else(
                |error| (None, Some(error.to_string())),
                |report| (Some(report), None),
            );
            let (role, model) = (Some(known.role), Some(known.key.to_owned()));
            all.push(IdentifiedInstrument {
                role,
                model,
                address: address.to_string(),
                report,
                failure,
                took_s,
                could_be_forced: Vec::new(),
            });
        }
        if all.is_empty() {
            let could_be_forced = answered
                .as_ref()
                .map_or_else(Vec::new, |identity| forcing(None, identity, address));
            let report = answered.map(InstrumentReport::unknown);
            let failure = web_server.as_ref().map(web).or_else(|| {
                let failure = failure.filter(|_| report.is_none());
                failure.map(|error| error.to_string())
            });
            all.push(IdentifiedInstrument {
                role: None,
                model: None,
                address: address.to_string(),
                report,
                failure,
                took_s: clock.machine_s(),
                could_be_forced,
            });
        }
        if !quiet {
            all.iter().for_each(print);
        }
        Ok(all)
    })
}

/// Describes the reply of a web server that was found instead of an instrument.
fn web(identity: &Identity) -> String {
    format!(
        "expected an instrument, met a web server ({:?}); instruments with a web page speak SCPI on \
         another port, often 5025 or 5555",
        identity.raw
    )
}

/// Returns one dialect for each identification method.
fn ways() -> Vec<KnownDialect> {
    let mut ways: Vec<KnownDialect> = Vec::new();
    for known in KnownDialect::all() {
        let same = |other: &KnownDialect| {
            other.question == known.question && other.profile.terminator == known.profile.terminator
        };
        if !ways.iter().any(same) {
            ways.push(known);
        }
    }
    ways
}

async fn identity(
    address: &Address,
    way: &KnownDialect,
    clock: &Clock,
) -> Result<Identity, LinkError> {
    let mut link = Link::open(options(address, way, clock)).await?;
    Ok(Identity::parse(&link.query(way.question).await?))
}

fn options(address: &Address, known: &KnownDialect, clock: &Clock) -> LinkOptions {
    let (name, profile) = (address.to_string(), known.profile);
    LinkOptions {
        name,
        address: address.clone(),
        profile,
        clock: clock.clone(),
        hub: MemoryHub::new(),
        tap: Tap::none(),
    }
}

/// Returns lines for the bench file that select a known dialect for an unknown model; dialects of
/// the same maker come first.
fn forcing(role: Option<&str>, identity: &Identity, address: &Address) -> Vec<String> {
    let maker = identity.maker.to_lowercase();
    let mut known: Vec<KnownDialect> = KnownDialect::all()
        .into_iter()
        .filter(|known| role.is_none_or(|role| role == known.role))
        .collect();
    let akin = |known: &KnownDialect| {
        known
            .key
            .split('-')
            .next()
            .is_some_and(|first| maker.contains(first))
    };
    known.sort_by_key(|known| !akin(known));
    let accept = format!("{},{}", identity.maker, identity.model);
    let accept = if identity.raw.contains(&accept) {
        accept
    } else {
        identity.raw.clone()
    };
    let line = |known: &KnownDialect| {
        let more = if known.role == "logger" {
            ", cell_channel = 101"
        } else {
            ""
        };
        format!(
            "instruments.{} = {{ model = {:?}, address = \"{address}\", accept = {accept:?}{more} \
            }}",
            known.role, known.key
        )
    };
    known.iter().map(line).collect()
}

fn print(found: &IdentifiedInstrument) {
    let IdentifiedInstrument {
        role,
        model,
        address,
        report,
        failure,
        took_s,
        could_be_forced,
    } = found;
    let (role, model) = (role.unwrap_or("-"), model.as_deref().unwrap_or("unknown"));
    let Some(report) = report else {
        say!(
            "{role:<10} {model:<20} {address:<32} {} ({took_s:.2} s)",
            failure.as_deref().unwrap_or("no answer")
        );
        return;
    };
    let verdict = if report.recognised {
        "ok"
    } else {
        "NOT THE CONFIGURED MODEL"
    };
    let verdict = if report.recognised || model != "unknown" {
        verdict
    } else {
        "NO KNOWN MODEL"
    };
    say!(
        "{role:<10} {model:<20} {address:<32} {}  [{verdict}]",
        report.identity.raw
    );
    for line in could_be_forced {
        say!("    could be tried as  {line}");
    }
    if !report.recognised {
        return;
    }
    let identity = &report.identity;
    let or_none = |text: &str| {
        if text.is_empty() {
            "not reported".to_owned()
        } else {
            text.to_owned()
        }
    };
    say!(
        "    serial number {}, firmware {}; answered within {took_s:.2} s",
        or_none(&identity.serial),
        or_none(&identity.firmware)
    );
    if let serde_json::Value::Object(fields) = &report.capabilities {
        let words: Vec<String> = fields
            .iter()
            .map(|(name, value)| format!("{} {value}", name.replace('_', " ")))
            .collect();
        say!("    can       {}", words.join("; "));
    }
    if !report.programmed.is_empty() {
        let words: Vec<String> = report
            .programmed
            .iter()
            .map(|answer| format!("{} {}", answer.question, answer.answer.trim()))
            .collect();
        say!("    programmed {}", words.join("; "));
    }
    let health = if report.health.is_empty() {
        "nothing to complain of".to_owned()
    } else {
        report.health.join("; ")
    };
    say!("    health    {health}");
}
