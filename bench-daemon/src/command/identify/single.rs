//! Identifies an instrument at an address of which nothing else is known.

use instruments::{
    clock::{Clock, TimeMode},
    exchange::Identity,
    link::{Link, LinkError, LinkOptions},
    scpi::decode::Terminator,
    transcript::Tap,
    transport::{Address, MemoryHub},
};

use super::found::{IdentifiedInstrument, forcing, web};
use bench_core::{
    bench::survey::{InstrumentReport, KnownDialect},
    safety::failure::Failure,
};

/// Queries an unknown address with one identification method after the other.
pub(super) fn identify(address: &Address) -> Result<Vec<IdentifiedInstrument>, Failure> {
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
                output: None,
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
                output: None,
                failure,
                took_s: clock.machine_s(),
                could_be_forced,
            });
        }
        Ok(all)
    })
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
